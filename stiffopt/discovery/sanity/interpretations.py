"""Interpretations of the same files, by units, signs and column order, at sampled instants."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from stiffopt.discovery.comparison.filtering import filter_slow_motion, near_gaps
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.torque_fit import Motion
from stiffopt.recording.run import RecordedRun

# Instants of all runs together: enough for a dozen columns, few enough to try many readings.
_MAX_INSTANTS = 900


@dataclass(frozen=True, eq=False)
class TorqueSeries:
    """Torques of one run with their times, to be read with a delay."""

    time: np.ndarray  # (K,) [s]
    torque: np.ndarray  # (K, n) filtered [N m]; nan if a joint has none
    at: np.ndarray  # (m,) sampled instants of the run [s]

    def shifted(self, delay: float) -> np.ndarray:
        """Return torques (m, n) recorded `delay` [s] after the instants."""
        when = self.at + delay
        return np.column_stack([np.interp(when, self.time, column) for column in self.torque.T])


# Fields of `Samples` with a row for every instant.
SAMPLED = ("position", "velocity", "acceleration", "torque")


@dataclass(frozen=True, eq=False)
class Samples:
    """Motion and torques at sampled instants of the runs, filtered alike."""

    # position, velocity, acceleration, torque (m, n): as recorded, in the order of the set; torque
    # is nan if a joint has none.
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    series: tuple[TorqueSeries, ...]  # one per run

    def select(self, rows: np.ndarray) -> Samples:
        """Return some of the instants."""
        return replace(self, **{name: getattr(self, name)[rows] for name in SAMPLED})


def sample_runs(runs: Sequence[RecordedRun]) -> Samples | None:
    """Sample instants of the usable runs; None if they are too short."""
    usable = [run for run in runs if run.usable]
    every = max(1, _MAX_INSTANTS // max(1, len(usable)))
    motions, series = [], []
    for run in usable:
        slow = filter_slow_motion(run)
        settling = slow.low_pass.settling
        inside = np.arange(settling, len(slow.time) - settling)
        bridged = near_gaps(_complete_stamps(run), run.step, slow.time, settling)
        inside = inside[~bridged[inside]]
        if len(inside) < 20:
            continue
        places = inside[np.linspace(0, len(inside) - 1, min(every, len(inside))).astype(int)]
        motions.append(np.stack([slow.position, slow.velocity, slow.acceleration])[:, places])
        series.append(TorqueSeries(slow.time, slow.torque, slow.time[places]))
    if not motions:
        return None
    q, v, a = np.concatenate(motions, axis=1)
    measured = np.vstack([each.shifted(0.0) for each in series])
    return Samples(q, v, a, measured, tuple(series))


def _complete_stamps(run: RecordedRun) -> np.ndarray:
    """Return the times at which every recorded channel has a finite value."""
    channels = np.hstack([run.position, run.torque])
    known = np.isfinite(channels)
    return np.asarray(run.time[(known | ~known.any(axis=0)).all(axis=1)])


# Possible units of positions of revolute and prismatic joints, in SI.
DEGREE, MILLIMETRE = np.pi / 180.0, 1e-3
# Zeros of joints in other conventions [rad], and those tried between them with the stated sign.
ZERO_CONVENTIONS = (0.5 * np.pi, -0.5 * np.pi, np.pi)
_OTHER_ZEROS = (0.25 * np.pi, -0.25 * np.pi, 0.75 * np.pi, -0.75 * np.pi)
# Clocks in ms, us and ns, and stamps counted at another rate.
_CLOCK_FACTORS = (1e-3, 1e-6, 1e-9, 0.01, 0.1, 10.0, 100.0, 1e3)


@dataclass(frozen=True, eq=False)
class Reading:
    """Assignment of columns to joints, with scale factors."""

    # position_from, torque_from (n,): number (from 0) of the joint whose columns each joint uses.
    position_from: tuple[int, ...]
    torque_from: tuple[int, ...]
    # position_scale, torque_scale (n,)
    position_scale: tuple[float, ...]
    torque_scale: tuple[float, ...]
    time_scale: float = 1.0  # factor of the time
    # (n,) joint (from 1) whose position is contained in that of each; negative where subtracted, 0
    # for none.
    includes: tuple[int, ...] = ()
    offset: tuple[float, ...] = ()  # (n,) added to positions [rad]
    steps: int = 0  # number of steps from the stated reading
    in_degrees: tuple[bool, ...] = ()  # (n,) joints with positions stated in degrees

    @staticmethod
    def as_described(n: int, position_scale: np.ndarray | None = None) -> Reading:
        """Return the stated reading; positions have been multiplied by a scale (n,)."""
        order, ones = tuple(range(n)), (1.0,) * n
        stated = np.ones(n) if position_scale is None else np.abs(position_scale)
        degrees = tuple(bool(is_) for is_ in np.isclose(stated, DEGREE))
        zeros = (0,) * n
        return Reading(order, order, ones, ones, includes=zeros, offset=zeros, in_degrees=degrees)

    def motion(self, samples: Samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration (m, n) of the joints in this reading."""
        take, scale = list(self.position_from), np.array(self.position_scale)
        position, velocity, acceleration = (
            values[:, take] * scale / self.time_scale**order
            for order, values in enumerate(
                (samples.position, samples.velocity, samples.acceleration)
            )
        )
        motion = [position.copy(), velocity.copy(), acceleration.copy()]
        for joint, other in enumerate(self.includes):
            if other:
                for own, values in zip(motion, (position, velocity, acceleration), strict=True):
                    own[:, joint] -= np.sign(other) * values[:, abs(other) - 1]
        return motion[0] + np.array(self.offset), motion[1], motion[2]

    def torque(self, measured: np.ndarray) -> np.ndarray:
        """Return torques (m, n) of the joints in this reading."""
        scaled: np.ndarray = measured[:, list(self.torque_from)] * np.array(self.torque_scale)
        return scaled

    def neighbours(self, prismatic: np.ndarray) -> Iterator[Reading]:
        """Yield readings one step further: units, two joints swapped, a sign, a clock."""
        n, parts = len(self.position_from), ("position", "torque", "both")
        for which in (*np.eye(n, dtype=bool), ~prismatic, prismatic, np.ones(n, dtype=bool)):
            other = self.in_other_units(prismatic, which)
            if other != self:
                yield other
        for part in parts:
            for one, two in combinations(range(n), 2):
                yield self._swap_joints(part, one, two)
            for joint in range(n):
                yield self._turn_sign(part, joint)
        for joint in np.flatnonzero(~prismatic).tolist():
            yield from self._turn_zero(joint)
            for beside in (joint - 1, joint + 1):
                if 0 <= beside < n and not prismatic[beside]:
                    yield from self._separate_sum(joint, beside)
        if self.time_scale == 1.0:
            for factor in _CLOCK_FACTORS:
                yield self._take_step(time_scale=factor)

    def in_other_units(self, prismatic: np.ndarray, which: np.ndarray) -> Reading:
        """Return the reading with these joints (n,) in degrees or mm, unless already so."""
        scale = tuple(
            s * (MILLIMETRE if slides else DEGREE) if chosen and abs(s) == 1.0 else s
            for s, slides, chosen in zip(self.position_scale, prismatic, which, strict=True)
        )
        return self if scale == self.position_scale else self._take_step(position_scale=scale)

    def with_offset(self, joint: int, offset: float) -> Reading:
        """Return the reading with another zero of one joint [rad]."""
        return replace(
            self, offset=tuple(offset if k == joint else own for k, own in enumerate(self.offset))
        )

    def _turn_zero(self, joint: int) -> Iterator[Reading]:
        """Yield the other zeros of a joint, a quarter or half a turn away, with either sign."""
        for sign in (1.0, -1.0):
            scale = _scale_joint(self.position_scale, joint, sign)
            torque = _scale_joint(self.torque_scale, joint, sign)
            for turn in (*ZERO_CONVENTIONS, *(_OTHER_ZEROS if sign > 0.0 else ())):
                offset = tuple(turn if k == joint else own for k, own in enumerate(self.offset))
                if offset == self.offset:
                    continue
                other = self._take_step(offset=offset, position_scale=scale)
                yield other
                if sign < 0.0:
                    yield replace(other, torque_scale=torque)

    def _separate_sum(self, joint: int, other: int) -> Iterator[Reading]:
        """Yield readings in which the position of a joint contains that of a neighbour."""
        if self.includes[joint] or self.includes[other]:
            return
        for sign in (1, -1):
            yield self._take_step(
                includes=tuple(
                    sign * (other + 1) if k == joint else own for k, own in enumerate(self.includes)
                )
            )

    def _take_step(self, **changes: Any) -> Reading:
        return replace(self, steps=self.steps + 1, **changes)

    def _swap_joints(self, part: str, one: int, two: int) -> Reading:
        changes: dict[str, Any] = {}
        for kind in ("position", "torque"):
            if part in (kind, "both"):
                for field in (f"{kind}_from", f"{kind}_scale"):
                    values = list(getattr(self, field))
                    values[one], values[two] = values[two], values[one]
                    changes[field] = tuple(values)
        return self._take_step(**changes)

    def _turn_sign(self, part: str, joint: int) -> Reading:
        changes: dict[str, Any] = {}
        for kind in ("position", "torque"):
            if part in (kind, "both"):
                field = f"{kind}_scale"
                changes[field] = _scale_joint(getattr(self, field), joint, -1.0)
        return self._take_step(**changes)


def _scale_joint(scale: tuple[float, ...], joint: int, factor: float) -> tuple[float, ...]:
    return tuple(s * factor if k == joint else s for k, s in enumerate(scale))


class Motions:
    """Cache of the motions of readings with nominal torques."""

    def __init__(self, robot: RobotModel, samples: Samples) -> None:
        self._robot, self._samples = robot, samples
        self._kept: dict[tuple[object, ...], Motion] = {}

    def of(self, reading: Reading) -> Motion:
        """Return the motion of a reading, independent of its torque columns."""
        key = (
            reading.position_from,
            reading.position_scale,
            reading.time_scale,
            reading.includes,
            reading.offset,
        )
        if key not in self._kept:
            self._kept[key] = Motion.of(self._robot, *reading.motion(self._samples))
        return self._kept[key]
