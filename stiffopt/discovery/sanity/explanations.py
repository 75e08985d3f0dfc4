"""Descriptions of the files that explain the torques where the file's own does not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.interpretations import DEGREE, Motions, Reading, Samples
from stiffopt.discovery.sanity.torque_fit import Additions, Motion, TorqueFit, allowed_additions
from stiffopt.discovery.settings import MIN_MOVING_SPEED

# Share of a torque's variance up to which another description explains it.
MAX_EXPLAINED_SHARE = 0.15
# The file's own fails from the first share on, where the other leaves less by the second factor.
_FAILURE_LEVELS = ((0.3, 4.0), (0.04, 6.0))
# Or, of two joints or more at once, without anything that a robot may have besides.
_SEVERAL_JOINTS_LEVEL = (0.15, 8.0, 0.06)
# A joint must not be the worse for it: added share, and factor.
_WORSENING_TOLERANCE = (0.1, 1.3)
_MIN_FAILURE_SHARE = min(share for share, _ in _FAILURE_LEVELS)
# Gains up to which drives and their constants differ from data sheets.
_USUAL_GAIN_RANGE = (0.5, 2.0)
_SHARE_FLOOR = 0.02
_MAX_STEPS = 3
# What one more step of a reading must gain, of the sum of logarithms over joints; and what a step
# costs where different explanations are weighed.
_MIN_STEP_GAIN, _STEP_PRICE = 0.7, 0.5
# Share of a joint's range beyond its limits from which a reading is doubted for that.
_LIMIT_MARGIN_SHARE = 0.05
# Sizes of gains that are units or signs.
_UNIT_GAINS = (1.0, 1e3, 1e-3)
# Delays that are tried [s]; shorter ones than the second are an effect of the catalogue.
_DELAY_GRID = np.concatenate([-np.geomspace(2.0, 0.01, 40), np.geomspace(0.01, 2.0, 40)])
_MIN_DELAY = 0.06


@dataclass(frozen=True, eq=False)
class Explanation:
    """Another description and the shares of the torques that it leaves.

    Parameters
    ----------
    left : array (n,)
        nan where undecidable.
    joints : tuple of int
        That it explains, from 0.
    score : float
        Sum of the logarithms of how much less it leaves.
    reading : Reading
    gains : array (n,) or None
        Recorded over true torque.
    gravity : array (3,) or None
        Direction, of unit length, in the base; 0 where the torques hold no weight.
    delay : float or None
        Of the torque [s].
    """

    left: np.ndarray
    joints: tuple[int, ...]
    score: float
    reading: Reading
    gains: np.ndarray | None = None
    gravity: np.ndarray | None = None
    delay: float | None = None

    @property
    def price(self) -> float:
        """What it must gain: steps of the reading, and factors that any number may be."""
        free = self.gains is not None and not np.isin(np.abs(self.gains), _UNIT_GAINS).all()
        return _STEP_PRICE * (self.reading.steps + 2 * free)


class Explanations:
    """Search among other descriptions of the same files.

    Parameters
    ----------
    robot : RobotModel
    samples : Samples
    """

    def __init__(self, robot: RobotModel, samples: Samples) -> None:
        self.robot, self.samples, self.n = robot, samples, robot.n
        self.balance = TorqueFit(robot)
        self.motions = Motions(robot, samples)
        scale = robot.recordings.signals.scale_of("position", self.n)
        self.own = Reading.as_described(self.n, scale)
        self.motion = self.motions.of(self.own)

    @cached_property
    def strict(self) -> np.ndarray:
        """Shares (n,) that the file's own reading leaves."""
        return self._residual_shares(self.motion, self.samples.torque)

    @cached_property
    def left(self) -> np.ndarray:
        """The same where each joint may have a spring, and the arm another payload, besides.

        Not beside currents: such things can make torques of them.
        """
        strict = self.strict
        if self.robot.recordings.signals.currents:
            return strict
        return np.array([
            self.balance.left(self.motion, self.samples.torque[:, j], j, self._allowed_additions(j))
            if strict[j] > _MIN_FAILURE_SHARE else strict[j]
            for j in range(self.n)
        ])  # fmt: skip

    def best(self) -> Explanation | None:
        """The description that explains most of what the file's own does not, if one does."""
        if not (self.strict > _MIN_FAILURE_SHARE).any():
            return None
        found = [
            self._explain_by_gravity(),
            self._explain_by_delay(),
            self._explain_by_gains(self.own),
            *self._explain_by_readings(),
        ]
        candidates = [e for e in found if e is not None]
        return max(
            candidates,
            key=lambda e: e.score - e.price - self._limit_penalty(e.reading),
            default=None,
        )

    def _limit_penalty(self, reading: Reading) -> float:
        """Price of a reading by which joints were where the robot's limits do not let them."""
        recordings = self.robot.recordings
        arm, order = recordings.robot, recordings.order
        lower, upper = arm.position_lower[order], arm.position_upper[order]
        position = self.motions.of(reading).position
        margin = _LIMIT_MARGIN_SHARE * (upper - lower)
        with np.errstate(invalid="ignore"):
            out = (position < lower - margin) | (position > upper + margin)
        return 2.0 * _STEP_PRICE if out.any() else 0.0

    def stationary_in_degrees(self) -> Explanation | None:
        """Joints that hardly move as the degrees that they are stated in, but well as radians.

        Nothing can be told of their torques as described; as of a motion in rad they are those of
        the nominal model.
        """
        joints = np.array(self.own.in_degrees) & np.isnan(self.strict)
        while joints.any():
            scale = tuple(np.where(joints, 1.0 / DEGREE, 1.0))
            reading = replace(self.own, position_scale=scale, steps=1)
            left = self._residual_shares(self.motions.of(reading), self.samples.torque)
            with np.errstate(invalid="ignore"):
                fits = joints & (left < MAX_EXPLAINED_SHARE)
                worse = left > np.maximum(
                    self.strict + _WORSENING_TOLERANCE[0], self.strict * _WORSENING_TOLERANCE[1]
                )
            if worse.any():
                return None
            if np.all(fits == joints):
                found = tuple(int(j) for j in np.flatnonzero(joints))
                score = float(-np.log(left[joints] + _SHARE_FLOOR).sum())
                return Explanation(left=left, joints=found, score=score, reading=reading)
            joints = fits
        return None

    # ---- kinds of explanations

    def _explain_by_gains(self, reading: Reading) -> Explanation | None:
        """Each joint's torque off by a factor, where that is far from 1."""
        motion = self.motions.of(reading)
        torque = reading.torque(self.samples.torque)
        before = self._residual_shares(motion, torque) if reading.steps else self.left
        gains, left = np.ones(self.n), np.array(before)
        ratio = [joint.ratio for joint in self.robot.constants.joints]
        for j in range(self.n):
            if not before[j] > _MIN_FAILURE_SHARE:
                continue
            usual = (-1.0, 1e3, 1e-3, -1e3, -1e-3, 1.0 / ratio[j], -1.0 / ratio[j])
            gain, share = self.balance.gain(motion, torque[:, j], j, usual)
            if not _USUAL_GAIN_RANGE[0] < gain < _USUAL_GAIN_RANGE[1] and _is_explained(
                before[j], share
            ):
                gains[j], left[j] = gain, share
        if (gains == 1.0).all():
            return None
        self._adopt_common_gain(gains, left, motion, torque)
        return self._accept_explanation(left, reading, gains=gains)

    def _adopt_common_gain(
        self, gains: np.ndarray, left: np.ndarray, motion: Motion, torque: np.ndarray
    ) -> None:
        """Where a unit fits a joint that bears no weight, so may any factor: take another joint's.

        Changes `gains` and `left` (n,) in place.
        """
        units = np.isclose(np.abs(np.log10(np.abs(gains))), 3.0)
        told = [float(gain) for gain in gains[~units] if gain != 1.0]
        for j in np.flatnonzero(units) if told else ():
            gain, share = self.balance.gain(motion, torque[:, j], int(j), tuple(told))
            if gain in told and share < MAX_EXPLAINED_SHARE:
                gains[j], left[j] = gain, share

    def _explain_by_readings(self) -> list[Explanation]:
        """Other columns, signs and units, step by step; beside each its gains."""
        found, reading, left = [], self.own, self.strict
        for _ in range(_MAX_STEPS):
            tried = [
                (
                    other,
                    self._residual_shares(
                        self.motions.of(other), other.torque(self.samples.torque)
                    ),
                )
                for other in reading.neighbours(self.robot.recordings.prismatic)
            ]
            if not tried:
                break
            # Of those that are as good the first, which says the least.
            other, after = max(
                tried,
                key=lambda one: round(
                    self._log_improvement(left, one[1]) - self._limit_penalty(one[0]), 1
                ),
            )
            if reading is self.own:
                # Degrees and amperes at once: neither explains anything alone.
                all_joints = np.ones(self.n, dtype=bool)
                found.append(
                    self._explain_by_gains(
                        reading.in_other_units(self.robot.recordings.prismatic, all_joints)
                    )
                )
            if self._log_improvement(left, after) < _MIN_STEP_GAIN:
                break
            reading, left = other, after
            found.append(self._accept_explanation(left, reading))
        return [e for e in found if e is not None]

    def _explain_by_gravity(self) -> Explanation | None:
        """Gravity along another direction of the base."""
        robot, motion = self.robot, self.motion
        stated = np.asarray(robot.recordings.gravity, dtype=float)
        pulls = np.stack(
            [robot.gravity_torque(motion.position, axis) for axis in np.eye(3)], axis=2
        )
        moving = motion.spring - pulls @ stated
        if not np.abs(pulls).max() > 0.0:
            return None
        direction = self._fit_gravity_direction(moving, pulls)
        if direction is None:
            return self._explain_without_weight(moving)
        size = float(np.linalg.norm(stated))
        if size > 0.0 and 9.0 < size < 10.5 and direction @ stated > np.cos(np.pi / 6.0) * size:
            return None
        spring = moving + pulls @ (9.81 * direction)
        left = self._residual_shares(replace(motion, spring=spring), self.samples.torque)
        # A spring at one joint may look like it there, but not at all joints that carry weight.
        if not np.all((left <= self.left + 0.05) | np.isnan(left)):
            return None
        return self._accept_explanation(left, self.own, gravity=direction, against=self.strict)

    def _explain_without_weight(self, moving: np.ndarray) -> Explanation | None:
        """No weight in the torques at all, as where a controller adds it behind them."""
        left = self._residual_shares(replace(self.motion, spring=moving), self.samples.torque)
        if not np.all((left <= self.left + 0.05) | np.isnan(left)):
            return None
        return self._accept_explanation(left, self.own, gravity=np.zeros(3), against=self.strict)

    def _fit_gravity_direction(self, moving: np.ndarray, pulls: np.ndarray) -> np.ndarray | None:
        """Unit vector of the gravity that fits the torques best; the axis where it is near one."""
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
        # Gravity along parallel axes shows in no torque.
        found = np.linalg.pinv(gram, rcond=1e-4, hermitian=True) @ moment
        size = float(np.linalg.norm(found))
        if not 7.0 < size < 13.0:
            return None
        found = found / size
        main = int(np.argmax(np.abs(found)))
        if abs(found[main]) > np.cos(np.pi / 12.0):
            found = np.eye(3)[main] * np.sign(found[main])
        return np.asarray(found)

    def _explain_by_delay(self) -> Explanation | None:
        """All torques recorded later or earlier than the motion."""
        best: tuple[float, np.ndarray] | None = None
        for delay in _DELAY_GRID:
            left = self._residual_shares(self.motion, self.samples.delayed_torque(float(delay)))
            if best is None or np.nansum(left) < np.nansum(best[1]):
                best = float(delay), left
        if best is None or abs(best[0]) < _MIN_DELAY:
            return None
        return self._accept_explanation(best[1], self.own, delay=best[0])

    # ---- how much they explain

    def _residual_shares(self, motion: Motion, torque: np.ndarray) -> np.ndarray:
        return np.array([self.balance.left(motion, torque[:, j], j) for j in range(self.n)])

    def _allowed_additions(self, joint: int) -> Additions:
        return allowed_additions(self.robot, self.motion, joint)

    def _fails_where_it_moves(self, reading: Reading, left: np.ndarray) -> np.ndarray:
        """Joints (n,) whose own reading fails where another one says that they move.

        A joint that hardly moves by the other reading shows little that it would have to explain.
        """
        moves = np.abs(self.motions.of(reading).velocity) >= MIN_MOVING_SPEED
        torque = np.where(moves, self.samples.torque, np.nan)
        there = [self.balance.left(self.motion, torque[:, j], j) for j in range(self.n)]
        return np.array([_is_explained(b, a) for b, a in zip(there, left, strict=True)])

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
        """The explanation, if it explains what nothing else does and worsens no joint."""
        before = self.left if against is None else against
        with np.errstate(invalid="ignore"):
            mended = np.array([_is_explained(b, a) for b, a in zip(before, left, strict=True)])
            if reading.steps and gains is None:
                share, factor, most = _SEVERAL_JOINTS_LEVEL
                plain = (self.strict > share) & (left * factor < self.strict) & (left < most)
                mended |= plain & (plain.sum() > 1)
                mended &= self._fails_where_it_moves(reading, left)
            worse = left > np.maximum(
                self.strict + _WORSENING_TOLERANCE[0], self.strict * _WORSENING_TOLERANCE[1]
            )
        if not mended.any() or worse.any():
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
    """Whether one share of the variance explains what another leaves."""
    fails = any(before > share and after * factor < before for share, factor in _FAILURE_LEVELS)
    return fails and after < MAX_EXPLAINED_SHARE
