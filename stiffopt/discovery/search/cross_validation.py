"""Cross-validation: every fold of the recordings is predicted by fits to the other folds.

Folds are whole runs where there are several, else parts of runs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.discovery.comparison.channel_rows import part_numbers
from stiffopt.discovery.comparison.comparison import Comparison, solve_boxed
from stiffopt.discovery.comparison.design_matrix import MIN_RUNS_AS_BLOCKS
from stiffopt.discovery.comparison.located_effect import LocatedEffect

# Number of folds, over all runs, where runs are few.
FOLDS_OF_FEW_RUNS = 6


def stack_columns(
    comparison: Comparison, effects: Sequence[LocatedEffect]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return all columns, their priors, and the index of each column's effect (-1: nominal)."""
    _, sd = comparison.priors
    counts = [len(e.effect.amplitudes) for e in effects]
    owner = np.repeat(np.arange(-1, len(effects)), [len(sd), *counts])
    prior = np.concatenate([sd, np.ones(len(owner) - len(sd))])
    return comparison.stack_columns(effects), prior, owner


class FoldPredictions:
    """Predictions of every fold by fits to the other folds.

    `columns` (m, p). `target` (m,). `prior`, `limits` (p,): standard deviations, and bounds in
    units of them. Nominal values keep their bounds: beyond them they would stand for an effect that
    is left out, as torque constants twice their size do for a load about which the columns are
    linear. `fold` (m,) of int.
    """

    def __init__(
        self,
        columns: np.ndarray,
        target: np.ndarray,
        prior: np.ndarray,
        limits: np.ndarray,
        fold: np.ndarray,
    ) -> None:
        self._columns, self._target = columns, target
        self._prior, self._limits = prior, limits
        self._rows = [np.flatnonzero(fold == number) for number in range(int(fold.max()) + 1)]
        self._gram = np.array([columns[own].T @ columns[own] for own in self._rows])
        self._moment = np.array([columns[own].T @ target[own] for own in self._rows])

    def residual(self, kept: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Return the residual (m,) with the columns of a mask (p,)."""
        left, prior, limits = self._target.copy(), self._prior[kept], self._limits[kept]
        whole = self._gram.sum(axis=0)[kept][:, kept]
        moment = self._moment.sum(axis=0)[kept]
        for own, gram, part in zip(self._rows, self._gram, self._moment, strict=True):
            others, goal = whole - gram[kept][:, kept], moment - part[kept]
            left[own] -= self._columns[own][:, kept] @ _solve_within(others, goal, prior, limits)
        return left

    def prior_squares(self, kept: np.ndarray, count: int) -> float:
        """Return the squares over priors of the first columns (k,), fitted to all folds."""
        prior, limits = self._prior[kept], self._limits[kept]
        whole, moment = self._gram.sum(axis=0)[kept][:, kept], self._moment.sum(axis=0)[kept]
        values = _solve_within(whole, moment, prior, limits)
        return float(np.sum((values[:count] / prior[:count]) ** 2))

    def squares(self, first: np.ndarray) -> float:
        """Return the sum of squares of the residual with other priors of the first columns (k,).

        Without bounds, since priors are compared by the thousand.
        """
        prior = np.concatenate([first, self._prior[len(first) :]])
        whole = self._gram.sum(axis=0) + np.diag(prior**-2.0)
        moment, total = self._moment.sum(axis=0), float(self._target @ self._target)
        for gram, part in zip(self._gram, self._moment, strict=True):
            values = np.linalg.solve(whole - gram, moment - part)
            total += float(values @ gram @ values - 2.0 * part @ values)
        return total


def _solve_within(
    gram: np.ndarray, moment: np.ndarray, prior: np.ndarray, limits: np.ndarray
) -> np.ndarray:
    """Return the likeliest values (k,), within bounds where they would leave them."""
    values = np.linalg.solve(gram + np.diag(prior**-2.0), moment)
    beyond = np.any(np.abs(values) > limits * prior)
    return solve_boxed(gram, moment, prior, limits) if beyond else values


def predict_folds(comparison: Comparison, effects: Sequence[LocatedEffect]) -> FoldPredictions:
    """Return the predictions of folds by fits with effects."""
    columns, prior, _ = stack_columns(comparison, effects)
    limits, fold = comparison.limits(len(prior)), number_folds(comparison)
    return FoldPredictions(columns, comparison.target, prior, limits, fold)


def folds_per_run(runs: int) -> int:
    """Return the number of folds that each run is cut into."""
    return 1 if runs >= 2 * MIN_RUNS_AS_BLOCKS else -(-FOLDS_OF_FEW_RUNS // runs)


def number_folds(
    comparison: Comparison, parts: int | None = None, begin: float = 0.0
) -> np.ndarray:
    """Return the fold number of every row (m,): runs, or parts of runs in time.

    `begin`: share of each run before its first part.
    """
    rows = comparison.rows
    cut = folds_per_run(len(comparison.runs)) if parts is None else parts
    part = rows.sample_signal(lambda run: part_numbers(run.time, cut, begin))
    return np.unique(rows.run * cut + part, return_inverse=True)[1]
