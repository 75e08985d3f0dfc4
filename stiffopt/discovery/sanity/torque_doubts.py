"""Doubts about torque channels: dead ones, and commands that repeat to the digit between runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.doubt import Doubt, format_joints
from stiffopt.discovery.sanity.interpretations import Samples
from stiffopt.discovery.sanity.torque_fit import Motion, TorqueFit
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun

# A channel is dead if its deviation is below the first share of that of the nominal torque, and
# the nominal torque leaves more than the second share of its variance at any gain.
_MAX_DEAD_SIZE, _MIN_UNRELATED_SHARE = 0.1, 0.9
# Share of equal samples of two runs from which a channel repeats, and values that it then has at
# least: a coarse or stationary channel repeats by chance.
_MIN_EQUAL_SHARE, _MIN_DISTINCT_VALUES = 0.9, 100


def doubt_dead_channels(
    recordings: RecordingSet, robot: RobotModel, samples: Samples
) -> Iterator[Doubt]:
    """Yield a doubt about torque channels that do not follow the motion at any gain.

    `samples`: of the training runs.
    """
    motion = Motion.of(robot, samples.position, samples.velocity, samples.acceleration)
    fit, dead, parts = TorqueFit(robot), [], []
    for j in range(recordings.n):
        torque = samples.torque[:, j]
        known = np.isfinite(torque)
        if not known.any():
            continue
        asked = motion.spring[known, j] + robot.friction(motion.velocity)[known, j]
        size = float(np.std(torque[known]))
        if size >= _MAX_DEAD_SIZE * float(np.std(asked)):
            continue
        if fit.gain(motion, torque, j, ())[1] > _MIN_UNRELATED_SHARE:
            unit = "N" if recordings.prismatic[j] else "N m"
            dead.append(j)
            parts.append(
                f"that of joint {j + 1} is {np.mean(torque[known]):.2g} +- {size:.2g} {unit}, the"
                f" motion takes up to {np.abs(asked).max():.3g} {unit}"
            )
    if dead:
        names = ['""' if j in dead else f'"{x}"' for j, x in enumerate(recordings.signals.torque)]
        yield Doubt(
            kind="dead channel",
            joints=tuple(j + 1 for j in dead),
            evidence=f"The torque of {format_joints(dead)} does not follow the motion:"
            f" {'; '.join(parts)}. The channel is not connected, or not filled.",
            line=f"torque = [{', '.join(names)}] in [signals]",
        )


def doubt_repeated_torques(runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Yield a doubt about torques that are equal to the digit in two runs: commands, or copies."""
    for first, second in combinations(runs, 2):
        count = min(len(first.time), len(second.time))
        equal = [
            j for j in range(first.n) if _repeats(first.torque[:count, j], second.torque[:count, j])
        ]
        if not equal:
            continue
        pair = f"{first.name} and {second.name}"
        copied = np.array_equal(first.position[:count], second.position[:count], equal_nan=True)
        if copied:
            evidence = f"{pair} are one recording: positions and torques are equal to the digit."
            evidence += " Leave one of them out."
        else:
            evidence = (
                f"The torque of {format_joints(equal)} is equal to the digit in {pair}, the"
                " positions are not: it looks commanded or calculated, not measured. Record the"
                " measured torque or current."
            )
        yield Doubt(
            kind="repeated run" if copied else "commanded torque",
            joints=tuple(j + 1 for j in equal),
            evidence=evidence,
        )
        return


def _repeats(first: np.ndarray, second: np.ndarray) -> bool:
    known = np.isfinite(first) & np.isfinite(second)
    if len(np.unique(first[known])) < _MIN_DISTINCT_VALUES:
        return False
    return bool(np.mean(first[known] == second[known]) > _MIN_EQUAL_SHARE)
