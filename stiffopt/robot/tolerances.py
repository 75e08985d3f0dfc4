"""Tolerances of an arm's geometry and temperature."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import Annotated, Literal

from stiffopt.declaration import NOT_NEGATIVE, Angle, Bounds, Doc, Length, Ratio, check_fields
from stiffopt.errors import ProblemError

# A tolerance is a 95 % bound of a normal distribution.
TOLERANCE_IN_STANDARD_DEVIATIONS = 2.0
_FRAME_ORIENTATION, _JOINT_ZERO = radians(0.01), radians(0.005)  # without calibration [rad]
# Below any growth by temperature; above, a temperature was given.
_MAX_GROWTH = 0.01


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Tolerances of geometry: 95 % bounds of every axis, independent and normally distributed.

    The defaults are typical of arms without individual calibration (estimated).
    """

    frame_position: Annotated[
        Length, NOT_NEGATIVE, Doc("Position of each joint's frame on the link before, each axis.")
    ] = 5e-5
    frame_orientation: Annotated[
        Angle, NOT_NEGATIVE, Doc("Orientation of each joint's frame on the link before, each axis.")
    ] = _FRAME_ORIENTATION
    joint_zero: Annotated[
        Angle,
        NOT_NEGATIVE,
        Doc("Zero position of each revolute joint; of a prismatic one it is frame_position."),
    ] = _JOINT_ZERO
    tool_position: Annotated[
        Length, NOT_NEGATIVE, Doc("Position of the tool on its link, each axis.")
    ] = 5e-5
    tool_orientation: Annotated[
        Angle, NOT_NEGATIVE, Doc("Orientation of the tool on its link, each axis.")
    ] = _FRAME_ORIENTATION
    base_position: Annotated[
        Length, NOT_NEGATIVE, Doc("Position of the base in the cell, each axis.")
    ] = 0.0
    base_orientation: Annotated[
        Angle, NOT_NEGATIVE, Doc("Orientation of the base in the cell, each axis.")
    ] = 0.0
    thermal_growth: Annotated[
        Ratio,
        Bounds(least=0.0, most=_MAX_GROWTH),
        Doc(
            "Relative growth of the arm by unknown temperature: 12e-6 per kelvin of steel, 23e-6 "
            "of aluminium, times the kelvins."
        ),
    ] = 3e-5
    reference: Annotated[
        Literal["base", "start"],
        Doc(
            "Errors relative to the base, or to the start of the motion, which was taught: what "
            "is wrong there is then no error."
        ),
    ] = "base"

    def __post_init__(self) -> None:
        check_fields(self, "tolerances", ProblemError)
