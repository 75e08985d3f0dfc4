"""Cross-validation: every fold of the recordings is predicted by fits to the other folds.

Folds are whole runs where there are several, else parts of runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.channel_rows import part_numbers
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.design_matrix import MIN_RUNS_AS_BLOCKS
from stiffopt.discovery.comparison.located_effect import LocatedEffect

# Number of folds, over all runs, where runs are few: a fit has to carry over to a sixth of them.
FOLDS_OF_FEW_RUNS = 6
# Rounding of a value at its bound; exchanges of all values that do not make wrong ones fewer.
_BOUND_ROUNDING, _MAX_TRIALS = 1e-9, 3


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
        self._target, self._prior, self._limits = target, prior, limits
        self._rows = [np.flatnonzero(fold == number) for number in range(int(fold.max()) + 1)]
        self._columns = [columns[own] for own in self._rows]
        self._gram = np.array([own.T @ own for own in self._columns])
        self._moment = np.array(
            [own.T @ target[rows] for own, rows in zip(self._columns, self._rows, strict=True)]
        )

    @cached_property
    def _others(self) -> list[_Normal]:
        """Normal equations without each fold."""
        gram, moment = self._gram.sum(axis=0), self._moment.sum(axis=0)
        return [
            _Normal(gram - own, moment - part, self._prior, self._limits)
            for own, part in zip(self._gram, self._moment, strict=True)
        ]

    @cached_property
    def _whole(self) -> _Normal:
        """Normal equations of all folds."""
        gram, moment = self._gram.sum(axis=0), self._moment.sum(axis=0)
        return _Normal(gram, moment, self._prior, self._limits)

    def residual(self, kept: np.ndarray | None = None) -> np.ndarray:
        """Return the residual (m,) with the columns of a mask (p,), default all."""
        return self._left_by(others.values(kept) for others in self._others)

    def residual_within_bounds(self, comparison: Comparison) -> np.ndarray:
        """Return the residual (m,) of fits with consistent bodies, as whole recordings get them."""
        return self._left_by(
            comparison.within_bounds(own.values(), own.gram, own.moment, self._prior)
            for own in self._others
        )

    def _left_by(self, values: Iterable[np.ndarray]) -> np.ndarray:
        """Return the residual (m,) of every fold by its own values (p,)."""
        left = self._target.copy()
        for rows, columns, own in zip(self._rows, self._columns, values, strict=True):
            left[rows] -= columns @ own
        return left

    def prior_squares(self, count: int, kept: np.ndarray | None = None) -> float:
        """Return the squares over priors of the first columns (k,), fitted to all folds."""
        return float(np.sum((self._whole.values(kept)[:count] / self._prior[:count]) ** 2))

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


class _Normal:
    """Normal equations, solved once for all columns and corrected for values that are held."""

    def __init__(
        self, gram: np.ndarray, moment: np.ndarray, prior: np.ndarray, limits: np.ndarray
    ) -> None:
        self.gram, self.moment = gram, moment
        self._prior, self._limits = prior, limits
        self._inverse = np.linalg.inv(gram * np.outer(prior, prior) + np.eye(len(prior)))
        self._likeliest = self._inverse @ (prior * moment)

    def values(self, kept: np.ndarray | None = None) -> np.ndarray:
        """Return the likeliest values (p,) within their bounds.

        `kept` (p,): mask of the columns that are fitted; the others are zero. Values that leave
        their bounds are held there, and let go where they press inwards: all at once, or one at a
        time where that does not make them fewer.
        """
        held = np.zeros(len(self._prior), dtype=bool) if kept is None else ~kept
        bound, fewest, trials = np.zeros(len(self._prior)), len(self._prior) + 1, 0
        while True:
            found, pressed = self._likeliest.copy(), np.zeros(len(self._prior))
            if held.any():
                inner = self._inverse[np.ix_(held, held)]
                pressed[held] = np.linalg.solve(inner, (found - bound)[held])
                found -= self._inverse @ pressed
                found[held] = bound[held]
            outside = np.abs(found) > (1.0 + _BOUND_ROUNDING) * self._limits
            wrong = np.flatnonzero(np.where(held, pressed * bound < 0.0, outside))
            if not wrong.size:
                return np.asarray(self._prior * found)
            if wrong.size < fewest:
                fewest, trials = wrong.size, 0
            elif (trials := trials + 1) > _MAX_TRIALS:
                wrong = wrong[-1:]
            bound[wrong] = np.where(
                held[wrong], 0.0, np.copysign(self._limits[wrong], found[wrong])
            )
            held[wrong] = ~held[wrong]


def predict_folds(comparison: Comparison, effects: Sequence[LocatedEffect]) -> FoldPredictions:
    """Return the predictions of folds by fits with effects."""
    columns, prior, _ = stack_columns(comparison, effects)
    limits, fold = comparison.limits(len(prior)), number_folds(comparison)
    return FoldPredictions(columns, comparison.target, prior, limits, fold)


def folds_per_run(runs: int, folds: int = FOLDS_OF_FEW_RUNS) -> int:
    """Return the number of folds that each of few runs is cut into; many are folds themselves."""
    return 1 if runs >= 2 * MIN_RUNS_AS_BLOCKS else -(-folds // runs)


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
