"""Integral part of a position controller, told from errors that fade under a lasting load."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.actuator_estimate import JointRows, joint_rows, least_squares
from stiffopt.discovery.sanity.doubt import Doubt, format_joints
from stiffopt.discovery.thresholds import NAMED_EVIDENCE
from stiffopt.formatting import pm
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun

# Least integral gain over the proportional one that is one [1/s]: slower, an error that lasts for
# ten seconds adds less than itself, as the drift of an offset does.
_MIN_RATE = 0.1


def doubt_integral_parts(
    recordings: RecordingSet, robot: RobotModel, runs: Sequence[RecordedRun]
) -> Iterator[Doubt]:
    """Doubt commands of controllers that integrate the error, which no law of [actuator] does."""
    law = recordings.actuator
    if not recordings.signals.commanded or law is None:
        return
    delay = law.delay if np.isfinite(law.delay) else 0.0
    found = {}
    for j in range(robot.n):
        rows = joint_rows(robot, runs, j)
        if rows is None:
            continue
        rate, spread, evidence = integral_rate(rows, delay)
        if evidence > NAMED_EVIDENCE and rate > _MIN_RATE:
            found[j] = pm(rate, spread, "1/s")
    if found:
        yield Doubt(
            kind="integral part",
            joints=tuple(j + 1 for j in found),
            evidence=f"The position error of {format_joints(list(found))} fades under a lasting"
            f" load: the controller has an integral part of {', '.join(found.values())} times its"
            " proportional gain, and torques derived from commands are without it. Switch it off"
            " (I gain 0) and record again, or record currents.",
        )


def integral_rate(rows: JointRows, delay: float) -> tuple[float, float, float]:
    """Return the integral over the proportional gain [1/s], its deviation, and log likelihood gain.

    The error is (weight and inertia + friction) / k less the rate times its own integral, which
    begins at an unknown value in every run.
    """
    begins = (rows.run[:, None] == np.unique(rows.run)).astype(float)
    table = np.column_stack([rows.load, rows.columns[:, :-1], begins])
    error = rows.error(delay)
    _, _, without = least_squares(table, error, rows.independent)
    whole = np.column_stack([table, -rows.integral(delay)])
    factors, spread, square = least_squares(whole, error, rows.independent)
    gain = 0.5 * rows.independent * float(np.log(without / square)) if square > 0.0 else 0.0
    return float(factors[-1]), float(spread[-1]), gain
