"""Descriptions of the files that explain the torques where the file's own does not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.balance import Additions, Balance, Motion, may_have
from stiffopt.discovery.sanity.orders import DEGREE, Motions, Reading
from stiffopt.discovery.sanity.samples import Samples
from stiffopt.discovery.settings import MOVING

# Share of a torque's variance up to which another description explains it.
EXPLAINS = 0.15
# The file's own fails from the first share on, where the other leaves less by the second factor.
_FAILS = ((0.3, 4.0), (0.04, 6.0))
# Or, of two joints or more at once, without anything that a robot may have besides.
_PLAINLY = (0.15, 8.0, 0.06)
# A joint must not be the worse for it: added share, and factor.
_WORSE = (0.1, 1.3)
_LEAST = min(share for share, _ in _FAILS)
# Gains up to which drives and their constants differ from data sheets.
_USUAL = (0.5, 2.0)
_FLOOR = 0.02
_MOST_STEPS = 3
# What one more step of a reading must gain, of the sum of logarithms over joints; and what a step
# costs where different explanations are weighed.
_STEP, _STEP_PRICE = 0.7, 0.5
# Share of a joint's range beyond its limits from which a reading is doubted for that.
_BEYOND_SHARE = 0.05
# Sizes of gains that are units or signs.
_UNITS = (1.0, 1e3, 1e-3)
# Delays that are tried [s]; shorter ones than the second are an effect of the catalogue.
_DELAYS = np.concatenate([-np.geomspace(2.0, 0.01, 40), np.geomspace(0.01, 2.0, 40)])
_LATE = 0.06


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
        free = self.gains is not None and not np.isin(np.abs(self.gains), _UNITS).all()
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
        self.balance = Balance(robot)
        self.motions = Motions(robot, samples)
        scale = robot.recordings.signals.scale_of("position", self.n)
        self.own = Reading.as_described(self.n, scale)
        self.motion = self.motions.of(self.own)

    @cached_property
    def strict(self) -> np.ndarray:
        """Shares (n,) that the file's own reading leaves."""
        return self._left(self.motion, self.samples.torque)

    @cached_property
    def left(self) -> np.ndarray:
        """The same where each joint may have a spring, and the arm another payload, besides.

        Not beside currents: such things can make torques of them.
        """
        strict = self.strict
        if self.robot.recordings.signals.currents:
            return strict
        return np.array([
            self.balance.left(self.motion, self.samples.torque[:, j], j, self._additions(j))
            if strict[j] > _LEAST else strict[j]
            for j in range(self.n)
        ])  # fmt: skip

    def best(self) -> Explanation | None:
        """The description that explains most of what the file's own does not, if one does."""
        if not (self.strict > _LEAST).any():
            return None
        found = [self._gravity(), self._delay(), self._gains(self.own), *self._readings()]
        candidates = [e for e in found if e is not None]
        return max(
            candidates, key=lambda e: e.score - e.price - self._beyond(e.reading), default=None
        )

    def _beyond(self, reading: Reading) -> float:
        """Price of a reading by which joints were where the robot's limits do not let them."""
        recordings = self.robot.recordings
        arm, order = recordings.robot, recordings.order
        lower, upper = arm.position_lower[order], arm.position_upper[order]
        position = self.motions.of(reading).position
        margin = _BEYOND_SHARE * (upper - lower)
        with np.errstate(invalid="ignore"):
            out = (position < lower - margin) | (position > upper + margin)
        return 2.0 * _STEP_PRICE if out.any() else 0.0

    def standing_in_degrees(self) -> Explanation | None:
        """Joints that hardly move as the degrees that they are stated in, but well as radians.

        Nothing can be told of their torques as described; as of a motion in rad they are those of
        the nominal model.
        """
        joints = np.array(self.own.in_degrees) & np.isnan(self.strict)
        while joints.any():
            scale = tuple(np.where(joints, 1.0 / DEGREE, 1.0))
            reading = replace(self.own, position_scale=scale, steps=1)
            left = self._left(self.motions.of(reading), self.samples.torque)
            with np.errstate(invalid="ignore"):
                fits = joints & (left < EXPLAINS)
                worse = left > np.maximum(self.strict + _WORSE[0], self.strict * _WORSE[1])
            if worse.any():
                return None
            if np.all(fits == joints):
                found = tuple(int(j) for j in np.flatnonzero(joints))
                score = float(-np.log(left[joints] + _FLOOR).sum())
                return Explanation(left=left, joints=found, score=score, reading=reading)
            joints = fits
        return None

    # ---- kinds of explanations

    def _gains(self, reading: Reading) -> Explanation | None:
        """Each joint's torque off by a factor, where that is far from 1."""
        motion = self.motions.of(reading)
        torque = reading.torque(self.samples.torque)
        before = self._left(motion, torque) if reading.steps else self.left
        gains, left = np.ones(self.n), np.array(before)
        ratio = [joint.ratio for joint in self.robot.constants.joints]
        for j in range(self.n):
            if not before[j] > _LEAST:
                continue
            usual = (-1.0, 1e3, 1e-3, -1e3, -1e-3, 1.0 / ratio[j], -1.0 / ratio[j])
            gain, share = self.balance.gain(motion, torque[:, j], j, usual)
            if not _USUAL[0] < gain < _USUAL[1] and _mends(before[j], share):
                gains[j], left[j] = gain, share
        if (gains == 1.0).all():
            return None
        self._like_the_others(gains, left, motion, torque)
        return self._explained(left, reading, gains=gains)

    def _like_the_others(
        self, gains: np.ndarray, left: np.ndarray, motion: Motion, torque: np.ndarray
    ) -> None:
        """Where a unit fits a joint that bears no weight, so may any factor: take another joint's.

        Changes `gains` and `left` (n,) in place.
        """
        units = np.isclose(np.abs(np.log10(np.abs(gains))), 3.0)
        told = [float(gain) for gain in gains[~units] if gain != 1.0]
        for j in np.flatnonzero(units) if told else ():
            gain, share = self.balance.gain(motion, torque[:, j], int(j), tuple(told))
            if gain in told and share < EXPLAINS:
                gains[j], left[j] = gain, share

    def _readings(self) -> list[Explanation]:
        """Other columns, signs and units, step by step; beside each its gains."""
        found, reading, left = [], self.own, self.strict
        for _ in range(_MOST_STEPS):
            tried = [
                (other, self._left(self.motions.of(other), other.torque(self.samples.torque)))
                for other in reading.neighbours(self.robot.recordings.prismatic)
            ]
            if not tried:
                break
            # Of those that are as good the first, which says the least.
            other, after = max(
                tried, key=lambda one: round(self._gain_of(left, one[1]) - self._beyond(one[0]), 1)
            )
            if reading is self.own:
                # Degrees and amperes at once: neither explains anything alone.
                all_joints = np.ones(self.n, dtype=bool)
                found.append(
                    self._gains(reading.in_other_units(self.robot.recordings.prismatic, all_joints))
                )
            if self._gain_of(left, after) < _STEP:
                break
            reading, left = other, after
            found.append(self._explained(left, reading))
        return [e for e in found if e is not None]

    def _gravity(self) -> Explanation | None:
        """Gravity along another direction of the base."""
        robot, motion = self.robot, self.motion
        stated = np.asarray(robot.recordings.gravity, dtype=float)
        pulls = np.stack(
            [robot.gravity_torque(motion.position, axis) for axis in np.eye(3)], axis=2
        )
        moving = motion.spring - pulls @ stated
        if not np.abs(pulls).max() > 0.0:
            return None
        direction = self._fitted_direction(moving, pulls)
        if direction is None:
            return self._weightless(moving)
        size = float(np.linalg.norm(stated))
        if size > 0.0 and 9.0 < size < 10.5 and direction @ stated > np.cos(np.pi / 6.0) * size:
            return None
        spring = moving + pulls @ (9.81 * direction)
        left = self._left(replace(motion, spring=spring), self.samples.torque)
        # A spring at one joint may look like it there, but not at all joints that carry weight.
        if not np.all((left <= self.left + 0.05) | np.isnan(left)):
            return None
        return self._explained(left, self.own, gravity=direction, against=self.strict)

    def _weightless(self, moving: np.ndarray) -> Explanation | None:
        """No weight in the torques at all, as where a controller adds it behind them."""
        left = self._left(replace(self.motion, spring=moving), self.samples.torque)
        if not np.all((left <= self.left + 0.05) | np.isnan(left)):
            return None
        return self._explained(left, self.own, gravity=np.zeros(3), against=self.strict)

    def _fitted_direction(self, moving: np.ndarray, pulls: np.ndarray) -> np.ndarray | None:
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

    def _delay(self) -> Explanation | None:
        """All torques recorded later or earlier than the motion."""
        best: tuple[float, np.ndarray] | None = None
        for delay in _DELAYS:
            left = self._left(self.motion, self.samples.torque_after(float(delay)))
            if best is None or np.nansum(left) < np.nansum(best[1]):
                best = float(delay), left
        if best is None or abs(best[0]) < _LATE:
            return None
        return self._explained(best[1], self.own, delay=best[0])

    # ---- how much they explain

    def _left(self, motion: Motion, torque: np.ndarray) -> np.ndarray:
        return np.array([self.balance.left(motion, torque[:, j], j) for j in range(self.n)])

    def _additions(self, joint: int) -> Additions:
        return may_have(self.robot, self.motion, joint)

    def _fails_where_it_moves(self, reading: Reading, left: np.ndarray) -> np.ndarray:
        """Joints (n,) whose own reading fails where another one says that they move.

        A joint that hardly moves by the other reading shows little that it would have to explain.
        """
        moves = np.abs(self.motions.of(reading).velocity) >= MOVING
        torque = np.where(moves, self.samples.torque, np.nan)
        there = [self.balance.left(self.motion, torque[:, j], j) for j in range(self.n)]
        return np.array([_mends(b, a) for b, a in zip(there, left, strict=True)])

    def _gain_of(self, before: np.ndarray, after: np.ndarray) -> float:
        ratio = np.log((before + _FLOOR) / (after + _FLOOR))
        return float(np.nansum(ratio))

    def _explained(
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
            mended = np.array([_mends(b, a) for b, a in zip(before, left, strict=True)])
            if reading.steps and gains is None:
                share, factor, most = _PLAINLY
                plain = (self.strict > share) & (left * factor < self.strict) & (left < most)
                mended |= plain & (plain.sum() > 1)
                mended &= self._fails_where_it_moves(reading, left)
            worse = left > np.maximum(self.strict + _WORSE[0], self.strict * _WORSE[1])
        if not mended.any() or worse.any():
            return None
        return Explanation(
            left=left,
            joints=tuple(int(j) for j in np.flatnonzero(mended)),
            score=self._gain_of(self.strict, left),
            reading=reading,
            gains=gains,
            gravity=gravity,
            delay=delay,
        )


def _mends(before: float, after: float) -> bool:
    """Whether one share of the variance explains what another leaves."""
    fails = any(before > share and after * factor < before for share, factor in _FAILS)
    return fails and after < EXPLAINS
