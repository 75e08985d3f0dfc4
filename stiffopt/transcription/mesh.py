"""Meshes: division of each phase into intervals, uniform; mesh refinement by control activity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import polynomial

from stiffopt.errors import ProblemError

if TYPE_CHECKING:
    from stiffopt.transcription.transcription import Transcription


# One array a phase: the shares of the phase's duration that its intervals take; each sums to one.
Mesh = list[np.ndarray]


def uniform_mesh(intervals: int, phases: int = 1, shares: Sequence[float] | None = None) -> Mesh:
    """Equal intervals within each phase: `intervals` in all, at least one a phase.

    `shares` are positive proportions of intervals among the phases; equal when absent.
    """
    if intervals < phases:
        raise ProblemError(
            f"mesh: {intervals} intervals cannot cover {phases} phases. Give at least one interval "
            "a phase."
        )
    weights = np.ones(phases) if shares is None else np.asarray(shares, dtype=float)
    counts = split_counts(intervals, weights)
    return [np.full(count, 1.0 / count) for count in counts]


def split_counts(total: int, weights: np.ndarray, least: int = 1) -> np.ndarray:
    """Find whole numbers close to the weights' proportions that sum to `total`, each >= `least`."""
    least = min(least, total // len(weights))
    exact = np.asarray(weights, dtype=float) / np.sum(weights) * total
    counts = np.maximum(np.floor(exact).astype(int), least)
    while counts.sum() < total:
        counts[np.argmax(exact - counts)] += 1
    while counts.sum() > total:
        counts[np.argmax(np.where(counts > least, counts - exact, -np.inf))] -= 1
    return np.asarray(counts)


def equidistribute(fractions: np.ndarray, monitor: np.ndarray, count: int) -> np.ndarray:
    """Place `count` intervals with equal integrals of a piecewise-constant, positive monitor."""
    mass = np.concatenate([[0.0], np.cumsum(fractions * monitor)])
    breaks = np.concatenate([[0.0], np.cumsum(fractions)])
    new = np.interp(np.linspace(0.0, mass[-1], count + 1), mass, breaks)
    new[0], new[-1] = 0.0, breaks[-1]
    return np.asarray(np.diff(new) / breaks[-1])


_INTERVAL_SAMPLES = np.linspace(0.0, 1.0, 5)


def control_activity(transcription: Transcription, x: np.ndarray) -> np.ndarray:
    """Rate of change of the controls in each interval (K,) [1/s] of a solution `x`.

    Largest total variation rate |du/dt| over the controls, each divided by its own range over the
    motion; jumps from the interval before count as change within the interval.
    """
    steps = transcription.steps(x)
    coefficients = transcription.control_polynomials(x)
    local = steps * _INTERVAL_SAMPLES[:, None]
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
    """Return a mesh of `intervals` whose intervals have equal shares of the controls' activity.

    The monitor is sqrt(activity + floor * mean activity): where a control switches or a boundary
    layer lies the intervals become short, elsewhere they keep a bounded length. No interval becomes
    shorter than the share `shortest` of the phase's mean interval (before the fractions are
    normalised again).
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
        fractions = equidistribute(present.width[own], monitor[own], int(count))
        fractions = np.maximum(fractions, shortest / count)
        mesh.append(fractions / fractions.sum())
    return mesh
