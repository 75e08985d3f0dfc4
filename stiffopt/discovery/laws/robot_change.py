"""Change of a planner's robot by a law: a value of the joint, or a torque along its motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stiffopt.discovery.effect import RobotChange
from stiffopt.discovery.laws.law import Law
from stiffopt.formatting import significant
from stiffopt.robot.added_torque import AddedTorque, MotionState, Quantity
from stiffopt.robot.robot import Robot

# Signals that a planned motion has, and their names in its state.
_PLANNED_SIGNALS = {
    "position": "position",
    "speed": "velocity",
    "direction": "direction",
    "acceleration": "acceleration",
    "load": "load",
}
# Forms that are steep at zero where their exponent, the only shape, is below 1.
_STEEP_FORMS = {"power", "signed_power"}
# Laws in proportion to one signal of their own joint that are a value of the robot.
_ROBOT_VALUES = {"direction": "coulomb", "speed": "viscous", "acceleration": "rotor_inertia"}


@dataclass(frozen=True)
class _LawTorque:
    """Torque of a law along a planned motion [N m]."""

    law: Law
    amplitudes: tuple[float, ...]
    place: tuple[int, ...]  # the robot's index of every joint of the law's model

    def __call__(self, state: MotionState) -> Quantity:
        found: list[Quantity] = [1.0]
        for factor in self.law.factors:
            assert factor.source.joint is not None
            signal = getattr(state, _PLANNED_SIGNALS[factor.source.kind])
            x = signal[self.place[factor.source.joint]]
            # Forms without memory use no time step.
            values = factor.own.values(x, np.nan, None, factor.shapes)
            found = [a * b for a in found for b in values]
        return sum(a * c for a, c in zip(self.amplitudes, found, strict=True))


def law_change(
    robot: Robot, law: Law, amplitudes: Sequence[float], place: Sequence[int], label: str
) -> RobotChange:
    """Return a robot with a law, or the reason why none can be planned with.

    `place`: the robot's index of every joint of the law's model. `label`: name of the law and its
    place.
    """
    reason = _why_not_planned(law)
    if reason:
        return RobotChange(None, reason)
    joint = place[law.joint]
    values = ", ".join(
        f"{name} = {significant(value)}"
        for name, value in (
            *zip(law.amplitude_names, amplitudes, strict=True),
            *zip(law.shape_names, law.shapes, strict=True),
        )
    )
    sentence = f"Joint {joint + 1}: {law.equation} with {values}."
    changed = _with_joint_value(robot, law, amplitudes[0], joint)
    if changed is None:
        added = AddedTorque(
            joint=joint,
            in_spring=law.place == "link_torque",
            value=_LawTorque(law, tuple(amplitudes), tuple(place)),
            label=label,
        )
        changed = replace(robot, added_torques=(*robot.added_torques, added))
    return RobotChange(changed, sentence)


def _with_joint_value(robot: Robot, law: Law, amplitude: float, joint: int) -> Robot | None:
    """Return the robot with another friction or rotor inertia; None where the law is neither."""
    if law.place != "drive_torque" or len(law.factors) != 1:
        return None
    (factor,) = law.factors
    name = _ROBOT_VALUES.get(factor.source.kind)
    if name is None or factor.form != "linear" or factor.source.joint != law.joint:
        return None
    values = np.array(getattr(robot, name), dtype=float)
    values[joint] += amplitude
    changed: dict[str, Any] = {name: values}
    return replace(robot, **changed) if values[joint] >= 0.0 else None


def _why_not_planned(law: Law) -> str:
    """Return why a plan cannot contain a law; "" where it can."""
    if law.place == "deflection":
        return "a law of the deflection, which the planner's springs have no place for"
    for factor in law.factors:
        if factor.source.kind not in _PLANNED_SIGNALS:
            return f"a law of the {factor.source.words}, which a plan does not contain"
        if factor.own.has_memory:
            return f"a law of the past {factor.source.words}, which a plan does not contain"
        if any(each.form in _STEEP_FORMS and each.shapes[0] < 1.0 for each in factor.parts):
            return f"a law as steep as no optimiser takes where the {factor.source.words} is zero"
    return ""
