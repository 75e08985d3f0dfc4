"""Held-out runs: measured and predicted over time, and where the residual is worst."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiffopt.discovery.settings import MIN_MOVING_SPEED
from stiffopt.recording.facts import velocities
from stiffopt.report.common.svg import BLUE, INK, PALE, VERMILLION, WIDTH, house_style, thin
from stiffopt.report.common.text import scale, significant
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis
    from stiffopt.discovery.prediction import ChannelError, RunProof

_WINDOW = 0.5
# Points of a curve, and missing samples over which it is drawn all the same.
_CURVE, _BRIDGED = 1400, 10
# Residual over noise from which a window is listed, and how many at most.
_WORTH, _MOST = 2.0, 8


@dataclass(frozen=True, eq=False)
class Trace:
    """One channel of one held-out run.

    Parameters
    ----------
    time : array (K,)
        [s]
    measured, before, after : array (K,)
        Torque, or wind-up (motor less link angle) of a link encoder; SI.
    used : array (K,) of bool
        Samples that count: torque only while the joint moves.
    speed : array (K,)
        Of the joint.
    error : ChannelError
    unit : str
    """

    time: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    used: np.ndarray
    speed: np.ndarray
    error: ChannelError
    unit: str


@dataclass(frozen=True)
class Window:
    """A stretch of a held-out run that is predicted badly.

    Parameters
    ----------
    run : str
    error : ChannelError
    begin, end : float
        [s]
    rms : float
        Residual with the extended model.
    ratio : float
        Over noise.
    slowest, fastest : float
        Speeds of the joint.
    unit : str
    """

    run: str
    error: ChannelError
    begin: float
    end: float
    rms: float
    ratio: float
    slowest: float
    fastest: float
    unit: str


def trace(diagnosis: Diagnosis, proof: RunProof, name: str) -> Trace | None:
    """A channel of a held-out run with its predictions; None where it was not recorded."""
    error = next((c for c in proof.channels if c.name == name), None)
    if error is None:
        return None
    run, j = proof.run, error.joint
    places = np.searchsorted(run.stamps, run.time)
    predictions = [getattr(p, error.kind)[places, j] for p in (proof.before, proof.after)]
    speed = velocities(run)[:, j]
    slides = diagnosis.training.constants.joints[j].prismatic
    if error.kind == "torque":
        measured, unit = run.torque[:, j], joint_unit("N m", slides)
        used = np.isfinite(measured) & (np.abs(np.nan_to_num(speed)) >= MIN_MOVING_SPEED)
    else:
        assert run.link_position is not None
        measured, unit = run.position[:, j] - run.link_position[:, j], joint_unit("rad", slides)
        predictions = [run.position[:, j] - p for p in predictions]
        used = np.isfinite(measured)
    return Trace(run.time, measured, predictions[0], predictions[1], used, speed, error, unit)


def overlay_figure(shown: Trace) -> Figure:
    """Measured channel with its predictions, and their residuals with the noise band."""
    largest = float(np.nanquantile(np.abs(shown.measured), 0.99))
    rest = float(np.nanquantile(np.abs(shown.measured - shown.before), 0.99))
    factor, unit = scale(largest, shown.unit)
    fine, small = scale(rest, shown.unit)
    count, noise = shown.error.samples, shown.error.noise
    with house_style():
        figure = Figure(figsize=(WIDTH, 4.6))
        top, below = figure.subplots(2, 1, sharex=True, height_ratios=(1.2, 1.0))
        _curve(top, shown.time, factor * shown.measured, INK, "measured", 0.9)
        below.axhspan(-2 * fine * noise, 2 * fine * noise, color=PALE, zorder=0, linewidth=0)
        for name, colour, squares in (
            ("before", VERMILLION, shown.error.before),
            ("after", BLUE, shown.error.after),
        ):
            predicted = getattr(shown, name)
            _curve(top, shown.time, factor * predicted, colour, name, 1.2)
            rms = fine * np.sqrt(squares / count)
            left = np.where(shown.used, shown.measured - predicted, np.nan)
            label = f"{name}, rms {significant(rms, 3)} {small}"
            _curve(below, shown.time, fine * left, colour, label, 0.9)
        kind = "torque" if shown.error.kind == "torque" else "wind-up"
        top.set_ylabel(f"{kind} [{unit}]")
        below.set_ylabel(f"residual [{small}]")
        below.set_xlabel("time [s]")
        for axes, columns in ((top, 3), (below, 2)):
            low, high = axes.get_ylim()
            axes.set_ylim(low, high + 0.22 * (high - low))
            axes.legend(loc="upper right", ncols=columns)
        below.set_xlim(shown.time[0], shown.time[-1])
        band = f"band: ±2 standard deviations of the noise, {significant(fine * noise, 2)} {small}"
        below.text(0.005, 0.97, band, transform=below.transAxes, va="top", size=8, color=INK)
        figure.subplots_adjust(left=0.065, right=0.99, hspace=0.08)
        return figure


def _curve(
    axes: Axes, time: np.ndarray, values: np.ndarray, colour: str, label: str, width: float
) -> None:
    """One curve, thinned; gaps longer than a few samples stay gaps."""
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return
    x, y = thin(time[known], values[known], _CURVE)
    gap = np.flatnonzero(np.diff(known) > _BRIDGED)
    # A nan in the middle of every gap breaks the line there.
    middle = 0.5 * (time[known[gap]] + time[known[gap + 1]])
    x, y = np.concatenate([x, middle]), np.concatenate([y, np.full(len(middle), np.nan)])
    order = np.argsort(x, kind="stable")
    axes.plot(x[order], y[order], color=colour, linewidth=width, label=label)


def worst_windows(diagnosis: Diagnosis) -> list[Window]:
    """Half seconds of held-out runs with the largest residual of the extended model."""
    found = []
    for proof in diagnosis.held_out:
        for error in proof.channels:
            shown = trace(diagnosis, proof, error.name)
            if shown is not None:
                found += _windows(proof.run.name, shown)
    found.sort(key=lambda w: -w.ratio)
    # One a channel and run: the rest of it looks alike.
    first = {(w.run, w.error.name): w for w in reversed(found)}
    return sorted(first.values(), key=lambda w: -w.ratio)[:_MOST]


def _windows(run: str, shown: Trace) -> list[Window]:
    left = shown.measured - shown.after
    number = np.floor((shown.time - shown.time[0]) / _WINDOW).astype(int)
    windows = []
    for k in np.unique(number):
        own = (number == k) & shown.used
        if own.sum() < 5:
            continue
        rms = float(np.sqrt(np.mean(left[own] ** 2)))
        if rms > _WORTH * shown.error.noise:
            begin = float(shown.time[0] + k * _WINDOW)
            windows.append(
                Window(
                    run=run,
                    error=shown.error,
                    begin=begin,
                    end=min(begin + _WINDOW, float(shown.time[-1])),
                    rms=rms,
                    ratio=rms / shown.error.noise,
                    slowest=float(np.nanmin(shown.speed[own])),
                    fastest=float(np.nanmax(shown.speed[own])),
                    unit=shown.unit,
                )
            )
    return windows
