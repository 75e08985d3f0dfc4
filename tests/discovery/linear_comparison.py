"""A comparison of given columns with a given target, for estimates without recordings."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np


def linear_comparison(
    columns: np.ndarray,
    target: np.ndarray,
    values: np.ndarray,
    *,
    runs: int,
    duration: float,
    priors: Sequence[float] = (),
) -> SimpleNamespace:
    """Return the comparison of runs of equal length, one after the other in the rows (m, p).

    `values` (p,): fitted nominal values, of which `priors` are the deviations, then amplitudes.
    """
    run = np.repeat(np.arange(runs), len(target) // runs)
    recorded = [SimpleNamespace(time=np.linspace(0.0, duration, len(target) // runs))] * runs
    return SimpleNamespace(
        runs=recorded,
        rows=SimpleNamespace(
            block=run,
            run=run,
            sample_signal=lambda value: np.concatenate([value(each) for each in recorded]),
        ),
        priors=(tuple(f"nominal {k}" for k in range(len(priors))), np.array(priors)),
        constants=None,
        target=target,
        fit=lambda effects: SimpleNamespace(
            amplitudes=lambda: values[len(priors) :], posterior=SimpleNamespace(mean=values)
        ),
        stack_columns=lambda effects: columns,
    )
