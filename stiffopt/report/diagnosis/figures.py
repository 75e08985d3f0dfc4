"""Figures of a diagnosis: residual over noise, held-out runs over time, simulated positions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure

from stiffopt.discovery.diagnosis import Diagnosis
from stiffopt.discovery.names import Channel
from stiffopt.discovery.position_fit import PositionRun
from stiffopt.discovery.prediction import ChannelError, RunProof
from stiffopt.discovery.settings import MIN_MOVING_SPEED
from stiffopt.recording.joint_facts import velocities
from stiffopt.report.common import svg
from stiffopt.report.common.text import scale, significant
from stiffopt.report.diagnosis.words import channels_in_words, regressor_words
from stiffopt.units import joint_unit

HEAT = LinearSegmentedColormap.from_list("heat", ["#f5f7f9", "#f7d99a", svg.ORANGE, "#a33b00"])
# Units of the signals that a residual may depend on.
_SIGNAL_UNITS = {"q": "rad", "qd": "rad/s", "qdd": "rad/s^2", "torque": "N m"}
_ROLE_TITLES = (("test", "test runs"), ("extrapolate", "extrapolation runs"))
_WINDOW_LENGTH = 0.5  # of a held-out run, in which the residual is averaged [s]
# Least residual over noise of a listed window, and number of windows.
_MIN_LISTED_RATIO, _MAX_WINDOWS = 2.0, 8


@svg.figure_style()
def residual_figure(diagnosis: Diagnosis) -> Figure:
    """Plot residual over noise by joint and channel: nominal, within tolerance, with findings."""
    search, n = diagnosis.search, diagnosis.recordings.n
    stages = [
        ("nominal model", search.before),
        ("nominal values within tolerance", search.calibrated),
    ]
    if search.selected:
        words = "with the findings" if diagnosis.findings else "with rejected candidate effects"
        stages.append((words, search.after))
    every = np.concatenate([s[1] for s in stages])
    known = every[np.isfinite(every)]
    # Least residual over noise of the darkest colour.
    top = max(10.0, float(known.max()) if known.size else 0.0)
    figure, grid = svg.panels(len(stages), len(stages), (svg.WIDTH, 1.0 + 0.36 * n))
    for axes, (title, ratios) in zip(grid, stages, strict=True):
        table = ratios.reshape(2, n).T
        shown = np.ma.masked_invalid(np.maximum(table, 1.0))
        axes.imshow(shown, cmap=HEAT, norm=LogNorm(1.0, top), aspect="auto")
        for joint, row in enumerate(table):
            for kind, value in enumerate(row):
                dark = np.isfinite(value) and np.log(max(value, 1.0)) > 0.7 * np.log(top)
                text = significant(value, 2) if np.isfinite(value) else "not recorded"
                colour = "white" if dark else svg.GREY if text == "not recorded" else "black"
                axes.text(kind, joint, text, ha="center", va="center", color=colour, size=8.5)
        axes.set_title(title)
        axes.set_xticks([0, 1], ["torque", "link encoder"])
        axes.set_yticks(range(n), [f"J{j + 1}" for j in range(n)])
        axes.tick_params(length=0)
        axes.set_xticks([0.5], minor=True)
        axes.set_yticks(np.arange(n - 1) + 0.5, minor=True)
        axes.grid(visible=False)
        axes.grid(visible=True, which="minor", color="white", linewidth=2.0)
        axes.tick_params(which="minor", length=0)
        axes.spines[:].set_visible(False)
    figure.subplots_adjust(left=0.03, right=0.99, wspace=0.1)
    return figure


@svg.figure_style()
def held_out_figure(diagnosis: Diagnosis) -> Figure:
    """Plot residual over noise of every channel of the held-out runs, before and after."""
    roles = [(role, words) for role, words in _ROLE_TITLES if diagnosis.proofs(role)]
    names = list(dict.fromkeys(c.name for p in diagnosis.held_out for c in p.channels))
    names.sort(key=lambda name: Channel.read(name).number(diagnosis.recordings.n))
    figure = Figure(figsize=(svg.WIDTH, 1.0 + 0.24 * max(len(names), 3)))
    grid = figure.subplots(1, max(len(roles), 1), squeeze=False, sharey=True)[0]
    for axes, (role, words) in zip(grid, roles, strict=False):
        for row, name in enumerate(names):
            _draw_ratio(axes, row, channel_ratio(diagnosis.proofs(role), name))
        axes.axvline(1.0, color=svg.GREY, linewidth=1.0, zorder=0)
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        axes.set_xlim(min(low, 0.8), max(high, 4.0))
        axes.xaxis.set_major_formatter(lambda x, _: significant(x, 2))
        # Minor ticks 2 and 5 of the logarithmic axis.
        axes.xaxis.set_minor_formatter(
            lambda x, _: significant(x, 1) if f"{x:.0e}"[0] in "25" else ""
        )
        axes.set_xlabel("residual over noise (root mean squares)")
        axes.set_title(words)
        axes.grid(visible=False, axis="y")
    channels = map(Channel.read, names)
    grid[0].set_yticks(range(len(names)), [f"J{each.joint} {each.sensor}" for each in channels])
    grid[0].set_ylim(len(names) - 0.4, -0.6)
    handles = [
        grid[0].plot([], [], "o", mfc="white", mec=svg.VERMILLION, mew=1.5, ms=6)[0],
        grid[0].plot([], [], "o", color=svg.BLUE, ms=5)[0],
        grid[0].plot([], [], color=svg.GREY, linewidth=1.0)[0],
    ]
    below = 0.11 - 0.42 / figure.get_figheight()
    figure.legend(
        handles,
        ("before", "after", "sensor noise"),
        loc="upper left",
        ncols=3,
        bbox_to_anchor=(0.1, below),
    )
    figure.subplots_adjust(left=0.11, right=0.99, wspace=0.06)
    return figure


@svg.figure_style()
def noise_ceiling_figure(diagnosis: Diagnosis) -> Figure:
    """Plot the black-box fit of the remaining residual along its most important signals."""
    assert diagnosis.noise_ceiling is not None
    depends = diagnosis.noise_ceiling.depends
    figure, grid = svg.panels(len(depends), len(depends), (svg.WIDTH, 2.4), sharey=True)
    for axes, each in zip(grid, depends, strict=True):
        kind, _, number = each.signal.rpartition("_")
        slides = diagnosis.training.constants.joints[int(number) - 1].prismatic
        axes.plot(each.at, each.mean, color=svg.BLUE)
        axes.axhline(0.0, color=svg.GREY, linewidth=1.0, zorder=0)
        unit = joint_unit(_SIGNAL_UNITS[kind], slides)
        axes.set_xlabel(f"{regressor_words(each.signal).removeprefix('the ')} [{unit}]")
    own = Channel.read(depends[0].channel).joint - 1
    unit = joint_unit("N m", diagnosis.training.constants.joints[own].prismatic)
    grid[0].set_ylabel(f"residual torque, joint {own + 1} [{unit}]")
    return figure


def _draw_ratio(axes: Axes, row: int, ratio: tuple[float, float]) -> None:
    """Draw residual over noise before and after, and the line between them."""
    axes.plot(ratio, [row, row], color=svg.PALE, linewidth=3.0, zorder=1)
    axes.plot(ratio[0], row, "o", mfc="white", mec=svg.VERMILLION, mew=1.5, ms=6)
    axes.plot(ratio[1], row, "o", color=svg.BLUE, ms=5)


def channel_ratio(proofs: Iterable[RunProof], name: str) -> tuple[float, float]:
    """Return residual over noise of a channel in some runs, before and after.

    Both are nan where no run has samples of the channel.
    """
    own = [c for p in proofs for c in p.channels if c.name == name]
    count = sum(c.samples for c in own)
    if not count:
        return float("nan"), float("nan")
    before = float(np.sqrt(sum(c.before / c.noise**2 for c in own) / count))
    return before, float(np.sqrt(sum(c.after / c.noise**2 for c in own) / count))


@dataclass(frozen=True, eq=False)
class Trace:
    """One channel of one held-out run."""

    time: np.ndarray  # (K,) [s]
    # (K,) torque, or wind-up (motor less link angle) of a link encoder; SI.
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    used: np.ndarray  # (K,) samples that count: torque only while the joint moves
    speed: np.ndarray  # (K,) speed of the joint
    error: ChannelError
    unit: str


@dataclass(frozen=True)
class Window:
    """Interval of a held-out run with a large residual."""

    run: str
    error: ChannelError
    # [s].
    begin: float
    end: float
    rms: float  # root mean square of the residual with the extended model
    ratio: float  # the same over noise
    # Range of the joint's speed.
    slowest: float
    fastest: float
    unit: str


def trace(diagnosis: Diagnosis, proof: RunProof, name: str) -> Trace | None:
    """Return a channel of a held-out run with its predictions; None where it was not recorded."""
    error = next((c for c in proof.channels if c.name == name), None)
    if error is None:
        return None
    run, j = proof.run, error.joint
    if run.at_rest:
        return None  # poses have no course over time
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
    # Stamps may count from 1970.
    time = run.time - run.time[0]
    return Trace(time, measured, predictions[0], predictions[1], used, speed, error, unit)


@svg.figure_style()
def proof_figure(shown: Trace) -> Figure:
    """Plot the residual of one held-out run before and after, legible on a narrow screen."""
    rest = float(np.nanquantile(np.abs(shown.measured - shown.before), 0.99))
    factor, unit = scale(rest, shown.unit)
    noise = factor * shown.error.noise
    # A screen of 390 px shows this width whole [inch].
    figure, axes = svg.subplots(2.8, width=4.2)
    axes.axhspan(-2 * noise, 2 * noise, color=svg.PALE, zorder=0, linewidth=0, label="sensor noise")
    for predicted, colour, label in (
        (shown.before, svg.VERMILLION, "model as it was"),
        (shown.after, svg.BLUE, "model as found"),
    ):
        left = np.where(shown.used, factor * (shown.measured - predicted), np.nan)
        _draw_curve(axes, shown.time, left, colour, label, 0.9)
    axes.set_xlim(shown.time[0], shown.time[-1])
    axes.set_xlabel("time from the start of the run [s]")
    axes.set_ylabel(f"measured less predicted [{unit}]")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.35 * (high - low))
    axes.legend(loc="upper left", ncols=2)
    figure.subplots_adjust(left=0.17, right=0.98, top=0.97, bottom=0.17)
    return figure


@svg.figure_style()
def overlay_figure(shown: Trace) -> Figure:
    """Plot a measured channel with its predictions, and their residuals with the noise band."""
    largest = float(np.nanquantile(np.abs(shown.measured), 0.99))
    rest = float(np.nanquantile(np.abs(shown.measured - shown.before), 0.99))
    factor, unit = scale(largest, shown.unit)
    fine, small = scale(rest, shown.unit)
    count, noise = shown.error.samples, shown.error.noise
    figure, (top, below) = svg.subplots(4.6, 2, 1, sharex=True, height_ratios=(1.2, 1.0))
    _draw_curve(top, shown.time, factor * shown.measured, svg.INK, "measured", 0.9)
    below.axhspan(-2 * fine * noise, 2 * fine * noise, color=svg.PALE, zorder=0, linewidth=0)
    for name, colour, squares in (
        ("before", svg.VERMILLION, shown.error.before),
        ("after", svg.BLUE, shown.error.after),
    ):
        predicted = getattr(shown, name)
        _draw_curve(top, shown.time, factor * predicted, colour, name, 1.2)
        rms = fine * np.sqrt(squares / count)
        left = np.where(shown.used, shown.measured - predicted, np.nan)
        label = f"{name}, rms {significant(rms, 3)} {small}"
        _draw_curve(below, shown.time, fine * left, colour, label, 0.9)
    kind = "torque" if shown.error.kind == "torque" else "wind-up"
    top.set_ylabel(f"{kind} [{unit}]")
    below.set_ylabel(f"residual [{small}]")
    below.set_xlabel("time from the start of the run [s]")
    for axes, columns in ((top, 3), (below, 2)):
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.22 * (high - low))
        axes.legend(loc="upper right", ncols=columns)
    below.set_xlim(shown.time[0], shown.time[-1])
    band = f"band: ±2 standard deviations of the noise, {significant(fine * noise, 2)} {small}"
    below.text(0.005, 0.97, band, transform=below.transAxes, va="top", size=8, color=svg.INK)
    figure.subplots_adjust(left=0.065, right=0.99, hspace=0.08)
    return figure


def _draw_curve(
    axes: Axes, time: np.ndarray, values: np.ndarray, colour: str, label: str, width: float
) -> None:
    """Draw a decimated curve, interrupted at gaps longer than a few samples."""
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return
    x, y = svg.decimate_curve(time[known], values[known])
    # So many missing samples are bridged in a plotted curve.
    gap = np.flatnonzero(np.diff(known) > 10)
    # A nan in the middle of every gap interrupts the line.
    middle = 0.5 * (time[known[gap]] + time[known[gap + 1]])
    x, y = np.concatenate([x, middle]), np.concatenate([y, np.full(len(middle), np.nan)])
    order = np.argsort(x, kind="stable")
    axes.plot(x[order], y[order], color=colour, linewidth=width, label=label)


def worst_windows(diagnosis: Diagnosis) -> list[Window]:
    """Return half seconds of held-out runs with the largest residual of the extended model."""
    found = []
    for proof in diagnosis.held_out:
        for error in proof.channels:
            shown = trace(diagnosis, proof, error.name)
            if shown is not None:
                found += _run_windows(proof.run.name, shown)
    found.sort(key=lambda w: -w.ratio)
    # One per channel and run: its other windows look alike.
    first = {(w.run, w.error.name): w for w in reversed(found)}
    return sorted(first.values(), key=lambda w: -w.ratio)[:_MAX_WINDOWS]


def _run_windows(run: str, shown: Trace) -> list[Window]:
    left = shown.measured - shown.after
    number = np.floor((shown.time - shown.time[0]) / _WINDOW_LENGTH).astype(int)
    windows = []
    for k in np.unique(number):
        own = (number == k) & shown.used
        if own.sum() < 5:
            continue
        rms = float(np.sqrt(np.mean(left[own] ** 2)))
        if rms > _MIN_LISTED_RATIO * shown.error.noise:
            begin = float(shown.time[0] + k * _WINDOW_LENGTH)
            windows.append(
                Window(
                    run=run,
                    error=shown.error,
                    begin=begin,
                    end=min(begin + _WINDOW_LENGTH, float(shown.time[-1])),
                    rms=rms,
                    ratio=rms / shown.error.noise,
                    slowest=float(np.nanmin(shown.speed[own])),
                    fastest=float(np.nanmax(shown.speed[own])),
                    unit=shown.unit,
                )
            )
    return windows


@svg.figure_style()
def state_figure(diagnosis: Diagnosis) -> Figure:
    """Plot residual over noise of held-out runs by channel and state, before and after the fit."""
    names = list(dict.fromkeys(c.name for p in diagnosis.held_out for c in p.channels))
    figure, grid = svg.subplots(1.0 + 0.24 * max(len(names), 3), 1, 2, sharey=True)
    for axes, state in zip(grid, ("before", "after"), strict=True):
        proofs = [p for p in diagnosis.held_out if p.run.name.startswith(f"{state}_")]
        for row, name in enumerate(names):
            _draw_ratio(axes, row, channel_ratio(proofs, name))
        axes.axvline(1.0, color=svg.GREY, linewidth=1.0, zorder=0)
        axes.set_title(f"held-out runs {state} the change")
        axes.set_xlabel("residual over noise")
        axes.grid(visible=False, axis="y")
    grid[0].set_yticks(range(len(names)), [channels_in_words([name]) for name in names])
    grid[0].invert_yaxis()
    return figure


@svg.figure_style()
def position_figure(run: PositionRun, joints: Sequence[str], prismatic: np.ndarray) -> Figure:
    """Plot command, measured and simulated position of each joint over time, and the errors."""
    n, time = len(joints), run.time - run.time[0]
    figure, grid = svg.subplots(0.7 + 1.45 * n, n, 2, squeeze=False, sharex=True)
    for j, (left, right) in enumerate(grid):
        for values, colour, label, width in (
            (run.command, svg.GREY, "command", 0.9),
            (run.measured, svg.INK, "measured", 1.8),
            (run.before, svg.VERMILLION, "before", 1.1),
            (run.after, svg.BLUE, "after", 1.1),
        ):
            shown = svg.decimate_curve(time, np.nan_to_num(values[:, j]))
            left.plot(*shown, color=colour, label=label, linewidth=width)
        for values, colour in ((run.before, svg.VERMILLION), (run.after, svg.BLUE)):
            error = 1e3 * np.nan_to_num(values[:, j] - run.measured[:, j])
            right.plot(*svg.decimate_curve(time, error), color=colour, linewidth=1.1)
        left.set_title(f"J{j + 1} {joints[j]}")
        left.set_ylabel("m" if prismatic[j] else "rad")
        right.set_title("simulated less measured")
        right.set_ylabel("mm" if prismatic[j] else "mrad")
    for axes in grid[-1]:
        axes.set_xlabel("time from the start of the run [s]")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper right", ncols=4, bbox_to_anchor=(0.99, 1.0))
    height = figure.get_figheight()
    figure.subplots_adjust(
        left=0.07, right=0.99, top=1.0 - 0.5 / height, bottom=0.45 / height, hspace=0.5
    )
    return figure
