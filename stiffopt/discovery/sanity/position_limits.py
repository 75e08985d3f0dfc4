"""Positions that lie beyond the limits of the robot's own file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stiffopt.discovery.sanity.doubt import Doubt
from stiffopt.discovery.sanity.lines import scale_line
from stiffopt.discovery.sanity.orders import DEGREE
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun

# How far beyond its limits a joint may read: share of its range, and [rad] or [m].
_BEYOND = (0.05, 0.02)


def beyond_limits(recordings: RecordingSet, runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Doubts of joints that read beyond their limits: a unit where that explains all of them.

    Parameters
    ----------
    recordings : RecordingSet
    runs : sequence of RecordedRun
    """
    lower = recordings.robot.position_lower[recordings.order]
    upper = recordings.robot.position_upper[recordings.order]
    span = upper - lower
    reach = np.full((2, recordings.n), np.nan)
    for run in runs:
        known = np.isfinite(run.position)
        low = np.where(known, run.position, np.inf).min(axis=0)
        high = np.where(known, run.position, -np.inf).max(axis=0)
        reach[0], reach[1] = np.fmin(reach[0], low), np.fmax(reach[1], high)
    margin = np.maximum(_BEYOND[0] * span, _BEYOND[1])
    with np.errstate(invalid="ignore"):
        out = np.isfinite(span) & ((reach[0] < lower - margin) | (reach[1] > upper + margin))
    if not out.any():
        return
    turning = ~recordings.prismatic
    in_degrees = DEGREE * reach
    fits = (in_degrees[0] >= lower - margin) & (in_degrees[1] <= upper + margin)
    far = np.nanmax(np.abs(reach[:, turning & out]), initial=0.0) > 3.0 * np.pi
    if far and np.all(fits | ~turning | ~np.isfinite(span)):
        yield Doubt(
            kind="position unit",
            joints=tuple(int(j) + 1 for j in np.flatnonzero(out)),
            evidence="The positions look like degrees: "
            + _reaches(recordings, reach, lower, upper, out),
            line=scale_line(recordings, "position", np.ones(recordings.n), "deg"),
        )
        return
    yield Doubt(
        kind="position limits",
        joints=tuple(int(j) + 1 for j in np.flatnonzero(out)),
        evidence="Positions lie beyond the limits of the robot's own file: "
        + _reaches(recordings, reach, lower, upper, out)
        + " Check their zero, sign and unit, or mend the limits there.",
        line="",
    )


def _reaches(
    recordings: RecordingSet,
    reach: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    out: np.ndarray,
) -> str:
    parts = [
        f"joint {j + 1} reads {reach[0, j]:.3g} to {reach[1, j]:.3g}"
        f" {'m' if recordings.prismatic[j] else 'rad'}, its limits are {lower[j]:.3g} to"
        f" {upper[j]:.3g}"
        for j in np.flatnonzero(out)
    ]
    return "; ".join(parts) + "."
