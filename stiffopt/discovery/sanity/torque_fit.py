"""Share of a measured torque that a nominal torque leaves, with what a robot may have besides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear, minimize_scalar

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.signals import smooth_sign
from stiffopt.discovery.settings import MIN_MOVING_SPEED

# A stated friction or rotor inertia may be wrong by this much of itself, down and up: far more
# than drives and cold grease make of it, far less than a unit does.
_MAX_RELATIVE_DECREASE, _MAX_RELATIVE_INCREASE = 0.8, 10.0
# Load-dependent friction, share of the load.
_MAX_LOAD_FRICTION = 0.4
# A drive's constant offset, share of the largest nominal torque.
_MAX_OFFSET_SHARE = 0.5
# Mass at the end of the arm that its model may lack or have in excess, share of the arm's; and how
# far it may reach out [m].
_MAX_PAYLOAD_SHARE, _MAX_PAYLOAD_LEVER = 1.0, 0.5
# Weight that a spring may carry, over the largest there is.
_MAX_SPRING_SHARE = 0.9
# Fewer moving instants, or less travel, decide nothing.
_MIN_MOVING_INSTANTS = 60
# Gains that are tried, either sign, and how finely.
_EQUIVALENT_SHARE = 0.02
_GAIN_GRID = np.logspace(-4.5, 4.5, 61)


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion and what the nominal model says of it, as some description of the files has it.

    Parameters
    ----------
    position, velocity, acceleration : array (m, n)
    spring : array (m, n)
        Nominal torque of the bodies and balances [N m].
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    spring: np.ndarray

    @staticmethod
    def of(robot: RobotModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Motion:
        """A motion by the nominal model."""
        return Motion(q, v, a, robot.spring_torque(q, v, a))


@dataclass(frozen=True, eq=False)
class Additions:
    """Columns (m, k) that a nominal torque may be given, and how much of each, from and to (k,)."""

    columns: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


class TorqueFit:
    """What a robot like the nominal one leaves of measured torques.

    Parameters
    ----------
    robot : RobotModel
    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot

    def left(
        self, motion: Motion, torque: np.ndarray, joint: int, extra: Additions | None = None
    ) -> float:
        """Share of a torque's variance (m,) that stays, 0 to far above 1; nan where undecidable.

        Parameters
        ----------
        motion : Motion
        torque : array (m,)
            Measured [N m].
        joint : int
        extra : Additions, optional
            What may be added besides, such as springs and payloads.
        """
        reduced = self._reduce_table(motion, torque, joint, extra)
        return float("nan") if reduced is None else reduced.share(1.0)

    def gain(
        self, motion: Motion, torque: np.ndarray, joint: int, usual: Sequence[float]
    ) -> tuple[float, float]:
        """Factor of either sign by which a torque fits best, and the share that then stays.

        A usual factor is preferred where it fits nearly as well.
        """
        reduced = self._reduce_table(motion, torque, joint, None)
        if reduced is None:
            return float("nan"), float("nan")
        every = [*-_GAIN_GRID[::-1], *_GAIN_GRID]
        shares = [reduced.share(g) for g in every]
        best = int(np.argmin(shares))
        sign, log = np.sign(every[best]), np.log(abs(every[best]))
        step = float(np.log(_GAIN_GRID[1] / _GAIN_GRID[0]))
        found = minimize_scalar(
            lambda x: reduced.share(sign * np.exp(x)),
            bounds=(log - step, log + step),
            method="bounded",
            options={"xatol": 1e-3},
        )
        good = {
            g: share
            for g in usual
            if (share := reduced.share(g)) < 1.5 * found.fun + _EQUIVALENT_SHARE
        }
        if good:
            return min(good.items(), key=lambda one: one[1])
        return float(sign * np.exp(found.x)), float(found.fun)

    def _reduce_table(
        self, motion: Motion, torque: np.ndarray, joint: int, extra: Additions | None
    ) -> _ReducedTable | None:
        speed = motion.velocity[:, joint]
        rows = (np.abs(speed) >= MIN_MOVING_SPEED) & np.isfinite(torque)
        if rows.sum() < _MIN_MOVING_INSTANTS or np.ptp(torque[rows]) == 0.0:
            return None
        robot, spring = self.robot, motion.spring[:, joint]
        direction = smooth_sign(speed)
        acceleration = motion.acceleration[:, joint]
        stated = (
            (robot.coulomb[joint], direction),
            (robot.viscous[joint], speed),
            (robot.rotor_inertia[joint], acceleration),
        )
        nominal = spring + sum(value * column for value, column in stated)
        offset = _MAX_OFFSET_SHARE * float(np.abs(nominal[rows]).max())
        columns = [np.ones_like(speed), np.abs(spring) * direction]
        lower, upper = [-offset, 0.0], [offset, _MAX_LOAD_FRICTION]
        for value, column in stated:
            columns.append(column)
            lower.append(-_MAX_RELATIVE_DECREASE * value)
            upper.append(_MAX_RELATIVE_INCREASE * value if value > 0.0 else np.inf)
        if extra is not None:
            columns += list(extra.columns.T)
            lower += list(extra.lower)
            upper += list(extra.upper)
        table = np.column_stack([torque, nominal, *columns])[rows]
        variance = float(np.sum((table[:, 0] - table[:, 0].mean()) ** 2))
        triangle = np.asarray(np.linalg.qr(table, mode="r"))
        return _ReducedTable(triangle, np.array(lower), np.array(upper), variance)


@dataclass(frozen=True, eq=False)
class _ReducedTable:
    """A table (torque, nominal, columns) by its triangle, which has the same squares."""

    triangle: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    variance: float

    def share(self, gain: float) -> float:
        """Share of the variance that gain times (nominal and columns within bounds) leaves."""
        target = self.triangle[:, 0] / gain - self.triangle[:, 1]
        matrix = self.triangle[:, 2:]
        size = np.linalg.norm(matrix, axis=0)
        kept = size > 0.0
        matrix, size = matrix[:, kept] / size[kept], size[kept]
        lower, upper = self.lower[kept] * size, self.upper[kept] * size
        # Bounds that touch leave a column nothing to do.
        free = upper > lower
        found = lsq_linear(matrix[:, free], target, (lower[free], upper[free]), method="bvls")
        return float(2.0 * found.cost * gain**2 / self.variance)


def allowed_additions(robot: RobotModel, motion: Motion, joint: int) -> Additions:
    """What a robot may have besides: a spring at the joint, another payload."""
    angle, at = motion.position[:, joint], motion.position
    last = int(np.argmax(robot.order))
    payload = robot.body_torques(last, at, motion.velocity, motion.acceleration)[:, joint]
    masses = robot.constants.masses
    mass = _MAX_PAYLOAD_SHARE * float(masses.sum())
    weight = robot.gravity_torque(at, robot.recordings.gravity)[:, joint]
    spring = _MAX_SPRING_SHARE * max(float(np.abs(weight).max()), 1e-9)
    moment = mass * _MAX_PAYLOAD_LEVER
    stretch = spring / max(float(np.abs(angle).max()), 1e-9)
    inertia = moment * _MAX_PAYLOAD_LEVER
    body_lower = [-float(masses[last]), *[-moment] * 3, *[-inertia] * 6]
    return Additions(
        columns=np.column_stack([angle, np.sin(angle), np.cos(angle), payload]),
        lower=np.array([-stretch, -spring, -spring, *body_lower]),
        upper=np.array([stretch, spring, spring, mass, *[moment] * 3, *[inertia] * 6]),
    )
