"""Gain of findings in stretches left out: what each removes, what stays open, how sure the gain is.

Every finding is compared with a fit without it; both predict parts of the recordings that neither
was fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from stiffopt.discovery.comparison.channel_rows import noise_above_cutoff
from stiffopt.discovery.comparison.comparison import Comparison, solve_boxed
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search.cross_validation import number_folds, stack_columns
from stiffopt.discovery.search.uncertainty import number_stretches
from stiffopt.discovery.thresholds import UNEXPLAINED_RATIO

# One-sided 95 % point of a correlation that is zero, in its standard deviations: a law that is
# missing shows as more.
_CHANCE_DEVIATIONS = 1.645


@dataclass(frozen=True, kw_only=True)
class LeftOutGain:
    """Gain of an effect in folds left out, against a refit without it.

    Parameters
    ----------
    removed : float
        Squares over the stated noise that it removes in its best channel.
    left_open : float
        Squares that the fit with it leaves there and that noise does not make: alike from row to
        row, or beyond those of the noise by more than inexact formulas make.
    share : float
        Share of the channel's squares that it removes, 0 to 1.
    support : float
        Probability that it improves predictions at all, by the spread of its gain between
        stretches (Student's t): errors of a law are correlated within a stretch, so that the number
        of samples says nothing.
    """

    removed: float
    left_open: float
    share: float
    support: float

    @property
    def open_share(self) -> float:
        """Share of what laws make in the channel that stays open, 0 to 1."""
        whole = self.removed + self.left_open
        return self.left_open / whole if whole > 0.0 else 1.0


def left_out_gains(
    comparison: Comparison, effects: Sequence[LocatedEffect]
) -> tuple[LeftOutGain, ...]:
    """Return the gain of every effect in folds left out."""
    if not effects:
        return ()
    columns, prior, owner = stack_columns(comparison, effects)
    fold, stretch = number_folds(comparison), number_stretches(comparison)
    if stretch.max() < fold.max():
        stretch = fold
    channel, noise = comparison.rows.channel, comparison.inflation[comparison.rows.channel] ** 2
    # Noise above the filter's band may exceed the stated one.
    stated = np.concatenate([comparison.noise.torque, comparison.noise.deflection])
    held = np.fmax(noise_above_cutoff(comparison.nominal_runs) / stated, 1.0)
    usual = (UNEXPLAINED_RATIO * held) ** 2
    limits = comparison.limits(len(prior))
    predictions = _FoldPredictions(columns, comparison.target, prior, limits, fold)
    now = predictions.residual(np.ones(len(owner), dtype=bool))
    gains = []
    for k in range(len(effects)):
        without = predictions.residual(owner != k)
        fall = without**2 - now**2
        own = channel == int(np.argmax(np.bincount(channel, fall)))
        removed = max(float(np.sum((fall * noise)[own])), 0.0)
        before = float(np.sum(without[own] ** 2))
        gains.append(
            LeftOutGain(
                removed=removed,
                left_open=max(
                    _smooth_squares(comparison, now * noise**0.5, own),
                    float(np.sum((now**2 * noise)[own] - usual[channel[own]])),
                ),
                share=float(np.clip(np.sum(fall[own]) / before, 0.0, 1.0)) if before > 0.0 else 0.0,
                support=_probability_of_gain(np.bincount(stretch, fall)),
            )
        )
    return tuple(gains)


class _FoldPredictions:
    """Predictions of every fold by fits to the other folds, with some of the columns (m, p).

    Nominal values keep their bounds: beyond them they would stand for the effect that is left out,
    as torque constants twice their size do for a load about which the columns are linear.
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

    def residual(self, kept: np.ndarray) -> np.ndarray:
        """Return the residual (m,) with the columns of a mask (p,)."""
        left, prior, limits = self._target.copy(), self._prior[kept], self._limits[kept]
        whole = self._gram.sum(axis=0)[kept][:, kept]
        moment = self._moment.sum(axis=0)[kept]
        for own, gram, part in zip(self._rows, self._gram, self._moment, strict=True):
            others, goal = whole - gram[kept][:, kept], moment - part[kept]
            values = np.linalg.solve(others + np.diag(prior**-2.0), goal)
            if np.any(np.abs(values) > limits * prior):
                values = solve_boxed(others, goal, prior, limits)
            left[own] -= self._columns[own][:, kept] @ values
        return left


def _smooth_squares(comparison: Comparison, residual: np.ndarray, own: np.ndarray) -> float:
    """Return the squares of a residual (m,) in some rows that neighbouring rows share.

    Filtered noise is correlated as far as the filter makes it; what is correlated beyond that, and
    beyond chance, is no noise.
    """
    run = comparison.rows.sample_signal(lambda each: np.full(len(each.time), float(each.index)))
    time = comparison.rows.sample_signal(lambda each: each.time)
    filters = {float(each.index): each.low_pass for each in comparison.runs}
    shared, square, white = 0.0, 0.0, 0.0
    for number, low_pass in filters.items():
        rows = own & (run == number)
        left, gaps = residual[rows], np.diff(time[rows])
        if len(left) < 2:
            continue
        beside, white = gaps < 1.5 * gaps.min(), low_pass.row_correlation
        shared += float(np.sum((left[1:] * left[:-1])[beside])) / float(np.mean(beside))
        shared -= white * float(left @ left)
        square += float(left @ left)
    chance = _CHANCE_DEVIATIONS * float(own.sum()) ** -0.5
    return float(max(shared - chance * square, 0.0) / (1.0 - white))


def _probability_of_gain(falls: np.ndarray) -> float:
    """Return the probability that the mean of falls of squares (b,) is above zero."""
    spread = float(falls.std(ddof=1)) if len(falls) > 1 else 0.0
    if spread == 0.0:
        return 0.5 if falls.sum() <= 0.0 else 1.0
    return float(special.stdtr(len(falls) - 1, falls.mean() / spread * np.sqrt(len(falls))))
