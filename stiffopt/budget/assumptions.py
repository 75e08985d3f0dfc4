"""Assumptions of an error budget, in sentences."""

from __future__ import annotations

import numpy as np

from stiffopt.budget.budget import ErrorModel


def list_assumptions(model: ErrorModel, *, solved: bool) -> tuple[str, ...]:
    """Return the assumptions of a budget; `solved`: of a solved motion."""
    found = [
        "Errors are small: their effects on the tool are linear and add up.",
        "Sources are independent and normally distributed; tolerances and uncertainties are 95 % "
        "bounds. Geometric tolerances are those of [tolerances], with typical defaults.",
        "Output bearings and links yield where the robot file says so, and are rigid elsewhere."
        if model.robot.tilts
        else "Bearings and links are rigid: joints yield about their axes only.",
        "Springs carry the torque of the motion without vibration: `stiffopt simulate` adds it.",
        *model.uncertainty.statements(model.robot.payload is not None),
    ]
    if not solved:
        found.append("The motion is the quintic one at the least duration that the problem allows.")
    if model.compensated:
        found.append("The command leads by the wind-up: only its uncertain part is an error.")
    elif model.robot.yields:
        found.append("Motors follow the plan: the wind-up is an error, known as it is.")
    if model.robot.hysteresis is None or not np.any(model.robot.hysteresis):
        found.append("No joint states its hysteresis: loops of typical width are assumed.")
    return tuple(found)
