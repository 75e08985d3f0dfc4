"""Connections that a motion makes slip: preloaded too little for the torque they carry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.exact.chain import stage_slip_torque

if TYPE_CHECKING:
    from stiffopt.result.assessment import Assessment
    from stiffopt.robot.robot import Robot


@dataclass(frozen=True)
class Slip:
    """A connection that slips.

    Parameters
    ----------
    element : str
        Several that act in parallel are told as one.
    joint : int
        1-based.
    holds, carries : float
        Torque of the joint at which it slips, and the largest of the motion [N m].
    time : float
        When it first slips [s].
    """

    element: str
    joint: int
    holds: float
    carries: float
    time: float

    def describe(self) -> str:
        """Text for messages: "flange of joint 2 holds 30 N m and is asked for 41 N m, ..."."""
        return (
            f"{self.element} of joint {self.joint} holds {self.holds:.3g} N m and is asked for "
            f"{self.carries:.3g} N m, first too much at {self.time:.3f} s"
        )


def find_slips(robot: Robot, motion: Assessment) -> tuple[Slip, ...]:
    """Connections that slip in a motion, joint by joint.

    Parameters
    ----------
    robot : Robot
    motion : Assessment
    """
    found = []
    for j, chain in enumerate(robot.chains):
        torque = np.abs(motion.spring_torque[:, j])
        for group in () if chain is None else chain.groups(None):
            holds = sum(stage_slip_torque(stage, None) for stage in group)
            if torque.max() < holds:
                continue
            name = " with ".join(stage.element.name for stage in group)
            first = float(motion.time[int(np.argmax(torque >= holds))])
            found.append(Slip(name, j + 1, holds, float(torque.max()), first))
    return tuple(found)


def describe_slips(found: tuple[Slip, ...]) -> str:
    """What slips, and what to do; begins within a sentence."""
    return (
        f"connections slip: {'; '.join(slip.describe() for slip in found)}. Preload them more "
        "(stiffopt preload finds how far), or plan a motion with less torque."
    )
