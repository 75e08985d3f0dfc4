"""A first motion of a robot: about the middle of its ranges, within limits, free of collisions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.errors import NotSimulatedError, RobotError
from stiffopt.robot.cell import Cell
from stiffopt.robot.clearance import ClearanceModel
from stiffopt.robot.robot import Robot

# Share of each range that the motion covers, and of an endless joint [rad].
_SHARE, _ENDLESS = 0.15, 0.6
# Over the shortest time that the quintic motion needs.
_ROOM = 2.0
_TRIES = 200
# Of the torque limits: what the weight may take, and what the quintic motion may.
_WEIGHT, _TORQUE = 0.7, 0.8
# Places on the way that are looked at, and by how much a motion that needs too much is slowed.
_PLACES, _SLOWER, _SLOWEST = 21, 1.2, 30


@dataclass(frozen=True, eq=False)
class FirstMotion:
    """Poses (n,) [rad] and a duration [s] that an arm can make.

    Parameters
    ----------
    start, end : array (n,)
    duration : float
    yields : bool
        Whether the tool yields on the way and the arm can swing.
    """

    start: np.ndarray
    end: np.ndarray
    duration: float
    yields: bool


def first_motion(robot: Robot) -> FirstMotion:
    """Find a motion that drives hold, that meets nothing of the arm, above its base if possible.

    Raises
    ------
    RobotError
        No pose was found that the drives can hold, or none without a collision.
    """
    start, end = _poses(robot)
    yields = robot.tool_yields(_between(start, end))
    swing = _swing(robot, start) if yields else None
    return FirstMotion(start, end, _duration(robot, start, end, swing or 0.0), swing is not None)


def _between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Poses along the straight way (_PLACES, n)."""
    return np.asarray(start + np.linspace(0.0, 1.0, _PLACES)[:, None] * (end - start))


def _poses(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    low, high = robot.position_lower, robot.position_upper
    finite = np.isfinite(high - low)
    low, high = np.where(finite, low, 0.0), np.where(finite, high, 0.0)
    middle = 0.5 * (low + high)
    half = np.where(finite, 0.5 * _SHARE * (high - low), 0.5 * _ENDLESS)
    half = np.minimum(half, np.where(robot.prismatic, np.inf, 0.5 * _ENDLESS))
    random = np.random.default_rng(1)
    bodies, shapes = robot.rigid_bodies(), ClearanceModel(robot, Cell())
    least, least_joint, needed, met, below = np.inf, 0, 0.0, ("", ""), None
    for trial in range(_TRIES):
        centre = middle
        if trial:
            span = np.where(finite, 0.3 * (high - low), 1.0)
            centre = middle + random.uniform(-1.0, 1.0, robot.n) * span
        start, end = np.round(centre - half, 3), np.round(centre + half, 3)
        way = _between(start, end)
        weight = np.max([np.abs(bodies.gravity_torque(pose)) for pose in way], axis=0)
        share = weight / robot.torque_max
        if share.max() < least:
            least, least_joint = float(share.max()), int(np.argmax(share))
            needed = float(weight[least_joint])
        if share.max() > _WEIGHT:
            continue
        distances = [shapes.distances(pose) for pose in way]
        worst = min(distances, key=lambda each: float(each.min(initial=np.inf)))
        if worst.min(initial=np.inf) <= 0.0:
            met = shapes.pairs[int(np.argmin(worst))]
            continue
        if min(bodies.pose(robot.tool, pose)[0][2] for pose in way) > 0.0:
            return start, end
        below = below or (start, end)
    if below is not None:
        return below
    if least <= _WEIGHT:
        raise RobotError(
            f"{robot.name}: in all of {_TRIES} poses that its drives hold {met[0]} is in {met[1]}."
            " Correct the collision shapes of the URDF, or write the problem by hand with"
            " method.collisions = 'check'."
        )
    raise RobotError(
        f"{robot.name}: in none of {_TRIES} poses do its drives hold its weight:"
        f" {robot.joint_names[least_joint]} has {robot.torque_max[least_joint]:g} N m and needs"
        f" {needed:.3g} at least, and room to move. Correct torque_max of the robot file, or its"
        " masses."
    )


def _swing(robot: Robot, pose: np.ndarray) -> float | None:
    """Period of the arm's lowest mode [s]; None for an arm that does not swing."""
    try:
        found = modes(ElasticArm(robot, pose), pose)
    except NotSimulatedError:
        return None
    return 1.0 / found[0].frequency if found else None


def _duration(robot: Robot, start: np.ndarray, end: np.ndarray, swing: float) -> float:
    """Of a quintic motion within velocity, acceleration, jerk and torque, with room and swings."""
    way = np.abs(end - start)
    times = (
        (1.875 * way / robot.velocity_max).max(),
        np.sqrt(5.78 * way / robot.acceleration_max).max(),
        np.cbrt(60.0 * way / robot.jerk_max).max(),
        0.2,
    )
    duration = float(_ROOM * max(times) + 2.0 * swing)
    for _ in range(_SLOWEST):
        if _torque_share(robot, start, end, duration) <= _TORQUE:
            break
        duration *= _SLOWER
    return float(np.ceil(10.0 * duration) / 10.0)


def _torque_share(robot: Robot, start: np.ndarray, end: np.ndarray, duration: float) -> float:
    """Largest share of a torque limit that the quintic motion takes, friction included."""
    bodies, way = robot.rigid_bodies(), end - start
    s = np.linspace(0.0, 1.0, _PLACES)
    place = s**3 * (10.0 + s * (6.0 * s - 15.0))
    speed = 30.0 * s**2 * (1.0 - s) ** 2 / duration
    rate = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / duration**2
    rows = zip(start + place[:, None] * way, speed[:, None] * way, rate[:, None] * way, strict=True)
    torque = np.max([np.abs(bodies.torque(q, v, a)) for q, v, a in rows], axis=0)
    torque = (
        torque
        + np.nan_to_num(robot.coulomb)
        + np.nan_to_num(robot.viscous) * np.abs(way) * speed.max()
    )
    return float((torque / robot.torque_max).max())
