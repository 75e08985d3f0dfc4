"""Findings of a diagnosis as changes of attributes of the MJCF that describes the robot."""

from __future__ import annotations

from dataclasses import dataclass

# Relative change below which a value is that of the file: robot files have six digits.
_MIN_RELATIVE_CHANGE = 1e-5
_DIGITS = 8
# Attributes of a joint, and of the robot; unit of a hinge.
_JOINT_VALUES = (
    ("frictionloss", "coulomb", "N m"),
    ("damping", "viscous", "N m s/rad"),
    ("armature", "rotor_inertia", "kg m^2"),
)
# Other ways to give the inertia, which `fullinertia` replaces.
_INERTIA_ATTRIBUTES = ("diaginertia", "quat", "axisangle", "xyaxes", "zaxis", "euler")


@dataclass(frozen=True, kw_only=True)
class AttributeChange:
    """Changed attribute of an element.

    Parameters
    ----------
    file, element, name, attribute : str
        Such as "arm.xml", "joint", "elbow", "frictionloss".
    line : int
        Of the element in the file, as it was.
    old, new : str
        Values in the units of the file; the old one may be that of a default class.
    unit : str
    """

    file: str
    line: int
    element: str
    name: str
    attribute: str
    old: str
    new: str
    unit: str
