"""Rated life of a robot's reducers, at the output of their joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from stiffopt.connection.reducer import Reducer

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Exponent of reducers without a rating: strain-wave gears.
_USUAL_EXPONENT = 3.0


@dataclass(frozen=True, kw_only=True)
class LifeRating:
    """Rated life of a reducer.

    Parameters
    ----------
    torque, speed : float
        At the output [N m], [rad/s].
    life : float or None
        L10 [s]; None where it is not known.
    exponent : float
        Of the torque.
    """

    torque: float
    speed: float
    life: float | None
    exponent: float


def life_rating(robot: Robot, joint: int) -> LifeRating:
    """Return the rating of the reducer of a joint; the drive's limits without one."""
    chain = robot.chains[joint]
    for stage in () if chain is None else chain.stages:
        own = stage.element
        if not isinstance(own, Reducer) or own.rated_torque is None or own.rated_speed is None:
            continue
        if own.rated_life is not None and own.life_exponent is not None:
            return LifeRating(
                torque=own.rated_torque * stage.reduction,
                speed=own.rated_speed / stage.ratio,
                life=own.rated_life,
                exponent=own.life_exponent,
            )
    return LifeRating(
        torque=float(robot.torque_max[joint]),
        speed=float(robot.velocity_max[joint]),
        life=None,
        exponent=_USUAL_EXPONENT,
    )
