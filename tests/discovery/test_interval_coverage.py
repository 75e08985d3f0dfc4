"""Intervals of reported values hold the truth as often as stated, from few runs and with priors."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from linear_comparison import linear_comparison

from stiffopt.discovery.search.uncertainty import estimate_parameters

RUNS, SAMPLES, SIZE = 4, 60, 3.0


def _interval(rng: np.random.Generator, *, tolerance: float, differs: float) -> tuple[float, float]:
    """Estimate an amplitude beside a nominal value that resembles it; return error and deviation.

    `tolerance`: prior deviation of that value. `differs`: deviation of the amplitude between runs.
    """
    run = np.repeat(np.arange(RUNS), SAMPLES)
    column = rng.normal(size=len(run))
    nominal = column + 0.3 * rng.normal(size=len(run))
    amplitude = SIZE + differs * rng.normal(size=RUNS)[run]
    target = amplitude * column + tolerance * rng.normal() * nominal + rng.normal(size=len(run))
    prior = np.array([tolerance, 1.0])
    # An amplitude over its size has a prior deviation of one.
    columns = np.column_stack([nominal, SIZE * column])
    gram = columns.T @ columns + np.diag(prior**-2.0)
    mean = np.linalg.solve(gram, columns.T @ target)
    comparison = linear_comparison(
        columns, target, mean, runs=RUNS, duration=5.0, priors=(tolerance,)
    )
    located = SimpleNamespace(
        shapes=(),
        is_run_specific=False,
        sizes=lambda constants: np.array([SIZE]),
        effect=SimpleNamespace(
            amplitudes=("A",),
            drawn=None,
            takes_recorded=False,
            parameters=lambda amplitudes, shapes, constants: {"A": float(amplitudes[0])},
        ),
    )
    value, sd = estimate_parameters(comparison, [located]).parameters(0, None)["A"]
    return value - SIZE, sd


@pytest.mark.parametrize(
    ("tolerance", "differs"), [(1e-3, 0.0), (0.3, 0.0), (1e-3, 0.3), (0.1, 0.3)]
)
def test_interval_of_95_percent_holds_the_truth(tolerance: float, differs: float) -> None:
    rng = np.random.default_rng(5)
    each = [_interval(rng, tolerance=tolerance, differs=differs) for _ in range(400)]
    held = np.mean([abs(error) <= 1.96 * sd for error, sd in each])
    assert 0.92 <= held <= 0.995
