"""Gain of findings in folds left out: what each removes, what stays open, how sure the gain is.

A search uses all training runs, and where a nominal model lacks many effects, some formula gains a
little everywhere. Every finding is therefore compared with a fit without it; both predict parts of
the recordings that neither was fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from stiffopt.discovery.comparison.channel_rows import elapsed_shares, noise_above_cutoff
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search.cross_validation import (
    FOLDS_OF_FEW_RUNS,
    FoldPredictions,
    folds_per_run,
    number_folds,
    stack_columns,
)
from stiffopt.discovery.search.uncertainty import number_stretches
from stiffopt.discovery.thresholds import (
    FOUND_PROBABILITY,
    MAX_CANCELLATION_RATIO,
    MIN_ACTIVE_SHARE,
    MIN_CHANGE_SHARE,
    MIN_HELD_OUT_SHARE,
    NAMED_PROBABILITY,
    RARE_SHARE,
    UNEXPLAINED_RATIO,
)

# An effect that acts in fewer folds is judged in parts of every run.
_MIN_ACTIVE_FOLDS = 3


@dataclass(frozen=True, kw_only=True)
class LeftOutGain:
    """Gain of an effect in folds left out, against a refit without it."""

    removed: float  # squares over the stated noise that it removes in its best channel
    # Squares that the fit with it leaves there and that noise does not make: alike from row to row,
    # or beyond those of the noise by more than inexact formulas make.
    left_open: float
    # share, explained: share of the channel's squares that it removes, and of those beyond the
    # stated noise, 0 to 1.
    share: float
    explained: float
    # Its best channel among those that it acts on: others improve through nominal values.
    channel: int
    # Probability that it improves predictions where it acts, by the spread of its gain between
    # stretches (Student's t): errors of a law are correlated within a stretch, so that the number
    # of samples says nothing.
    support: float

    @property
    def open_share(self) -> float:
        """Share of what laws make in the channel that stays open, 0 to 1."""
        whole = self.removed + self.left_open
        return self.left_open / whole if whole > 0.0 else 1.0


def left_out_gains(
    comparison: Comparison,
    effects: Sequence[LocatedEffect],
    begin: float = 0.0,
    count: int = FOLDS_OF_FEW_RUNS,
) -> tuple[LeftOutGain, ...]:
    """Return the gain of every effect in folds left out.

    `begin`: share of each run's start that is in no fold. `count`: folds of few runs.

    Folds are smaller parts of every run for an effect that acts in few of them: if each joint moves
    in a run of its own, the other runs say nothing of it.
    """
    if not effects:
        return ()
    columns, prior, owner = stack_columns(comparison, effects)
    kept = comparison.rows.sample_signal(lambda run: elapsed_shares(run.time)) >= begin
    columns *= kept[:, None]
    target, limits = kept * comparison.target, comparison.limits(len(prior))
    parts = folds_per_run(len(comparison.runs), count)
    fold = number_folds(comparison, parts, begin)
    few = [
        parts < FOLDS_OF_FEW_RUNS
        and (e.is_run_specific or _is_seldom(columns[:, owner == k], fold))
        for k, e in enumerate(effects)
    ]
    folds = {False: fold}
    if any(few):
        folds[True] = number_folds(comparison, FOLDS_OF_FEW_RUNS, begin)
    ways = {
        fine: FoldPredictions(columns, target, prior, limits, own) for fine, own in folds.items()
    }
    now = {fine: way.residual() for fine, way in ways.items()}
    judge = _GainJudge(comparison, kept, begin)
    # Free bodies have no tolerance that they could leave.
    nominal = int(np.sum(owner < 0)) if comparison.bodies is None else 0
    relieved = ways[few[0]].prior_squares(nominal)
    return tuple(
        judge.gain(
            columns[:, owner == k],
            now[fine],
            ways[fine].residual(owner != k),
            ways[fine].prior_squares(nominal, owner != k) - relieved,
        )
        for k, fine in enumerate(few)
    )


def _is_seldom(columns: np.ndarray, fold: np.ndarray) -> bool:
    """True if an effect with columns (m, k) acts in few of the folds."""
    square = np.bincount(fold, np.sum(columns**2, axis=1))
    return bool(np.sum(square > MIN_ACTIVE_SHARE * square.max()) < _MIN_ACTIVE_FOLDS)


class _GainJudge:
    """Gains of effects by the residuals of folds left out, with and without them."""

    def __init__(self, comparison: Comparison, kept: np.ndarray, begin: float) -> None:
        self._comparison, self._kept = comparison, kept
        stretch, fold = number_stretches(comparison, begin), number_folds(comparison, None, begin)
        self._stretch = fold if stretch.max() < fold.max() else stretch
        # Noise above the filter's band may exceed the stated one.
        held = noise_above_cutoff(comparison.nominal_runs) / comparison.noise.stacked
        held = np.fmax(held, 1.0)
        self._usual = (UNEXPLAINED_RATIO * held) ** 2

    def gain(
        self, columns: np.ndarray, now: np.ndarray, without: np.ndarray, relief: float
    ) -> LeftOutGain:
        """Return the gain of an effect with columns (m, k) from weighted residuals (m,).

        Nominal values that would leave their tolerances without it (`relief`, squares over their
        priors) count like squares that it removes.
        """
        comparison, rows = self._comparison, self._comparison.rows.channel
        fall = without**2 - now**2
        square = np.bincount(rows, np.sum(columns**2, axis=1))
        acted = square > MIN_ACTIVE_SHARE * square.max()
        channel = int(np.argmax(np.where(acted, np.bincount(rows, fall), -np.inf)))
        own, noise = self._kept & (rows == channel), float(comparison.inflation[channel])
        after, before = (noise**2 * float(np.sum(left[own] ** 2)) for left in (now, without))
        falls = np.bincount(self._stretch, fall * acted[rows])
        count = int(own.sum())
        beyond = before - count
        return LeftOutGain(
            removed=max(before - after + relief, 0.0),
            left_open=max(
                _smooth_squares(comparison, now * noise, own),
                after - float(self._usual[channel]) * count,
            ),
            share=float(np.clip(1.0 - after / before, 0.0, 1.0)) if before > 0.0 else 0.0,
            explained=float(np.clip((before - after) / beyond, 0.0, 1.0)) if beyond > 0.0 else 0.0,
            channel=channel,
            support=_probability_of_gain(falls + relief / len(falls)),
        )


def select_predictive(
    comparison: Comparison,
    effects: Sequence[LocatedEffect],
) -> list[LocatedEffect]:
    """Select effects without which folds left out are predicted worse.

    `comparison`: with the noise estimated beside the effects. `effects`: with shapes as found,
    which are not refitted.

    Effects that cancel others are removed first, then the least helpful one repeatedly, each judged
    by a fit without it. Calibrated values stay.
    """
    kept = drop_cancelling(comparison, effects)
    while True:
        excess = [
            0.0 if each.calibrated else _excess_share(comparison, each, gain)
            for each, gain in zip(kept, left_out_gains(comparison, kept), strict=True)
        ]
        poor = [k for k in np.argsort(excess) if excess[k] < 0.0]
        if not poor:
            return kept
        kept.pop(poor[0])


def drop_cancelling(
    comparison: Comparison, effects: Sequence[LocatedEffect]
) -> list[LocatedEffect]:
    """Remove effects whose contribution far exceeds the nominal residual of their channel.

    Two nearly collinear formulas fit best as a difference of large values, which has no meaning
    and extrapolates badly.
    """
    kept, rows = list(effects), comparison.rows.channel
    before = np.bincount(rows, comparison.target**2)
    while kept:
        amplitudes, begin, ratios = comparison.fit(kept).amplitudes(), 0, []
        for located in kept:
            columns = comparison.effect_columns(located)
            end = begin + columns.shape[1]
            square = np.bincount(rows, (columns @ amplitudes[begin:end]) ** 2)
            own, begin = int(np.argmax(square)), end
            seen = before[own] > 0.0 and not located.calibrated
            ratios.append(float(square[own] / before[own]) if seen else 0.0)
        worst = int(np.argmax(ratios))
        if ratios[worst] <= MAX_CANCELLATION_RATIO**2:
            break
        kept.pop(worst)
    return kept


def _excess_share(comparison: Comparison, located: LocatedEffect, gain: LeftOutGain) -> float:
    """Return the share that an effect removes less the required one; negative without support.

    An effect that removes less than laws leave open in its channel is one of many that would: it
    is never named, and predicts no better for being fitted. With an extended model a change must
    exceed the open residual of its recordings.
    """
    changed = comparison.after_model and not comparison.unseen[gain.channel]
    # Friction and other values that every joint has only need to help on the whole.
    plain = bool(located.effect.nominal) and not changed
    if not plain and gain.support < FOUND_PROBABILITY and gain.share < RARE_SHARE:
        return gain.support - 1.0
    if not plain and not changed and gain.open_share > 1.0 - NAMED_PROBABILITY:
        return 1.0 - NAMED_PROBABILITY - gain.open_share
    required = MIN_CHANGE_SHARE if changed else 0.0 if plain else MIN_HELD_OUT_SHARE
    return gain.share - required if gain.removed > 0.0 else -1.0


def _smooth_squares(comparison: Comparison, residual: np.ndarray, own: np.ndarray) -> float:
    """Return the squares of a residual (m,) in some rows that neighbouring rows share.

    Filtered noise is correlated as far as the filter makes it; what is correlated beyond that is no
    noise. Expected value, since the correlation of noise differs from zero by chance.
    """
    time = comparison.rows.sample_signal(lambda each: each.time)
    shared, square, white = 0.0, 0.0, 0.0
    for number, run in enumerate(comparison.runs):
        rows = own & (comparison.rows.run == number)
        left, gaps = residual[rows], np.diff(time[rows])
        if len(left) < 2:
            continue
        beside, white = gaps < 1.5 * gaps.min(), run.low_pass.row_correlation
        shared += float(np.sum((left[1:] * left[:-1])[beside])) / float(np.mean(beside))
        shared -= white * float(left @ left)
        square += float(left @ left)
    chance = square * float(own.sum()) ** -0.5
    if chance == 0.0:
        return 0.0
    ratio = shared / chance
    density = float(np.exp(-0.5 * ratio**2)) / np.sqrt(2.0 * np.pi)
    return float((shared * special.ndtr(ratio) + chance * density) / (1.0 - white))


def _probability_of_gain(falls: np.ndarray) -> float:
    """Return the probability that the mean of falls of squares (b,) is above zero."""
    spread = float(falls.std(ddof=1)) if len(falls) > 1 else 0.0
    if spread == 0.0:
        return 0.5 if falls.sum() <= 0.0 else 1.0
    return float(special.stdtr(len(falls) - 1, falls.mean() / spread * np.sqrt(len(falls))))
