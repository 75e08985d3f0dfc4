"""Contacts at rest: a stationary joint that carries more than its weight and friction can hold.

A fit leaves stationary joints out, whose friction is anything between its bounds. A load beyond
these bounds is nevertheless one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stiffopt.discovery.comparison.filtering import filter_slow_motion
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.doubt import Doubt
from stiffopt.discovery.settings import MIN_MOVING_SPEED
from stiffopt.recording.channel import true_intervals
from stiffopt.recording.run import RecordedRun

# Shortest interval [s].
_MIN_DURATION = 0.3
# Bound of the friction at rest over the Coulomb friction; error of the weight over itself; and the
# excess over both from which an interval counts, over the Coulomb friction.
_STICTION_RATIO, _WEIGHT_TOLERANCE, _MIN_EXCESS = 1.5, 0.1, 0.5
# Largest share of the stationary time with an excess: more is a wrong model, not a contact.
_MAX_SHARE = 0.5


def doubt_contacts_at_rest(robot: RobotModel, runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Yield a remark about every interval in which a stationary joint carries a further load.

    `robot`: joints without stated friction are left out.
    """
    for run in runs:
        if not run.usable:
            continue
        slow = filter_slow_motion(run)
        load = robot.spring_torque(slow.position, slow.velocity, slow.acceleration)
        rest = np.abs(slow.velocity) < MIN_MOVING_SPEED
        carried = slow.torque - load - robot.rotor_inertia * slow.acceleration
        bound = _STICTION_RATIO * robot.coulomb + _WEIGHT_TOLERANCE * np.abs(load)
        excess = np.where(rest & np.isfinite(carried), np.abs(carried) - bound, -np.inf)
        for j in np.flatnonzero(robot.coulomb > 0.0).tolist():
            found = excess[:, j] > _MIN_EXCESS * robot.coulomb[j]
            if found.sum() > _MAX_SHARE * rest[:, j].sum():
                continue
            for begin, end in true_intervals(found):
                if (end - begin) * slow.dt >= _MIN_DURATION:
                    yield _describe_contact(robot, run, slow.time, carried[:, j], j, (begin, end))


def _describe_contact(
    robot: RobotModel,
    run: RecordedRun,
    time: np.ndarray,
    carried: np.ndarray,
    joint: int,
    interval: tuple[int, int],
) -> Doubt:
    begin, end = interval
    unit = "N" if robot.recordings.prismatic[joint] else "N m"
    most = float(np.abs(carried[begin:end]).max())
    return Doubt(
        kind="contact at rest",
        joints=(joint + 1,),
        evidence=f"In {run.name}, {time[begin]:.2f} to {time[end - 1]:.2f} s, joint {joint + 1}"
        f" stands and carries {most:.3g} {unit} beside its weight, where friction holds"
        f" {robot.coulomb[joint]:.3g} {unit}: something touches or loads the arm there.",
    )
