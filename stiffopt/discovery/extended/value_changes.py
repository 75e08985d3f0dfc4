"""Findings as values of a robot, old and new, for tables and exported files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.discovery.extended.model import VALUE_TOLERANCE, ExtendedModel, robot_signature
from stiffopt.discovery.signals import JOINT_SCALES, RobotConstants
from stiffopt.robot.robot import Robot
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.discovery.comparison.located_effect import Extension
    from stiffopt.recording.recording_set import RecordingSet

# Values of a joint: attribute of the robot, words, unit.
_JOINT_VALUES = (
    ("coulomb", "Coulomb friction", "N m"),
    ("viscous", "viscous friction", "N m s/rad"),
    ("rotor_inertia", "rotor inertia", "kg m^2"),
)


@dataclass(frozen=True)
class ValueChange:
    """A value of the nominal robot and its corrected value."""

    joint: int  # from 1, in the order of the set; of a body, the joint that carries it
    name: str  # of the joint
    quantity: str
    # old, new: in `unit`.
    old: float
    new: float
    unit: str


def value_changes(nominal: Robot, found: Robot, order: np.ndarray) -> list[ValueChange]:
    """Return the values in which two robots with the same joints differ, joint by joint.

    `nominal`, `found`: friction and rotor inertia at the joint's output; bodies include all that is
    fixed to them. `order` (n,): the robot's joints (from 0) in the order of the set.
    """
    changes = []
    for number, j in enumerate(order.tolist(), start=1):
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
            ValueChange(number, nominal.joint_names[j], words, float(old), float(new), unit)
            for words, old, new, unit in pairs
            if abs(new - old) > VALUE_TOLERANCE * max(abs(old), abs(new))
        ]
    return changes


def extended_model(
    recordings: RecordingSet, constants: RobotConstants, extension: Extension
) -> ExtendedModel:
    """Return the extended model of a diagnosis, as in its extended.toml."""
    joints = constants.joints
    return ExtendedModel(
        source=str(recordings.path),
        name=recordings.name,
        joints=recordings.joints,
        robot=robot_signature(recordings.robot, recordings.order),
        nominal=recordings.stated,
        chains=tuple(joint.chain for joint in joints),
        scales={
            name: tuple(float(getattr(joint, name)) for joint in joints) for name in JOINT_SCALES
        },
        extension=extension,
        # Terms use fitted amplitudes; reported values are for readers of the file.
        parameters=({},) * len(extension.effects),
    )


def torque_gains(model: ExtendedModel) -> np.ndarray:
    """Return the ratio of a joint's torque to that reported by its drive (n,)."""
    gains = np.ones(len(model.joints))
    for estimated in model.extension.effects:
        located = estimated.located
        if "torque_constant" in located.effect.tolerances and located.joint is not None:
            gains[located.joint] /= 1.0 + float(estimated.amplitudes[0])
    return gains


def joint_zeros(model: ExtendedModel) -> np.ndarray:
    """Return the position of each joint where its encoder reads 0 (n,) [rad]."""
    zeros = np.zeros(len(model.joints))
    for estimated in model.extension.effects:
        located = estimated.located
        if located.effect.moves_zero and located.joint is not None:
            zeros[located.joint] += float(estimated.amplitudes[0])
    return zeros
