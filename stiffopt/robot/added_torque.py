"""Torques of joints beyond rigid bodies and friction: functions of the arm's motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

# Array of floats or symbols.
Quantity = Any


@dataclass(frozen=True, kw_only=True)
class MotionState:
    """Motion and loads of all joints, one entry of a list each: floats, arrays (K,) or symbols."""

    # [rad], [rad/s], [rad/s^2].
    position: Sequence[Quantity]
    velocity: Sequence[Quantity]
    acceleration: Sequence[Quantity]
    direction: Sequence[Quantity]  # sign of the velocity, smooth where the formulas are to be
    load: Sequence[Quantity]  # torque of the rigid bodies in the joint's spring [N m]

    def at_rest(self, load: Sequence[Quantity]) -> MotionState:
        """Return the state at rest in the same pose, under the load there."""
        still = [0.0 * each for each in self.position]
        return MotionState(
            position=self.position, velocity=still, acceleration=still, direction=still, load=load
        )


@dataclass(frozen=True, kw_only=True)
class AddedTorque:
    """A torque that the drive of one joint has to overcome."""

    joint: int  # from 0
    in_spring: bool  # True for a torque on the link, which the joint's spring carries too
    # Motion of all joints -> torque [N m]; formulas in plain NumPy.
    value: Callable[[MotionState], Quantity]
    label: str  # name and place, for messages

    def moved(self, places: Sequence[int]) -> AddedTorque:
        """Return the torque in an arm that has these joints at other places."""

        def value(state: MotionState) -> Quantity:
            own = {each.name: getattr(state, each.name) for each in fields(state)}
            return self.value(
                MotionState(**{name: [all_[k] for k in places] for name, all_ in own.items()})
            )

        return replace(self, joint=int(places[self.joint]), value=value)


def sum_added_torques(
    added: Sequence[AddedTorque], state: MotionState, *, in_spring: bool
) -> list[Quantity]:
    """Return the sum of the torques in every joint's spring, or of those on the drives alone."""
    sums: list[Quantity] = [0.0 * each for each in state.position]
    for each in added:
        if each.in_spring == in_spring:
            sums[each.joint] = sums[each.joint] + each.value(state)
    return sums
