"""Fit of measured torques by the nominal model with bounded additions: residual shares, gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear, minimize_scalar

from stiffopt.discovery.comparison.inertial_parameters import LENGTH_POWERS
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.settings import MIN_MOVING_SPEED
from stiffopt.discovery.signals import PARAMETERS_PER_BODY, smooth_sign

# Relative error of a stated friction or rotor inertia, down and up: far above the effect of cold
# grease, far below that of a wrong unit.
_MAX_RELATIVE_DECREASE, _MAX_RELATIVE_INCREASE = 0.8, 10.0
# Largest load-dependent friction over the load.
_MAX_LOAD_FRICTION = 0.4
# Largest torque offset over the largest nominal torque: of the joint for a current, of the arm for
# a joint torque sensor, whose zero error goes with its range and not with the joint's load.
_MAX_OFFSET_SHARE = 0.5
# Largest lever of a payload [m], whose mass may be that of the arm.
_MAX_PAYLOAD_LEVER = 0.5
# Largest mass of a link over its guess: estimates from shapes and rods are off by up to three, and
# covers, cables and motors are in no shape.
MAX_GUESSED_MASS_RATIO = 10.0
# Rounds in which the inertia of a payload follows its mass and place.
_PAYLOAD_ROUNDS = 5
# Largest torque of a counterbalance over the largest gravity torque.
_MAX_SPRING_SHARE = 0.9
# Fewer moving instants give no result.
MIN_MOVING_INSTANTS = 60
# A usual gain is preferred if its residual share is at most this above 1.5 times the best; and the
# gains that are tried, with either sign.
_EQUIVALENT_SHARE = 0.02
# Residual share over the least one up to which gains fit alike: a bound of an offset is felt.
_EQUAL_RATIO = 1.1
_GAIN_GRID = np.logspace(-4.5, 4.5, 61)


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion, in some interpretation of the files, with its nominal torques."""

    # position, velocity, acceleration (m, n)
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    spring: np.ndarray  # (m, n) nominal torque of bodies and counterbalances [N m]

    @staticmethod
    def of(robot: RobotModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Motion:
        """Return a motion with torques of the nominal model."""
        return Motion(q, v, a, robot.spring_torque(q, v, a))


@dataclass(frozen=True, eq=False)
class Additions:
    """Columns (m, k) that may be added to a nominal torque, with bounds (k,) of their factors."""

    columns: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def residual_share(
    robot: RobotModel,
    motion: Motion,
    torque: np.ndarray,
    joint: int,
    extra: Additions | None = None,
) -> float:
    """Return the residual share of a torque's variance; nan if the motion cannot decide.

    `torque` (m,): measured [N m]. `extra`: further columns, such as springs and payloads.
    """
    reduced = _reduce_table(robot, motion, torque, joint, extra)
    return float("nan") if reduced is None else reduced.share(1.0)


def without_payload(robot: RobotModel, motion: Motion, torque: np.ndarray) -> np.ndarray:
    """Return torques (m, n) less those of the payload that fits them best beside any friction.

    One mass at a point for all joints, added or removed, by least squares; its inertia follows from
    mass and place, so that masses of other links are no payload.
    """
    last, body = _torques_of_last_body(robot, motion)
    columns, targets = [], []
    for j in range(robot.n):
        rows = _moving_rows(motion, torque[:, j], j)
        lines = np.column_stack(_loss_columns(motion, j))[rows]
        table = np.column_stack([torque[:, j] - motion.spring[:, j], body[:, j]])[rows]
        size = float(np.std(table[:, 0])) if len(table) else 0.0
        if len(table) < MIN_MOVING_INSTANTS or size == 0.0:
            continue
        table -= lines @ np.linalg.lstsq(lines, table, rcond=None)[0]
        # Joints count by shares of their torques.
        targets.append(table[:, 0] / size)
        columns.append(table[:, 1:] / size)
    if not columns:
        return torque
    stacked, target = np.vstack(columns), np.concatenate(targets)
    link, added = robot.arm.tree.bodies[int(robot.order[last])], np.zeros(PARAMETERS_PER_BODY)
    for _ in range(_PAYLOAD_ROUNDS):
        rest = target - stacked[:, 4:] @ added[4:]
        mass, *moment = np.linalg.lstsq(stacked[:, :4], rest, rcond=None)[0]
        if mass == 0.0:
            break
        point = replace(link, mass=mass, centre=np.array(moment) / mass, inertia=np.zeros((3, 3)))
        added = point.inertial_parameters
    return np.asarray(torque - body @ added)


def _torques_of_last_body(robot: RobotModel, motion: Motion) -> tuple[int, np.ndarray]:
    """Return the last body's place among the joints, and its torques by parameters (m, n, 10)."""
    last = int(np.argmax(robot.order))
    return last, robot.body_torques(last, motion.position, motion.velocity, motion.acceleration)


def _moving_rows(motion: Motion, torque: np.ndarray, joint: int) -> np.ndarray:
    """Return True at the instants (m,) at which a joint moves with a known torque (m,)."""
    return np.asarray((np.abs(motion.velocity[:, joint]) >= MIN_MOVING_SPEED) & np.isfinite(torque))


def _loss_columns(motion: Motion, joint: int) -> tuple[np.ndarray, ...]:
    """Return offset, friction by load, dry and viscous friction and rotor inertia, of unit size."""
    speed, spring = motion.velocity[:, joint], motion.spring[:, joint]
    direction = smooth_sign(speed)
    by_load = np.abs(spring) * direction
    return np.ones_like(speed), by_load, direction, speed, motion.acceleration[:, joint]


def fit_gain(
    robot: RobotModel, motion: Motion, torque: np.ndarray, joint: int, usual: Sequence[float] | None
) -> tuple[float, float]:
    """Return the gain, of either sign, that fits a torque best, and its residual share.

    A usual gain is preferred if it fits nearly as well. Where `usual` is None, as for a
    current, both are nan if half or twice of it leaves less than twice the share: friction may
    be of any size, and a joint that carries no weight fits every gain.
    """
    reduced = _reduce_table(robot, motion, torque, joint, None)
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
    gain = float(sign * np.exp(found.x))
    if usual is None:
        beside = min(reduced.share(0.5 * gain), reduced.share(2.0 * gain))
        return (gain, float(found.fun)) if beside > 2.0 * found.fun else (np.nan, np.nan)
    good = {
        g: share for g in usual if (share := reduced.share(g)) < 1.5 * found.fun + _EQUIVALENT_SHARE
    }
    if good:
        # A joint without weight fits any size of a gain: the first one, a sign alone, will do.
        least = min(good.values())
        return next(one for one in good.items() if one[1] <= _EQUAL_RATIO * least)
    return gain, float(found.fun)


def _reduce_table(
    robot: RobotModel, motion: Motion, torque: np.ndarray, joint: int, extra: Additions | None
) -> _ReducedTable | None:
    rows = _moving_rows(motion, torque, joint)
    if rows.sum() < MIN_MOVING_INSTANTS or np.ptp(torque[rows]) == 0.0:
        return None
    columns = list(_loss_columns(motion, joint))
    stated = (robot.coulomb[joint], robot.viscous[joint], robot.rotor_inertia[joint])
    own = (value * column for value, column in zip(stated, columns[2:], strict=True))
    nominal = motion.spring[:, joint] + sum(own)
    link_side = robot.recordings.torque_side == "link"
    largest = np.abs(motion.spring if link_side else nominal[rows]).max()
    offset = _MAX_OFFSET_SHARE * float(largest)
    lower, upper = [-offset, 0.0], [offset, _MAX_LOAD_FRICTION]
    for value in stated:
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
    """QR factor R of a table (torque, nominal, columns), which has the same normal equations."""

    triangle: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    variance: float

    def share(self, gain: float) -> float:
        """Return the residual share with gain times (nominal plus columns within bounds)."""
        target = self.triangle[:, 0] / gain - self.triangle[:, 1]
        matrix = self.triangle[:, 2:]
        size = np.linalg.norm(matrix, axis=0)
        kept = size > 0.0
        matrix, size = matrix[:, kept] / size[kept], size[kept]
        lower, upper = self.lower[kept] * size, self.upper[kept] * size
        # lsq_linear needs a strict interior: columns with equal bounds are dropped.
        free = upper > lower
        found = lsq_linear(matrix[:, free], target, (lower[free], upper[free]), method="bvls")
        return float(2.0 * found.cost * gain**2 / self.variance)


def guessed_bodies(robot: RobotModel, motion: Motion) -> list[Additions]:
    """Return, for every joint, the changes that are allowed of bodies of guessed mass."""
    bodies = list(robot.guessed_bodies)
    masses = robot.constants.masses[bodies]
    lower, upper = _body_bounds(masses, MAX_GUESSED_MASS_RATIO * masses)
    where = (motion.position, motion.velocity, motion.acceleration)
    torques = np.concatenate([robot.body_torques(body, *where) for body in bodies], axis=2)
    return [Additions(torques[:, j], lower.ravel(), upper.ravel()) for j in range(robot.n)]


def _body_bounds(
    removed: np.ndarray | float, added: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds (..., 10) of the change of bodies by masses (...) removed and added [kg]."""
    upper = np.asarray(added)[..., None] * _MAX_PAYLOAD_LEVER**LENGTH_POWERS
    lower = -upper
    lower[..., 0] = -np.asarray(removed)
    return lower, upper


def allowed_additions(robot: RobotModel, motion: Motion, joint: int) -> Additions:
    """Return a spring at the joint and another payload as possible additions."""
    angle = motion.position[:, joint]
    last, payload = _torques_of_last_body(robot, motion)
    masses = robot.constants.masses
    mass = float(masses.sum())
    weight = robot.gravity_torque(motion.position, robot.recordings.gravity)[:, joint]
    spring = _MAX_SPRING_SHARE * max(float(np.abs(weight).max()), 1e-9)
    stretch = spring / max(float(np.abs(angle).max()), 1e-9)
    lower, upper = _body_bounds(masses[last], mass)
    return Additions(
        columns=np.column_stack([angle, np.sin(angle), np.cos(angle), payload[:, joint]]),
        lower=np.array([-stretch, -spring, -spring, *lower]),
        upper=np.array([stretch, spring, spring, *upper]),
    )
