"""Fit of a law's shapes to the rows of a channel: amplitudes are eliminated, slopes are exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.law_search.open_channel import Fitted, OpenChannel
from stiffopt.discovery.laws.law import Law

# Gauss-Newton steps, halvings of a step that does not improve, and the relative decrease that ends.
_MAX_STEPS, _MAX_HALVINGS, _STEP_TOLERANCE = 12, 5, 1e-5
# Damping of a step over the squares of its slopes.
_STEP_DAMPING = 1e-4


@dataclass(frozen=True, eq=False)
class FittedLaw:
    """A law with fitted shapes and amplitudes."""

    law: Law
    fit: Fitted
    tried: int  # number of laws among which it was the best
    # Log evidence over no law, less the price of its parameters and of the laws tried.
    evidence: float

    @property
    def left(self) -> float:
        """Squares left in blocks that amplitudes were not fitted to."""
        return float(self.fit.left.sum())


def log_evidence(channel: OpenChannel, left: float, parameters: int, tried: int) -> float:
    """Return the log evidence of a fit over none, by the Bayesian information criterion.

    `left`: squares of the rows that the fit leaves. `tried`: number of laws of which it is the
    best: each had a chance to fit.

    The noise is unknown, and at least the stated one.
    """
    price = 0.5 * parameters * np.log(len(channel.target)) + np.log(max(tried, 1))
    return float(log_gain(channel, channel.square, left) - price)


def log_gain(channel: OpenChannel, before: float, after: float) -> float:
    """Return the log likelihood gained where the squares of a channel fall."""
    m = len(channel.target)
    return _log_likelihood(m, after) - _log_likelihood(m, before)


def _log_likelihood(count: int, square: float) -> float:
    """Return the largest log likelihood of rows with a sum of squares, of unit noise at least."""
    variance = max(square / count, 1.0)
    return float(-0.5 * (square / variance + count * np.log(variance)))


def as_fitted(channel: OpenChannel, law: Law, fit: Fitted, tried: int) -> FittedLaw:
    """Return a law with its evidence."""
    left = channel.square - fit.removed
    evidence = log_evidence(channel, left, law.parameter_count, tried)
    evidence += law.log_prior(channel.comparison.robot.n)
    return FittedLaw(law, fit, tried, evidence)


def fit_shapes(channel: OpenChannel, law: Law, tried: int) -> FittedLaw:
    """Fit the shapes of a law from their present values."""
    best = as_fitted(channel, law, channel.fit(channel.law_columns(law)), tried)
    if not law.shapes:
        return best
    size = np.array([high - low for low, high in law.bounds])
    for _ in range(_MAX_STEPS):
        step = _gauss_newton_step(channel, best, size)
        found = None
        for _ in range(_MAX_HALVINGS):
            moved = best.law.with_shapes(np.array(best.law.shapes) + step)
            found = as_fitted(channel, moved, channel.fit(channel.law_columns(moved)), tried)
            if found.fit.removed > best.fit.removed:
                break
            step, found = 0.4 * step, None
        if found is None:
            break
        settled = found.fit.removed - best.fit.removed < _STEP_TOLERANCE * found.fit.removed
        best = found
        if settled:
            break
    return best


def _gauss_newton_step(channel: OpenChannel, best: FittedLaw, size: np.ndarray) -> np.ndarray:
    """Return the step (s,) of the shapes, amplitudes following."""
    columns = channel.law_columns(best.law)
    slopes = channel.law_slopes(best.law, best.fit.amplitudes) * size
    residual = channel.target - columns @ best.fit.amplitudes
    along, _ = np.linalg.qr(columns)
    free = slopes - along @ (along.T @ slopes)
    gram = free.T @ free
    damping = _STEP_DAMPING * np.diag(np.diag(gram)) + 1e-12 * np.eye(len(gram))
    return np.asarray(size * np.linalg.solve(gram + damping, free.T @ residual))


def score_starts(channel: OpenChannel, laws: Sequence[Law]) -> list[Fitted]:
    """Return the fits of laws with their present shapes, computed together."""
    counts = [law.amplitude_count for law in laws]
    values = [
        [np.broadcast_to(v, run.time.shape) for law in laws for v in law.columns(run.signals)]
        for run in channel.comparison.runs
    ]
    columns = channel.columns(values)
    edges = np.cumsum([0, *counts])
    return [
        channel.fit(columns[:, first : first + count])
        for first, count in zip(edges, counts, strict=False)
    ]
