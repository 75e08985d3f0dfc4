"""Search for descriptions of the files that explain the torques better than the stated one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar

from stiffopt.discovery.catalogue.timing import MAX_CLOCK_OFFSET
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.interpretations import (
    DEGREE,
    ZERO_CONVENTIONS,
    Motions,
    Reading,
    Samples,
)
from stiffopt.discovery.sanity.sensor_doubts import LIMIT_MARGIN_SHARE
from stiffopt.discovery.sanity.torque_fit import (
    MAX_GUESSED_MASS_RATIO,
    Additions,
    Motion,
    allowed_additions,
    fit_gain,
    guessed_bodies,
    residual_share,
    without_payload,
)
from stiffopt.discovery.settings import MIN_MOVING_SPEED
from stiffopt.discovery.signals import smooth_sign

# Largest residual share with which a description explains a torque.
MAX_EXPLAINED_SHARE = 0.15
# The stated description fails from the first residual share on, if another one is smaller by the
# second factor.
_FAILURE_LEVELS = ((0.3, 4.0), (0.04, 6.0))
# The same for two joints or more together, without additions to the nominal model: residual share,
# factor, largest residual share of the other description.
_SEVERAL_JOINTS_LEVEL = (0.15, 8.0, 0.06)
# Allowed worsening of other joints: added share, and factor.
_WORSENING_TOLERANCE = (0.1, 1.3)
_MIN_FAILURE_SHARE = min(share for share, _ in _FAILURE_LEVELS)
# Range of gains by which torque constants differ from data sheets.
_USUAL_GAIN_RANGE = (0.5, 2.0)
_SHARE_FLOOR = 0.02
_MAX_STEPS = 3
# Largest torque of a joint that is not driven, over that of the nominal model; currents are larger.
_MAX_IDLE_SHARE = 3e-3
# Least gain of a further step of a reading, as sum of log ratios over joints; and the price of a
# step when explanations are compared.
_MIN_STEP_GAIN, _STEP_PRICE = 0.7, 0.5
# Magnitudes of gains that come from units or signs.
UNIT_GAINS = (1.0, 1e3, 1e-3)
# Delays that are tried [s]; those below the second value are an effect of the catalogue.
_DELAY_GRID = np.concatenate([-np.geomspace(2.0, 0.01, 40), np.geomspace(0.01, 2.0, 40)])
_MIN_DELAY = 0.06


# Range of a fitted zero about a tried one; distance to a convention that is taken for it [rad].
_ZERO_REACH, _CONVENTION_TOLERANCE = np.pi / 6.0, 0.03
# Residual share of coupled drives over that of a sum of positions from which the sum is told.
_EQUIVALENT_RATIO = 2.0
_DERIVATIVE_NAMES = ("velocity", "acceleration")
# Difference of residual shares within which two descriptions fit alike.
_EQUAL_SHARES = 0.05
# Largest tilt of the base that is left to a diagnosis [rad].
_MAX_SMALL_TILT = np.pi / 6.0


@dataclass(frozen=True, eq=False)
class Explanation:
    """Another description of the files with its residual shares."""

    left: np.ndarray  # (n,) residual shares; nan if the motion cannot decide
    joints: tuple[int, ...]  # joints that it explains, from 0
    score: float  # sum of the log ratios of residual shares
    reading: Reading
    gains: np.ndarray | None = None  # (n,) recorded over true torque
    # (3,) unit vector in the base frame; 0 if the torques contain no weight.
    gravity: np.ndarray | None = None
    delay: float | None = None  # delay of the torque [s]

    @property
    def price(self) -> float:
        """Price of its complexity: steps of the reading, and free gains."""
        free = self.gains is not None and not np.isin(np.abs(self.gains), UNIT_GAINS).all()
        return _STEP_PRICE * (self.reading.steps + 2 * free)


class Explanations:
    """Search for other descriptions of the same files."""

    def __init__(self, robot: RobotModel, samples: Samples) -> None:
        self.robot, self.samples, self.n = robot, samples, robot.n
        self.motions = Motions(robot, samples)
        scale = robot.recordings.signals.scale_of("position", self.n)
        self.own = Reading.as_described(self.n, scale)
        self.motion = self.motions.of(self.own)

    @cached_property
    def strict(self) -> np.ndarray:
        """Residual shares (n,) of the stated description."""
        return self._residual_shares(self.motion, self.samples.torque)

    @cached_property
    def with_free_guesses(self) -> np.ndarray:
        """Residual shares (n,) of the stated description with any masses that are guesses."""
        if not self.robot.guessed_bodies:
            return self.strict
        free = guessed_bodies(self.robot, self.motion)
        pairs = zip(self.samples.torque.T, free, strict=True)
        return np.array(
            [residual_share(self.robot, self.motion, t, j, e) for j, (t, e) in enumerate(pairs)]
        )

    @cached_property
    def left(self) -> np.ndarray:
        """Residual shares (n,) with a possible spring at each joint and another payload.

        Not for torques without a factor, which such additions could replace.
        """
        return self._shares_with_additions(self.motion, self.strict)

    def _shares_with_additions(self, motion: Motion, strict: np.ndarray) -> np.ndarray:
        """Return the shares of a motion where those without additions (n,) fail."""
        shares = strict.copy()
        if self.robot.recordings.signals.unscaled:
            return shares
        for j in np.flatnonzero(shares > _MIN_FAILURE_SHARE).tolist():
            shares[j] = self.share_with_additions(motion, j)
        return shares

    def share_with_additions(self, motion: Motion, joint: int) -> float:
        """Return the residual share of a joint that may have a spring and another payload."""
        additions = allowed_additions(self.robot, motion, joint)
        torque = self.samples.torque[:, joint]
        return float(residual_share(self.robot, motion, torque, joint, additions))

    @property
    def left_beside_effects(self) -> tuple[np.ndarray, np.ndarray]:
        """Residual shares (n,) beside effects of the catalogue: of a payload, of a delay."""
        delay, delayed = self._best_delay
        rest = without_payload(self.robot, self.motion, self.samples.torque)
        loaded = self._residual_shares(self.motion, rest)
        return loaded, delayed if abs(delay) < MAX_CLOCK_OFFSET else self.strict

    @cached_property
    def torque_scale_known(self) -> np.ndarray:
        """True for joints (n,) whose torque fits as stated, and fits no other scale as well."""
        other = self._residual_shares(self.motion, 0.5 * self.samples.torque)
        with np.errstate(invalid="ignore"):
            return np.asarray(
                (self.strict < MAX_EXPLAINED_SHARE)
                & (other > _FAILURE_LEVELS[1][1] * np.maximum(self.strict, _SHARE_FLOOR))
            )

    def best(self) -> Explanation | None:
        """Return the description that explains most beyond the stated one, or None."""
        if not (self.strict > _MIN_FAILURE_SHARE).any():
            return None
        found = [
            self._explain_by_gravity(),
            self._explain_by_delay(),
            self._explain_by_gains(self.own),
            *self._explain_by_readings(),
        ]
        candidates = [e for e in found if e is not None]
        best = max(
            candidates,
            key=lambda e: e.score - e.price - self._limit_penalty(e.reading),
            default=None,
        )
        # A diagnosis finds a small tilt, with its size.
        return None if best is not None and self._is_small_tilt(best.gravity) else best

    def _is_small_tilt(self, direction: np.ndarray | None) -> bool:
        """True for a direction of gravity (3,) near the stated one."""
        stated = np.asarray(self.robot.recordings.gravity, dtype=float)
        size = float(np.linalg.norm(stated))
        if direction is None or not 9.0 < size < 10.5:
            return False
        return bool(direction @ stated > np.cos(_MAX_SMALL_TILT) * size)

    def _limit_penalty(self, reading: Reading) -> float:
        """Return the price of a reading with positions beyond the robot's limits."""
        recordings = self.robot.recordings
        arm, order = recordings.robot, recordings.order
        lower, upper = arm.position_lower[order], arm.position_upper[order]
        position = self.motions.of(reading).position
        margin = LIMIT_MARGIN_SHARE * (upper - lower)
        with np.errstate(invalid="ignore"):
            out = (position < lower - margin) | (position > upper + margin)
        return 2.0 * _STEP_PRICE if out.any() else 0.0

    def stationary_in_degrees(self) -> Explanation | None:
        """Return joints that hardly move in the stated degrees, but do in radians.

        Read in degrees their torques decide nothing; read in rad they fit the nominal model.
        """
        joints = np.array(self.own.in_degrees) & np.isnan(self.strict)
        while joints.any():
            scale = tuple(np.where(joints, 1.0 / DEGREE, 1.0))
            reading = replace(self.own, position_scale=scale, steps=1)
            left = self._shares_of(reading)
            if self._worsens(left):
                return None
            with np.errstate(invalid="ignore"):
                fits = joints & (left < MAX_EXPLAINED_SHARE)
            if np.all(fits == joints):
                found = tuple(int(j) for j in np.flatnonzero(joints))
                score = float(-np.log(left[joints] + _SHARE_FLOOR).sum())
                return Explanation(left=left, joints=found, score=score, reading=reading)
            joints = fits
        return None

    # ---- kinds of explanations

    def _explain_by_gains(self, reading: Reading) -> Explanation | None:
        """Explain by a gain far from 1 of each joint's torque."""
        motion = self.motions.of(reading)
        torque = reading.torque(self.samples.torque)
        before = self._residual_shares(motion, torque) if reading.steps else self.left
        gains, left = np.ones(self.n), np.array(before)
        ratio = [joint.ratio for joint in self.robot.constants.joints]
        for j in range(self.n):
            if not before[j] > _MIN_FAILURE_SHARE:
                continue
            current = j in self.robot.recordings.signals.unscaled_joints
            usual = (-1.0, 1e3, 1e-3, -1e3, -1e-3, 1.0 / ratio[j], -1.0 / ratio[j])
            gain, share = fit_gain(self.robot, motion, torque[:, j], j, None if current else usual)
            low, high = _USUAL_GAIN_RANGE
            if self.robot.guessed_bodies and not current:
                # A guessed mass is off by more than a torque constant, but has no sign.
                low, high = 1.0 / MAX_GUESSED_MASS_RATIO, MAX_GUESSED_MASS_RATIO
                gain = -1.0 if low < -gain < high else gain
            if not low < gain < high and _is_explained(before[j], share):
                gains[j], left[j] = gain, share
        idle = self._find_idle_joints(motion, torque)
        gains[idle], left[idle] = 1.0, before[idle]
        if (gains == 1.0).all():
            return None
        self._adopt_common_gain(gains, left, motion, torque)
        return self._accept_explanation(left, reading, gains=gains)

    def _find_idle_joints(self, motion: Motion, torque: np.ndarray) -> np.ndarray:
        """Find joints (n,) with torques near zero beside those of other joints.

        A joint that is commanded to zero shows friction of its sensor, and no unit.
        """
        known = np.isfinite(torque)
        size = np.sqrt(np.sum(np.where(known, torque, 0.0) ** 2, axis=0) / len(torque))
        needed = np.sqrt(np.nanmean(motion.spring**2, axis=0))
        near_zero = size < _MAX_IDLE_SHARE * needed
        told = known.any(axis=0)
        if near_zero[told].all() or self.robot.recordings.signals.unscaled:
            return np.zeros(self.n, dtype=bool)
        return np.asarray(near_zero)

    def _adopt_common_gain(
        self, gains: np.ndarray, left: np.ndarray, motion: Motion, torque: np.ndarray
    ) -> None:
        """Prefer the gain of another joint for joints without weight, which fit any gain.

        Changes `gains` and `left` (n,) in place.
        """
        units = np.isclose(np.abs(np.log10(np.abs(gains))), 3.0)
        told = [float(gain) for gain in gains[~units] if gain != 1.0]
        for j in np.flatnonzero(units) if told else ():
            gain, share = fit_gain(self.robot, motion, torque[:, j], int(j), tuple(told))
            if gain in told and share < MAX_EXPLAINED_SHARE:
                gains[j], left[j] = gain, share

    def _explain_by_readings(self) -> list[Explanation]:
        """Explain by other columns, signs and units, step by step."""
        found, reading, left = [], self.own, self.strict
        for _ in range(_MAX_STEPS):
            tried = [
                (other, self._shares_of(other))
                for other in reading.neighbours(self.robot.recordings.prismatic)
                if self.travels_in_degrees(other)
            ]
            if not tried:
                break
            # Of equal ones the first, which changes least.
            other, after = max(
                tried,
                key=lambda one: round(
                    self._log_improvement(left, one[1]) - self._limit_penalty(one[0]), 1
                ),
            )
            if reading is self.own:
                # Degrees and amperes together: neither explains anything alone.
                all_joints = np.ones(self.n, dtype=bool)
                found.append(
                    self._explain_by_gains(
                        reading.in_other_units(self.robot.recordings.prismatic, all_joints)
                    )
                )
            if self._log_improvement(left, after) < _MIN_STEP_GAIN:
                break
            reading, left = self._refine_zeros(other, after)
            found.append(self._accept_explanation(left, reading))
        return [e for e in found if e is not None]

    def _refine_zeros(self, reading: Reading, left: np.ndarray) -> tuple[Reading, np.ndarray]:
        """Fit the zeros that a reading moves, unless the convention is as good."""
        for joint in np.flatnonzero(reading.offset).tolist():
            stated = reading.offset[joint]
            found = minimize_scalar(
                lambda x, joint=joint, reading=reading: (
                    -self._log_improvement(
                        self.strict, self._shares_of(reading.with_offset(joint, x))
                    )
                ),
                bounds=(stated - _ZERO_REACH, stated + _ZERO_REACH),
                method="bounded",
                options={"xatol": 2e-3},
            )
            near = min(ZERO_CONVENTIONS, key=lambda turn: abs(abs(turn - found.x) % (2.0 * np.pi)))
            usual = abs(near - found.x) < _CONVENTION_TOLERANCE
            reading = reading.with_offset(joint, near if usual else float(found.x))
            left = self._shares_of(reading)
        return reading, left

    def _explain_by_gravity(self) -> Explanation | None:
        """Explain by gravity along another direction of the base."""
        robot, motion = self.robot, self.motion
        stated = np.asarray(robot.recordings.gravity, dtype=float)
        pulls = np.stack(
            [robot.gravity_torque(motion.position, axis) for axis in np.eye(3)], axis=2
        )
        moving = motion.spring - pulls @ stated
        if not np.abs(pulls).max() > 0.0:
            return None
        direction = self._fit_gravity_direction(moving, pulls)
        if direction is None:  # no weight at all: a controller may add its compensation later
            direction = np.zeros(3)
        spring = moving + pulls @ (9.81 * direction)
        return self._accept_weight(replace(motion, spring=spring), direction)

    def _accept_weight(self, motion: Motion, gravity: np.ndarray) -> Explanation | None:
        """Return the explanation by another weight unless the stated one fits a joint better.

        A spring at one joint may look similar, but not at all joints that carry weight. A joint may
        have one beside another direction of gravity; in place of all weight it stands for it.
        """
        left = self._residual_shares(motion, self.samples.torque)
        own = self._shares_with_additions(motion, left) if gravity.any() else left
        if not np.all((own <= self.left + _EQUAL_SHARES) | np.isnan(own)):
            return None
        return self._accept_explanation(left, self.own, gravity=gravity, against=self.strict)

    def _fit_gravity_direction(self, moving: np.ndarray, pulls: np.ndarray) -> np.ndarray | None:
        """Return the unit vector of gravity that fits the torques best, rounded to a near axis."""
        gram, moment = np.zeros((3, 3)), np.zeros(3)
        velocity, torque = self.motion.velocity, self.samples.torque
        for j in range(self.n):
            known = np.isfinite(torque[:, j])
            if not known.any():
                continue
            speed = velocity[known, j]
            free = np.column_stack(
                [np.ones(len(speed)), np.tanh(speed / 0.01), speed,
                 self.motion.acceleration[known, j]]
            )  # fmt: skip
            both = np.column_stack([pulls[known, j], torque[known, j] - moving[known, j]])
            rest = both - free @ np.linalg.lstsq(free, both, rcond=None)[0]
            weight = 1.0 / max(float(np.var(torque[known, j])), 1e-12)
            gram += weight * rest[:, :3].T @ rest[:, :3]
            moment += weight * rest[:, :3].T @ rest[:, 3]
        # Gravity parallel to all axes is not identifiable.
        found = np.linalg.pinv(gram, rcond=1e-4, hermitian=True) @ moment
        size = float(np.linalg.norm(found))
        if not 7.0 < size < 13.0:
            return None
        found = found / size
        main = int(np.argmax(np.abs(found)))
        axis = np.eye(3)[main] * np.sign(found[main])
        near = abs(found[main]) > np.cos(np.pi / 12.0)
        return np.asarray(axis if near and not self._is_small_tilt(axis) else found)

    def _explain_by_delay(self) -> Explanation | None:
        """Explain by a delay of all torques against the motion."""
        delay, left = self._best_delay
        if abs(delay) < _MIN_DELAY:
            return None
        return self._accept_explanation(left, self.own, delay=delay)

    @cached_property
    def _best_delay(self) -> tuple[float, np.ndarray]:
        """Delay of all torques [s] with the least residual shares, and these shares (n,)."""
        tried = []
        for delay in _DELAY_GRID:
            torque = np.vstack([each.shifted(float(delay)) for each in self.samples.series])
            tried.append((float(delay), self._residual_shares(self.motion, torque)))
        return min(tried, key=lambda each: float(np.nansum(each[1])))

    # ---- residual shares

    def _shares_of(self, reading: Reading) -> np.ndarray:
        torque = reading.torque(self.samples.torque)
        return self._residual_shares(self.motions.of(reading), torque)

    def _worsens(self, left: np.ndarray) -> bool:
        """Return True for shares (n,) of which one is clearly larger than as stated."""
        added, factor = _WORSENING_TOLERANCE
        with np.errstate(invalid="ignore"):
            return bool(np.any(left > np.maximum(self.strict + added, self.strict * factor)))

    def _residual_shares(self, motion: Motion, torque: np.ndarray) -> np.ndarray:
        return np.array(
            [residual_share(self.robot, motion, torque[:, j], j) for j in range(self.n)]
        )

    def travels_in_degrees(self, reading: Reading) -> bool:
        """Return False where a joint read in degrees would stand still beside one left in rad.

        Joints of one log share a unit: as recorded their travels are nearer to one another then.
        """
        position = self.samples.position[:, list(reading.position_from)]
        travel = np.nanmax(position, axis=0) - np.nanmin(position, axis=0)
        degrees = np.isclose(np.abs(reading.position_scale), DEGREE)
        left = ~degrees & ~self.robot.recordings.prismatic
        if not degrees.any() or not left.any():
            return True
        return bool(travel[degrees].min() * np.sqrt(DEGREE) > travel[left].max())

    def _fails_where_it_moves(self, reading: Reading, left: np.ndarray) -> np.ndarray:
        """Return joints (n,) with a failing stated reading at instants moving in the other one.

        A joint that hardly moves in the other reading has little to explain.
        """
        moves = np.abs(self.motions.of(reading).velocity) >= MIN_MOVING_SPEED
        torque = np.where(moves, self.samples.torque, np.nan)
        there = [residual_share(self.robot, self.motion, torque[:, j], j) for j in range(self.n)]
        return np.array([_is_explained(b, a) for b, a in zip(there, left, strict=True)])

    def _is_coupled_drive(self, reading: Reading, joint: int, left: float) -> bool:
        """True if friction and inertia of a drive of two joints explain as much as a sum."""
        v, a = (getattr(self.motions.of(reading), name)[:, joint] for name in _DERIVATIVE_NAMES)
        columns = np.column_stack([smooth_sign(v), v, a])
        free = np.full(columns.shape[1], np.inf)
        torque = self.samples.torque[:, joint]
        share = residual_share(
            self.robot, self.motion, torque, joint, Additions(columns, -free, free)
        )
        return share < _EQUIVALENT_RATIO * (left + _SHARE_FLOOR)

    def _log_improvement(self, before: np.ndarray, after: np.ndarray) -> float:
        ratio = np.log((before + _SHARE_FLOOR) / (after + _SHARE_FLOOR))
        return float(np.nansum(ratio))

    def _accept_explanation(
        self,
        left: np.ndarray,
        reading: Reading,
        *,
        gains: np.ndarray | None = None,
        gravity: np.ndarray | None = None,
        delay: float | None = None,
        against: np.ndarray | None = None,
    ) -> Explanation | None:
        """Return the explanation if it explains a failing joint and worsens none, else None.

        Each step of a reading has to explain a joint: a few signs and zeros fit any torque of one
        joint that carries little weight.
        """
        before = self.left if against is None else against
        with np.errstate(invalid="ignore"):
            mended = np.array([_is_explained(b, a) for b, a in zip(before, left, strict=True)])
            if reading.steps and gains is None:
                share, factor, most = _SEVERAL_JOINTS_LEVEL
                plain = (self.strict > share) & (left * factor < self.strict) & (left < most)
                mended |= plain & (plain.sum() > 1)
                mended &= self._fails_where_it_moves(reading, left)
        for joint in np.flatnonzero(mended & (np.array(reading.includes) != 0)).tolist():
            mended[joint] = not self._is_coupled_drive(reading, joint, left[joint])
        if mended.sum() < max(reading.steps, 1) or self._worsens(left):
            return None
        return Explanation(
            left=left,
            joints=tuple(int(j) for j in np.flatnonzero(mended)),
            score=self._log_improvement(self.strict, left),
            reading=reading,
            gains=gains,
            gravity=gravity,
            delay=delay,
        )


def _is_explained(before: float, after: float) -> bool:
    """True if the residual share `after` explains a failing `before`."""
    fails = any(before > share and after * factor < before for share, factor in _FAILURE_LEVELS)
    return fails and after < MAX_EXPLAINED_SHARE
