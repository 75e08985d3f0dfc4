"""Rated life of a robot's reducers, at the output of their joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Exponent of reducers without a rating: strain-wave gears.
_USUAL_EXPONENT = 3.0


@dataclass(frozen=True, kw_only=True)
class LifeRating:
    """Rated life of a reducer."""

    # At the output [N m], [rad/s].
    torque: float
    speed: float
    life: float | None  # L10 [s]; None where it is not known
    exponent: float  # of the torque


def life_rating(robot: Robot, joint: int) -> LifeRating:
    """Return the rating of the reducer of a joint; the drive's limits without one."""
    chain = robot.chains[joint]
    for stage in () if chain is None else chain.stages:
        # Elements of other kinds, which this layer does not import, have no rating.
        names = ("rated_torque", "rated_speed", "rated_life", "life_exponent")
        rated = [getattr(stage.element, name, None) for name in names]
        if None not in rated:
            torque, speed, life, exponent = np.array(rated, dtype=float).tolist()
            return LifeRating(
                torque=torque * stage.reduction,
                speed=speed / stage.ratio,
                life=life,
                exponent=exponent,
            )
    return LifeRating(
        torque=float(robot.torque_max[joint]),
        speed=float(robot.velocity_max[joint]),
        life=None,
        exponent=_USUAL_EXPONENT,
    )
