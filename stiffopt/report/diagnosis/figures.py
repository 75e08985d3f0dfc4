"""Figures of a diagnosis over all joints: residual over noise, before and after."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure

from stiffopt.report.common.svg import BLUE, GREY, ORANGE, PALE, VERMILLION, WIDTH, house_style
from stiffopt.report.common.text import significant
from stiffopt.report.diagnosis.words import regressor_words
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis

HEAT = LinearSegmentedColormap.from_list("heat", ["#f5f7f9", "#f7d99a", ORANGE, "#a33b00"])
# Residual over noise at which the darkest colour is reached at the earliest.
_DARKEST = 10.0
# Of signals that a remainder depends on.
_UNITS = {"q": "rad", "qd": "rad/s", "qdd": "rad/s^2", "torque": "N m"}
_ROLES = (("test", "test runs"), ("extrapolate", "extrapolation runs"))


def balances_figure(diagnosis: Diagnosis) -> Figure:
    """Residual over noise by joint and balance: nominal, within tolerance, with the findings."""
    search, n = diagnosis.search, diagnosis.recordings.n
    stages = [
        ("nominal model", search.before),
        ("nominal values moved within tolerance", search.calibrated),
    ]
    if search.selected:
        words = (
            "and with what was found" if diagnosis.findings else "and with effects that were tried"
        )
        stages.append((words, search.after))
    every = np.concatenate([s[1] for s in stages])
    known = every[np.isfinite(every)]
    top = max(_DARKEST, float(known.max()) if known.size else 0.0)
    with house_style():
        figure = Figure(figsize=(WIDTH, 1.0 + 0.36 * n))
        grid = figure.subplots(1, len(stages), squeeze=False)[0]
        for axes, (title, ratios) in zip(grid, stages, strict=True):
            table = ratios.reshape(2, n).T
            shown = np.ma.masked_invalid(np.maximum(table, 1.0))
            axes.imshow(shown, cmap=HEAT, norm=LogNorm(1.0, top), aspect="auto")
            for joint, row in enumerate(table):
                for kind, value in enumerate(row):
                    dark = np.isfinite(value) and np.log(max(value, 1.0)) > 0.7 * np.log(top)
                    text = significant(value, 2) if np.isfinite(value) else "not recorded"
                    colour = "white" if dark else GREY if text == "not recorded" else "black"
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


def held_out_figure(diagnosis: Diagnosis) -> Figure:
    """Residual over noise of every channel of the held-out runs, before and after."""
    roles = [(role, words) for role, words in _ROLES if diagnosis.proofs(role)]
    with house_style():
        names = list(dict.fromkeys(c.name for p in diagnosis.held_out for c in p.channels))
        names.sort(key=lambda name: (not name.startswith("torque"), int(name.rpartition("_")[2])))
        figure = Figure(figsize=(WIDTH, 1.0 + 0.24 * max(len(names), 3)))
        grid = figure.subplots(1, max(len(roles), 1), squeeze=False, sharey=True)[0]
        for axes, (role, words) in zip(grid, roles, strict=False):
            for row, name in enumerate(names):
                before, after = channel_ratio(diagnosis, role, name)
                axes.plot([before, after], [row, row], color=PALE, linewidth=3.0, zorder=1)
                axes.plot(before, row, "o", mfc="white", mec=VERMILLION, mew=1.5, ms=6)
                axes.plot(after, row, "o", color=BLUE, ms=5)
            axes.axvline(1.0, color=GREY, linewidth=1.0, zorder=0)
            axes.set_xscale("log")
            low, high = axes.get_xlim()
            axes.set_xlim(min(low, 0.8), max(high, 4.0))
            axes.xaxis.set_major_formatter(lambda x, _: significant(x, 2))
            axes.xaxis.set_minor_formatter(lambda x, _: _sparse(x))
            axes.set_xlabel("residual over noise (root mean squares)")
            axes.set_title(words)
            axes.grid(visible=False, axis="y")
        grid[0].set_yticks(range(len(names)), [_short(name) for name in names])
        grid[0].set_ylim(len(names) - 0.4, -0.6)
        handles = [
            grid[0].plot([], [], "o", mfc="white", mec=VERMILLION, mew=1.5, ms=6)[0],
            grid[0].plot([], [], "o", color=BLUE, ms=5)[0],
            grid[0].plot([], [], color=GREY, linewidth=1.0)[0],
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


def dependence_figure(diagnosis: Diagnosis) -> Figure:
    """What a black box finds in what is left, along the signals that it goes with most."""
    assert diagnosis.noise_ceiling is not None
    depends = diagnosis.noise_ceiling.depends
    with house_style():
        figure = Figure(figsize=(WIDTH, 2.4))
        grid = figure.subplots(1, len(depends), squeeze=False, sharey=True)[0]
        for axes, each in zip(grid, depends, strict=True):
            kind, _, number = each.signal.rpartition("_")
            slides = diagnosis.training.constants.joints[int(number) - 1].prismatic
            axes.plot(each.at, each.mean, color=BLUE)
            axes.axhline(0.0, color=GREY, linewidth=1.0, zorder=0)
            unit = joint_unit(_UNITS[kind], slides)
            axes.set_xlabel(f"{regressor_words(each.signal).removeprefix('the ')} [{unit}]")
        own = int(depends[0].channel.rpartition("_")[2]) - 1
        unit = joint_unit("N m", diagnosis.training.constants.joints[own].prismatic)
        grid[0].set_ylabel(f"left of torque, joint {own + 1} [{unit}]")
        return figure


def channel_ratio(diagnosis: Diagnosis, role: str, name: str) -> tuple[float, float]:
    """Residual over noise of a channel over the runs of a role, before and after; maybe nan."""
    own = [c for p in diagnosis.proofs(role) for c in p.channels if c.name == name]
    count = sum(c.samples for c in own)
    if not count:
        return float("nan"), float("nan")
    before = float(np.sqrt(sum(c.before / c.noise**2 for c in own) / count))
    return before, float(np.sqrt(sum(c.after / c.noise**2 for c in own) / count))


def _short(name: str) -> str:
    kind, _, joint = name.rpartition("_")
    return f"J{joint} {'torque' if kind == 'torque' else 'link encoder'}"


def _sparse(value: float) -> str:
    """Labels of a logarithmic axis between its decades: only 2 and 5 of each."""
    first = f"{value:.0e}"[0]
    return significant(value, 1) if first in "25" else ""
