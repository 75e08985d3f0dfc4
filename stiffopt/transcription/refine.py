"""Place the intervals of the next mesh where the present solution bends."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import polynomial

from stiffopt.transcription.mesh import Mesh, equidistributed, split_counts
from stiffopt.transcription.transcription import Transcription

_SAMPLES = np.linspace(0.0, 1.0, 5)


def control_activity(transcription: Transcription, x: np.ndarray) -> np.ndarray:
    """How fast the controls change in each interval.

    Parameters
    ----------
    transcription : Transcription
    x : array
        A solution of its NLP.

    Returns
    -------
    array (K,)
        Largest total variation rate |du/dt| over the controls, each divided by its own range over
        the motion; jumps from the interval before count as change within the interval. [1/s]
    """
    steps = transcription.intervals.shares @ transcription.phase_durations(x)
    coefficients = transcription.control_polynomials(x)
    local = steps * _SAMPLES[:, None]
    values = polynomial.polyval(local[:, :, None], np.moveaxis(coefficients, 1, 0), tensor=False)
    spread = np.ptp(values.reshape(-1, values.shape[2]), axis=0)
    spread = np.where(spread > 0.0, spread, 1.0)
    change = np.abs(np.diff(values, axis=0)).sum(axis=0)
    change[1:] += np.abs(values[0, 1:] - values[-1, :-1])
    return np.asarray((change / spread).max(axis=1) / steps)


def refine_mesh(
    transcription: Transcription,
    x: np.ndarray,
    intervals: int,
    floor: float = 0.1,
    shortest: float = 0.1,
) -> Mesh:
    """Mesh whose intervals carry equal shares of the controls' activity.

    The monitor is sqrt(activity + floor * mean activity): where a control switches or a boundary
    layer sits the intervals get short, elsewhere they keep a bounded length.

    Parameters
    ----------
    transcription : Transcription
    x : array
        A solution of its NLP.
    intervals : int
        Of the new mesh, over all phases.
    floor : float
        Relative to the mean activity; larger values give more uniform meshes.
    shortest : float
        No interval becomes shorter than this share of the phase's mean interval (before the
        fractions are normalised again).

    Returns
    -------
    list of array
        Interval fractions of each phase.
    """
    present = transcription.intervals
    durations = transcription.phase_durations(x)
    activity = control_activity(transcription, x)
    mean = float(np.average(activity, weights=present.shares @ durations))
    monitor = np.sqrt(activity + floor * mean) if mean > 0.0 else np.ones(len(present))
    masses = np.array(
        [
            durations[phase] * np.sum((present.width * monitor)[present.phase == phase])
            for phase in range(transcription.ocp.phases)
        ]
    )
    counts = split_counts(intervals, masses)
    mesh = []
    for phase, count in enumerate(counts):
        own = present.phase == phase
        fractions = equidistributed(present.width[own], monitor[own], int(count))
        fractions = np.maximum(fractions, shortest / count)
        mesh.append(fractions / fractions.sum())
    return mesh
