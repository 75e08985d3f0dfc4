"""What was found as values of a robot: old and new, for a table and for the files of others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.discovery.comparison.signals import RobotConstants
from stiffopt.discovery.extended.model import ExtendedModel, robot_signature
from stiffopt.robot.robot import Robot
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.discovery.comparison.extension import Extension
    from stiffopt.recording.recording_set import RecordingSet

# Values of a joint: attribute of the robot, words, unit.
_JOINT_VALUES = (
    ("coulomb", "Coulomb friction", "N m"),
    ("viscous", "viscous friction", "N m s/rad"),
    ("rotor_inertia", "rotor inertia", "kg m^2"),
)
# Relative difference below which a value is the same.
_EQUALITY_TOLERANCE = 1e-6


@dataclass(frozen=True)
class ValueChange:
    """One value of the nominal robot and what it should be.

    Parameters
    ----------
    joint : int
        From 1; of a body, the joint that carries it.
    name : str
        Of the joint.
    quantity : str
    old, new : float
        In `unit`.
    unit : str
    """

    joint: int
    name: str
    quantity: str
    old: float
    new: float
    unit: str


def value_changes(nominal: Robot, found: Robot) -> list[ValueChange]:
    """Values in which two robots of the same joints differ, joint by joint.

    Parameters
    ----------
    nominal, found : Robot
        Before and after; frictions and rotor inertias at the joint's output, bodies with all that
        is fixed to them.
    """
    changes = []
    for j, name in enumerate(nominal.joint_names):
        slides = bool(nominal.prismatic[j])
        pairs = [
            (words, getattr(nominal, key)[j], getattr(found, key)[j], joint_unit(unit, slides))
            for key, words, unit in _JOINT_VALUES
        ]
        bodies = nominal.tree.bodies[j], found.tree.bodies[j]
        pairs.append(("mass behind it", bodies[0].mass, bodies[1].mass, "kg"))
        pairs += [
            (f"centre of mass, {axis}", *(body.centre[k] for body in bodies), "m")
            for k, axis in enumerate("xyz")
        ]
        pairs += [
            (
                f"inertia about the centre, {axis}{axis}",
                *(b.inertia[k, k] for b in bodies),
                "kg m^2",
            )
            for k, axis in enumerate("xyz")
        ]
        changes += [
            ValueChange(j + 1, name, words, float(old), float(new), unit)
            for words, old, new, unit in pairs
            if abs(new - old) > _EQUALITY_TOLERANCE * max(abs(old), abs(new))
        ]
    return changes


def extended_model(
    recordings: RecordingSet, constants: RobotConstants, extension: Extension
) -> ExtendedModel:
    """The extended model of a diagnosis, as its extended.toml says it."""
    joints = constants.joints
    return ExtendedModel(
        source=str(recordings.path),
        name=recordings.name,
        joints=recordings.joints,
        robot=robot_signature(recordings.robot, recordings.order),
        nominal=recordings.stated,
        chains=tuple(joint.chain for joint in joints),
        scales={
            name: tuple(float(getattr(joint, name)) for joint in joints)
            for name in ("torque_rated", "torque_max", "fastest")
        },
        extension=extension,
        # Terms are made from what was fitted; reported values are for readers of the file.
        parameters=({},) * len(extension.effects),
    )


def torque_gains(model: ExtendedModel) -> np.ndarray:
    """Torque that a joint gives for one that its drive reports (n,): below 1, it reports more."""
    gains = np.ones(len(model.joints))
    for estimated in model.extension.effects:
        located = estimated.located
        if located.effect.name == "torque_gain" and located.joint is not None:
            gains[located.joint] /= 1.0 + float(estimated.amplitudes[0])
    return gains
