"""stiffness.html of a robot: joint stiffness with and without contacts, and what yields."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.report.common.citations import robot_references
from stiffopt.report.common.page import PageFigures, write_page
from stiffopt.report.common.robot import estimated_inputs, joint_units
from stiffopt.report.common.text import listed, percent
from stiffopt.report.stiffness.figures import (
    StiffnessCurve,
    loss_figure,
    shares_figure,
    stiffness_curves,
    tangent_figure,
)

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot
    from stiffopt.robot.stiffness_study import StiffnessRow

PAGE_FILE = "stiffness.html"


@dataclass(frozen=True)
class FirstSlip:
    """The element of a joint that slips first.

    Parameters
    ----------
    joint : int
        From 1.
    element : str
        "" where none slips.
    torque : float
        Of the joint at which it slips [N m]; inf where none does.
    largest : float
        Largest torque of the joint [N m].
    """

    joint: int
    element: str
    torque: float
    largest: float


@dataclass(frozen=True)
class LargestLoss:
    """Where contacts cost most: share of the stiffness of the reducer alone."""

    loss: float
    joint: int
    ratio: float


def write_stiffness_report(
    robot: Robot, rows: Iterable[StiffnessRow], directory: str | Path
) -> Path:
    """Write stiffness.html and its figures as SVG and PNG into `directory`; return the page.

    Parameters
    ----------
    robot : Robot
    rows : iterable of StiffnessRow
        As `stiffness_study` returns them.
    directory : path

    Returns
    -------
    Path
    """
    units = joint_units(robot)
    curves = stiffness_curves(rows)
    figures = PageFigures("stiffness")
    figures.draw("tangent", tangent_figure(curves, units, low_torque=False), "Tangent stiffness")
    figures.draw("low_torque", tangent_figure(curves, units, low_torque=True), "Near zero torque")
    figures.draw("loss", loss_figure(curves, units), "Against the reducer alone")
    figures.draw("shares", shares_figure(robot, units), "What yields")
    context = {
        "title": f"Joint stiffness of {robot.title or robot.name}",
        "largest": _largest_loss(curves),
        "where": where_contacts_matter(curves, [unit.label for unit in units]),
        "curves": curves,
        "units": units,
        "slip": _first_slips(robot),
        "loading": _contact_loading(robot),
        "estimated": estimated_inputs(robot),
        "references": robot_references(robot),
    }
    return write_page("stiffness/page.html.j2", Path(directory) / PAGE_FILE, context, figures)


def where_contacts_matter(
    curves: Mapping[int, Sequence[StiffnessCurve]], labels: Sequence[str]
) -> str:
    """Sentences on the torque at which contacts take most of each joint's stiffness."""
    groups: dict[str, list[str]] = {}
    for joint, (own, *_) in curves.items():
        at = own.ratio_of_largest_loss
        if not np.any(own.loss > 0.0):
            where = "at no torque"
        elif at == own.ratio[0]:
            where = f"at the least torque shown, {percent(at)} of the largest"
        elif at == own.ratio[-1]:
            where = "at the largest torque"
        else:
            where = f"at {percent(at)} of the largest torque"
        ends = " to ".join(percent(float(own.loss[end])) for end in (0, -1))
        groups.setdefault(where, []).append(f"{labels[joint - 1]} ({ends})")
    told = "; ".join(f"{where} in {listed(joints)}" for where, joints in groups.items())
    return (
        f"Contacts take most of the stiffness {told}. In brackets: the share that they take, from "
        "the least torque shown to the largest."
    )


def _largest_loss(curves: Mapping[int, Sequence[StiffnessCurve]]) -> LargestLoss:
    every = (
        LargestLoss(float(own.loss.max()), joint, own.ratio_of_largest_loss)
        for joint, (own, *_) in curves.items()
    )
    return max(every, key=lambda each: (each.loss, -each.joint))


def _contact_loading(robot: Robot) -> str:
    """Loading of the rough contacts that the robot file states."""
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
