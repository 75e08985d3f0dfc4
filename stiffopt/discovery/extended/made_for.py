"""Which robot an extended model was made for, by numbers that a name cannot pretend."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.discovery.extended.schema import MadeForSection
from stiffopt.errors import InputFileError
from stiffopt.robot.robot import Robot

# Lengths of the same arm agree within this [m], and masses within this share: descriptions of one
# arm differ by rounding and by what is counted to which link.
_LENGTH, _MASS = 5e-3, 0.3


def made_for(robot: Robot, order: Sequence[int] | np.ndarray) -> MadeForSection:
    """Name, lengths and masses of a robot's joints in this order (indices from 0)."""
    bodies = [robot.tree.bodies[int(j)] for j in order]
    return MadeForSection(
        name=robot.name,
        lengths=tuple(float(np.linalg.norm(body.translation)) for body in bodies),
        masses=tuple(float(body.mass) for body in bodies),
    )


def require_same_robot(
    section: MadeForSection | None,
    source: str,
    joints: Sequence[str],
    robot: Robot,
    place: Sequence[int] | np.ndarray,
) -> None:
    """Raise `InputFileError` where an extended model is of another robot.

    Parameters
    ----------
    section : MadeForSection or None
        None in files that do not say; their joints must then be the robot's by name.
    source : str
        Of the file, for messages.
    joints : sequence of str
        Of the model.
    robot : Robot
    place : sequence of int
        Index of each joint of the model among those of the robot.
    """
    same_names = set(joints) <= set(robot.joint_names)
    if section is None:
        if not same_names:
            raise InputFileError(
                source,
                "joints",
                f"this model is of {', '.join(joints)}, the robot {robot.name} has"
                f" {', '.join(robot.joint_names)}. Give the model of the same robot.",
            )
        return
    if len(joints) < robot.n:
        # Joints that were held belong to other bodies here: only the names can be compared.
        return
    own = made_for(robot, place)
    wrong = _difference(section, own)
    if wrong:
        raise InputFileError(
            source,
            "robot",
            f"this model was made for the robot {section.name} ({', '.join(joints)}), not for"
            f" {robot.name}: {wrong}. Diagnose recordings of {robot.name}, or solve with the robot"
            " of the model.",
        )


def _difference(stated: MadeForSection, own: MadeForSection) -> str:
    if len(stated.lengths) != len(own.lengths) or len(stated.masses) != len(own.masses):
        return f"it has {len(own.masses)} joints, the model {len(stated.masses)}"
    # The first length is where the base stands, the last mass has the payload in it.
    for j in range(1, len(own.lengths)):
        if abs(stated.lengths[j] - own.lengths[j]) > _LENGTH:
            return (
                f"joint {j + 1} lies {own.lengths[j]:.4g} m from the joint before, in the model"
                f" {stated.lengths[j]:.4g} m"
            )
    for j in range(len(own.masses) - 1):
        if abs(stated.masses[j] - own.masses[j]) > _MASS * max(stated.masses[j], own.masses[j]):
            return (
                f"the body behind joint {j + 1} has {own.masses[j]:.4g} kg, in the model"
                f" {stated.masses[j]:.4g} kg"
            )
    return ""
