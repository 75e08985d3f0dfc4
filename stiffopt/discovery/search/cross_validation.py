"""Cross-validation of findings: refits without each, judged in recordings left out.

A search uses all training runs, and where a nominal model lacks many effects, some formula gains a
little everywhere. Findings must therefore improve recordings that they were not fitted to: whole
runs where there are several, else stretches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.design_matrix import MIN_RUNS_AS_BLOCKS
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.thresholds import (
    MAX_CANCELLATION_RATIO,
    MIN_ACTIVE_SHARE,
    MIN_CHANGE_SHARE,
    MIN_HELD_OUT_SHARE,
    MIN_HELPED_FOLDS,
    RARE_CHANGE_SHARE,
)

# Number of folds, over all runs, where runs are few; runs are cut as well if an effect acts in
# fewer folds than the second value.
_FOLDS_OF_FEW_RUNS, _MIN_ACTIVE_FOLDS = 6, 3


@dataclass(frozen=True, eq=False)
class _FoldSums:
    """Sums of squares of every fold and channel: gram (f, c, p, p), moment, square."""

    gram: np.ndarray
    moment: np.ndarray
    square: np.ndarray
    prior: np.ndarray

    def errors(self, kept: np.ndarray) -> np.ndarray:
        """Return squared errors (f, c) of each fold and channel by a fit to the other folds."""
        prior = self.prior[kept]
        whole = self.gram.sum(axis=(0, 1))[np.ix_(kept, kept)] + np.diag(prior**-2.0)
        goal = self.moment.sum(axis=(0, 1))[kept]
        out = np.empty(self.square.shape)
        for f in range(len(out)):
            gram, moment = self.gram[f][:, kept][:, :, kept], self.moment[f][:, kept]
            values = np.linalg.solve(whole - gram.sum(axis=0), goal - moment.sum(axis=0))
            out[f] = self.square[f] - 2.0 * moment @ values
            out[f] += np.einsum("cpq,p,q->c", gram, values, values)
        return out


def select_predictive(
    comparison: Comparison, effects: Sequence[LocatedEffect]
) -> list[LocatedEffect]:
    """Select effects without which recordings left out are predicted worse.

    Parameters
    ----------
    comparison : Comparison
        With the noise estimated beside the effects.
    effects : sequence of LocatedEffect
        With shapes as found, which are not refitted.

    Notes
    -----
    Effects that cancel others are removed first, then those whose shapes come from one fold only;
    then repeatedly the least helpful one, each judged by a fit without it. Effects of one run
    cannot be cross-validated and stay, as do calibrated values. With an extended model changes must
    exceed its open residual.
    """
    effects = _drop_single_fold_shapes(comparison, drop_cancelling(comparison, effects))
    if not effects:
        return []
    columns, prior, owner = stack_columns(comparison, effects)
    judged = [k for k, e in enumerate(effects) if e.run is None and not e.calibrated]
    new = {k: _is_unseen(comparison, columns[:, owner == k]) for k in judged}
    ways = [_Folds(comparison, columns, prior, fine=False)]
    chosen = dict.fromkeys(judged, ways[0])
    seldom = [
        k
        for k in judged
        if effects[k].is_run_specific
        or ways[0].acted(columns[:, owner == k]).sum() < _MIN_ACTIVE_FOLDS
    ]
    if seldom:
        # If each joint moves in a run of its own, only parts of that run can be left out.
        finer = _Folds(comparison, columns, prior, fine=True)
        chosen |= dict.fromkeys(seldom, finer)
        ways.append(finer)
    kept = set(range(len(effects)))
    while True:
        inside = np.isin(owner, [-1, *kept])
        errors = {id(way): way.sums.errors(np.flatnonzero(inside)) for way in ways}
        excess = {
            k: _excess_share(
                errors[id(chosen[k])],
                chosen[k].sums.errors(np.flatnonzero(inside & (owner != k))),
                acted=chosen[k].acted(columns[:, owner == k]),
                changed=comparison.after_model and not new[k],
                plain=bool(effects[k].effect.nominal) and (new[k] or not comparison.after_model),
            )
            for k in judged
            if k in kept
        }
        poorest = min(excess, key=lambda k: excess[k], default=None)
        if poorest is None or excess[poorest] >= 0.0:
            return [e for k, e in enumerate(effects) if k in kept]
        kept.remove(poorest)


def _drop_single_fold_shapes(
    comparison: Comparison, effects: Sequence[LocatedEffect]
) -> list[LocatedEffect]:
    """Remove effects with shapes that act in one fold only.

    Shapes come from all recordings and are not refitted per fold: those of a single event would
    seem to be reproduced.
    """
    fold = number_folds(comparison, _FOLDS_OF_FEW_RUNS)
    return [
        e
        for e in effects
        if not e.effect.shapes
        or e.run is not None
        or _active_folds(fold, comparison.effect_columns(e)).sum() > 1
    ]


def _is_unseen(comparison: Comparison, columns: np.ndarray) -> bool:
    """True if an effect acts most in a channel that the extended model has no recordings of."""
    square = np.bincount(comparison.rows.channel, np.sum(columns**2, axis=1))
    return bool(comparison.unseen[int(np.argmax(square))])


def drop_cancelling(
    comparison: Comparison, effects: Sequence[LocatedEffect]
) -> list[LocatedEffect]:
    """Remove effects whose contribution far exceeds the residual of their channel.

    Two nearly collinear formulas fit best as a difference of large values, which has no meaning
    and extrapolates badly.
    """
    kept = list(effects)
    while kept:
        ratio = _cancellation_ratios(comparison, kept)
        ratio[[e.calibrated for e in kept]] = 0.0
        worst = int(np.argmax(ratio))
        if ratio[worst] <= MAX_CANCELLATION_RATIO:
            break
        kept.pop(worst)
    return kept


def _cancellation_ratios(comparison: Comparison, effects: Sequence[LocatedEffect]) -> np.ndarray:
    """Return the contribution (e,) of each effect to its channel over the nominal residual."""
    amplitudes, channel = comparison.fit(effects).amplitudes(), comparison.rows.channel
    left = np.bincount(channel, comparison.target**2)
    found, begin = [], 0
    for located in effects:
        columns = comparison.effect_columns(located)
        added = columns @ amplitudes[begin : begin + columns.shape[1]]
        begin += columns.shape[1]
        square = np.bincount(channel, added**2)
        own = int(np.argmax(square))
        found.append(float(np.sqrt(square[own] / left[own])) if left[own] > 0.0 else 0.0)
    return np.array(found)


def stack_columns(
    comparison: Comparison, effects: Sequence[LocatedEffect]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return all columns, their priors, and the index of each column's effect (-1: nominal)."""
    _, sd = comparison.priors
    counts = [len(e.effect.amplitudes) for e in effects]
    owner = np.repeat(np.arange(-1, len(effects)), [len(sd), *counts])
    prior = np.concatenate([sd, np.ones(len(owner) - len(sd))])
    return comparison.stack_columns(effects), prior, owner


class CrossValidation:
    """Cross-validated squares of nominal values and effects.

    Parameters
    ----------
    comparison : Comparison
        With the noise that squares are divided by.
    effects : sequence of LocatedEffect
    """

    def __init__(self, comparison: Comparison, effects: Sequence[LocatedEffect]) -> None:
        self._comparison = comparison
        columns, prior, _ = stack_columns(comparison, effects)
        self._sums = _sum_folds(comparison, columns, prior, number_folds(comparison))

    def squares(self, first: np.ndarray) -> float:
        """Return the sum of squares over noise, with other priors of the first columns (k,)."""
        prior = np.concatenate([first, self._sums.prior[len(first) :]])
        sums = replace(self._sums, prior=prior)
        return float(sums.errors(np.arange(len(prior))).sum())

    def squares_by_channel(self) -> np.ndarray:
        """Return the sums of squares over noise of every channel (2 n,)."""
        found = np.zeros(2 * self._comparison.robot.n)
        errors = self._sums.errors(np.arange(len(self._sums.prior)))
        found[self._comparison.rows.channels] = errors.sum(axis=0)
        return found


class _Folds:
    """Sums of columns by folds: runs or parts of them."""

    def __init__(
        self, comparison: Comparison, columns: np.ndarray, prior: np.ndarray, *, fine: bool
    ) -> None:
        self._fold = number_folds(
            comparison, _FOLDS_OF_FEW_RUNS if fine else folds_per_run(len(comparison.runs))
        )
        self.sums = _sum_folds(comparison, columns, prior, self._fold)

    def acted(self, part: np.ndarray) -> np.ndarray:
        """See `_active_folds`."""
        return _active_folds(self._fold, part)


def _active_folds(fold: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return a mask (f,) of the folds in which an effect with columns (m, k) acts."""
    square = np.bincount(fold, np.sum(part**2, axis=1))
    return np.asarray(square > MIN_ACTIVE_SHARE * square.max())


def _excess_share(
    errors: np.ndarray,
    without: np.ndarray,
    *,
    acted: np.ndarray | None = None,
    plain: bool = False,
    changed: bool = False,
) -> float:
    """Return the share of its best channel's squares that an effect removes, less the required one.

    -1 if it helps in too few of the folds in which it acts, or in one only. A `plain` effect, such
    as friction, which every joint has, only needs to help on the whole.
    """
    falls = without - errors
    by_fold = falls.sum(axis=1)
    total = float(by_fold.sum())
    if total <= 0.0:
        return -1.0
    own = int(np.argmax(falls.sum(axis=0)))
    share = float(falls[:, own].sum() / without[:, own].sum())
    if plain:
        return share
    if acted is not None:
        by_fold = by_fold[acted]
        if not by_fold.size:
            return -1.0
    if changed:
        # Folds where it hardly acts, such as a stop that is seldom reached, do not count.
        by_fold = by_fold[np.abs(by_fold) > MIN_ACTIVE_SHARE * np.abs(by_fold).max()]
        if np.sum(by_fold > 0.0) < 2:
            return -1.0
    few = np.mean(by_fold > 0.0) < MIN_HELPED_FOLDS and not (changed and share > RARE_CHANGE_SHARE)
    if few or total <= float(by_fold.max()):
        return -1.0
    return share - (MIN_CHANGE_SHARE if changed else MIN_HELD_OUT_SHARE)


def _sum_folds(
    comparison: Comparison, columns: np.ndarray, prior: np.ndarray, fold: np.ndarray
) -> _FoldSums:
    channel = comparison.rows.channel
    count, p = int(fold.max()) + 1, columns.shape[1]
    channels = comparison.rows.channels
    gram = np.zeros((count, len(channels), p, p))
    moment, square = np.zeros((count, len(channels), p)), np.zeros((count, len(channels)))
    for f in range(count):
        for c, number in enumerate(channels):
            own = (fold == f) & (channel == number)
            part, left = columns[own], comparison.target[own]
            gram[f, c], moment[f, c], square[f, c] = part.T @ part, part.T @ left, left @ left
    return _FoldSums(gram, moment, square, prior)


def folds_per_run(runs: int) -> int:
    """Return the number of folds that each run is cut into."""
    return 1 if runs >= 2 * MIN_RUNS_AS_BLOCKS else -(-_FOLDS_OF_FEW_RUNS // runs)


def number_folds(comparison: Comparison, parts: int | None = None) -> np.ndarray:
    """Return the fold number of every row (m,): runs, or parts of runs in time."""
    runs = comparison.runs
    cut = folds_per_run(len(runs)) if parts is None else parts

    def number(run: PreparedRun) -> np.ndarray:
        share = (run.time - run.time[0]) / float(run.time[-1] - run.time[0])
        return np.asarray(runs.index(run) * cut + np.minimum((share * cut).astype(int), cut - 1))

    return np.unique(comparison.rows.sample_signal(number), return_inverse=True)[1]
