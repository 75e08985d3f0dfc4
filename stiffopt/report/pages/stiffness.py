"""stiffness.html of a robot: joint stiffness over torque, with and without contacts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiffopt.report.common import svg
from stiffopt.report.common.citations import robot_references
from stiffopt.report.common.page import PageFigures, write_page
from stiffopt.report.common.robot import (
    JointUnits,
    compliance_by_kind,
    element_colour,
    estimated_inputs,
    joint_units,
)
from stiffopt.report.common.text import listed, percent
from stiffopt.robot.robot import Robot
from stiffopt.robot.stiffness_study import StiffnessRow

PAGE_FILE = "stiffness.html"
SHARE_RATIOS = (0.001, 0.01, 0.1, 1.0)


@dataclass(frozen=True)
class FirstSlip:
    """The element of a joint that slips first."""

    joint: int  # from 1
    element: str  # "" where none slips
    torque: float  # slip torque at the joint [N m]; inf where none slips
    largest: float  # largest torque of the joint [N m]


def write_stiffness_report(
    robot: Robot, rows: Iterable[StiffnessRow], directory: str | Path
) -> Path:
    """Write stiffness.html and its figures as SVG and PNG into `directory`; return the page.

    `rows`: as `stiffness_study` returns them.
    """
    units = joint_units(robot)
    curves = stiffness_curves(rows)
    figures = PageFigures("stiffness")
    figures.draw("tangent", tangent_figure(curves, units, low_torque=False), "Tangent stiffness")
    figures.draw("low_torque", tangent_figure(curves, units, low_torque=True), "Near zero torque")
    figures.draw("loss", loss_figure(curves, units), "Stiffness lost to contacts")
    figures.draw("shares", shares_figure(robot, units), "Compliance by element")
    context = {
        "title": f"Joint stiffness of {robot.title or robot.name}",
        "headline": stiffness_headline(curves, [unit.label for unit in units]),
        "where": where_contacts_matter(curves, [unit.label for unit in units]),
        "curves": curves,
        "units": units,
        "slip": _first_slips(robot),
        "loading": _contact_loading(robot),
        "estimated": estimated_inputs(robot),
        "references": robot_references(robot),
    }
    return write_page("pages/stiffness.html.j2", Path(directory) / PAGE_FILE, context, figures)


def where_contacts_matter(
    curves: Mapping[int, Sequence[StiffnessCurve]], labels: Sequence[str]
) -> str:
    """Return sentences on the torque at which contacts reduce each joint's stiffness most."""
    groups: dict[str, list[str]] = {}
    for joint, (own, *_) in curves.items():
        at = own.ratio_of_largest_loss
        if not np.any(own.loss > 0.0):
            continue
        if at == own.ratio[0]:
            where = f"at the least torque shown, {percent(at)} of the largest"
        elif at == own.ratio[-1]:
            where = "at the largest torque"
        else:
            where = f"at {percent(at)} of the largest torque"
        ends = " to ".join(percent(float(own.loss[end])) for end in (0, -1))
        groups.setdefault(where, []).append(f"{labels[joint - 1]} ({ends})")
    if not groups:
        return "Without contacts both curves are one."
    told = "; ".join(f"{where} in {listed(joints)}" for where, joints in groups.items())
    return (
        f"Contacts reduce the stiffness most {told}. In brackets: the relative loss, from the "
        "least torque shown to the largest."
    )


def stiffness_headline(
    curves: Mapping[int, Sequence[StiffnessCurve]], labels: Sequence[str]
) -> str:
    """Return a sentence on the largest relative loss of stiffness through contacts."""
    joint, (own, *_) = max(curves.items(), key=lambda each: (each[1][0].loss.max(), -each[0]))
    loss = float(own.loss.max())
    if loss <= 0.0:
        return "No joint has contacts: reducers and springs alone yield"
    return (
        f"Contacts reduce the stiffness by up to {percent(loss)} ({labels[joint - 1]} at"
        f" {percent(own.ratio_of_largest_loss)} of its largest torque)"
    )


def _contact_loading(robot: Robot) -> str:
    """Return the loading of rough contacts that the robot file states."""
    surfaces = (
        getattr(element, "surface", None)
        for chain in robot.chains
        if chain is not None
        for element in chain.elements.values()
    )
    return next((surface.loading for surface in surfaces if surface is not None), "first")


def _first_slips(robot: Robot) -> list[FirstSlip]:
    found = []
    for number, chain in enumerate(robot.chains, start=1):
        if chain is not None:
            slip = chain.slip_torques() or {"": math.inf}
            name = min(slip, key=lambda each: slip[each])
            found.append(FirstSlip(number, name, slip[name], float(robot.torque_max[number - 1])))
    return found


@dataclass(frozen=True)
class StiffnessCurve:
    """Stiffness of one joint over the torque ratio, key flanks in series or in parallel."""

    joint: int  # from 1
    flanks: str
    ratio: np.ndarray  # (K,) torque over the largest torque
    # (K,) with contacts and without [N m/rad], and their ratio.
    tangent: np.ndarray
    reducer_only: np.ndarray
    relative: np.ndarray
    windup: np.ndarray  # (K,) [rad]
    # (K,) tangent stiffness under first loading and under cyclic loading of the contacts [N m/rad].
    first: np.ndarray
    cyclic: np.ndarray

    @property
    def loss(self) -> np.ndarray:
        """Loss of stiffness through contacts, relative to the reducer alone (K,)."""
        return 1.0 - self.relative

    @property
    def ratio_of_largest_loss(self) -> float:
        """Torque ratio of the largest relative loss."""
        return float(self.ratio[np.argmax(self.loss)])

    def at(self, ratio: float, values: np.ndarray) -> float:
        """Interpolate one of the curve's arrays at a torque ratio."""
        return float(np.interp(np.log(ratio), np.log(self.ratio), values))


def stiffness_curves(rows: Iterable[StiffnessRow]) -> dict[int, list[StiffnessCurve]]:
    """Return the curves by joint, the robot file's arrangement of key flanks first."""
    groups: dict[tuple[int, str], list[StiffnessRow]] = {}
    for row in rows:
        groups.setdefault((row.joint, row.flanks), []).append(row)
    curves: dict[int, list[StiffnessCurve]] = {}
    for (joint, flanks), own in groups.items():
        table = sorted(
            (
                row.torque_ratio,
                row.tangent_stiffness,
                row.reducer_only_tangent_stiffness,
                row.ratio_to_reducer_only,
                row.windup,
                row.first_loading_stiffness,
                row.cyclic_stiffness,
            )
            for row in own
        )
        curves.setdefault(joint, []).append(StiffnessCurve(joint, flanks, *np.array(table).T))
    return curves


@svg.figure_style()
def tangent_figure(
    curves: Mapping[int, Sequence[StiffnessCurve]], units: Sequence[JointUnits], low_torque: bool
) -> Figure:
    """Plot the tangent stiffness of every joint, with contacts and of the reducer alone.

    `low_torque`: logarithmic torque axis, which resolves the range near zero torque.
    """
    columns = min(3, len(curves))
    size = svg.WIDTH, 0.9 + 2.0 * -(-len(curves) // columns)
    figure, grid = svg.panels(len(curves), columns, size)
    for place, (axes, (joint, readings)) in enumerate(zip(grid, curves.items(), strict=True)):
        _draw_tangent_panel(axes, readings, low_torque)
        unit = units[joint - 1]
        axes.set_title(f"{unit.label} [{unit.stiffness}]")
        if place + columns >= len(curves):
            axes.set_xlabel("torque over largest torque")
    handles, labels = grid[0].get_legend_handles_labels()
    below = -0.12 / figure.get_figheight()
    figure.legend(handles, labels, loc="upper left", ncols=3, bbox_to_anchor=(0.05, below))
    figure.subplots_adjust(left=0.07, right=0.995, wspace=0.24, hspace=0.34)
    return figure


def _draw_tangent_panel(axes: Axes, readings: Sequence[StiffnessCurve], low_torque: bool) -> None:
    own = readings[0]
    for other in readings[1:]:
        label = f"with contacts, flanks in {other.flanks}"
        axes.plot(other.ratio, other.tangent, color=svg.GREY, linewidth=1.0, label=label)
    keys = f", flanks in {own.flanks} (this robot)" if own.flanks in ("series", "parallel") else ""
    dashes = (0, (5, 1.5))
    axes.plot(
        own.ratio, own.reducer_only, color=svg.VERMILLION, linestyle=dashes, label="reducer alone"
    )
    axes.plot(own.ratio, own.tangent, color=svg.BLUE, linewidth=2.0, label=f"with contacts{keys}")
    if low_torque:
        svg.set_log_scale(axes, "x")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)
    axes.locator_params(axis="y", nbins=5)


@svg.figure_style()
def loss_figure(
    curves: Mapping[int, Sequence[StiffnessCurve]], units: Sequence[JointUnits]
) -> Figure:
    """Plot the relative loss of tangent stiffness through contacts, all joints.

    The axis is logarithmic where the joints' losses differ by more than a decade.
    """
    figure, axes = svg.subplots(3.8)
    losses = []
    for joint, readings in curves.items():
        own = readings[0]
        losses.append(100.0 * own.loss)
        style = svg.line_style(joint - 1)
        axes.plot(own.ratio, losses[-1], label=units[joint - 1].label, **style)
    svg.set_log_scale(axes, "x")
    highest = [float(np.max(each)) for each in losses]
    # Ratio of the joints' largest losses above which the axis is logarithmic.
    if min(highest) > 0.0 and max(highest) > 10.0 * min(highest):
        svg.set_log_scale(axes, "y")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set_xlabel("torque over largest torque")
    axes.set_ylabel("stiffness lost to contacts [%]")
    axes.margins(x=0.01)
    axes.legend(loc="best", ncols=2)
    figure.subplots_adjust(left=0.07, right=0.995)
    return figure


@svg.figure_style()
def shares_figure(robot: Robot, units: Sequence[JointUnits]) -> Figure:
    """Plot the share of each kind of element in the tangent compliance at several torque ratios."""
    jointed = [j for j, chain in enumerate(robot.chains) if chain is not None]
    figure, grid = svg.subplots(
        0.9 + max(0.34 * len(jointed), 1.0), 1, len(SHARE_RATIOS), sharey=True
    )
    named: dict[str, Any] = {}
    for axes, ratio in zip(grid, SHARE_RATIOS, strict=True):
        for row, j in enumerate(jointed):
            left = 0.0
            torque = ratio * float(robot.torque_max[j])
            for kind, share in compliance_by_kind(robot.chains[j], torque).items():
                colour = element_colour(kind)
                bar = axes.barh(row, 100 * share, left=left, height=0.66, color=colour)
                named.setdefault(kind.replace("_", " "), bar)
                left += 100 * share
        axes.set_xlim(0.0, 100.0)
        axes.set_title(f"{100 * ratio:g} % of the largest torque")
        axes.set_xlabel("compliance [%]")
        axes.grid(visible=False, axis="y")
    grid[0].set_yticks(range(len(jointed)), [units[j].label for j in jointed])
    grid[0].invert_yaxis()
    below = -0.3 / figure.get_figheight()
    figure.legend(
        list(named.values()), list(named), loc="upper left", ncols=8, bbox_to_anchor=(0.03, below)
    )
    figure.subplots_adjust(left=0.04, right=0.985, wspace=0.14)
    return figure
