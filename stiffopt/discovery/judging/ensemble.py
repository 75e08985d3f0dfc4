"""Perturbation ensemble: how often a finding comes again when data and model are perturbed.

The evidence of one fit takes its formulas for nature's. A finding that rests on a few seconds, on
the start of the runs, on one band or on the nominal masses does not come again in fits that lack
these. The probability of every finding, and of its rivals, is multiplied by the share of the
members that name it again; the odds among them are the mean of those of the members. Stretches,
starts, band and masses have equal weight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from stiffopt.discovery.comparison.channel_rows import elapsed_shares
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.evidence import (
    BlockSums,
    Posterior,
    log_likelihood_gain,
    posterior,
    savage_dickey,
)
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search.cross_validation import number_folds, stack_columns
from stiffopt.discovery.search.rigid_model import PRIOR_WIDTHS, common_deviations
from stiffopt.discovery.search.rivals import Selected, tempering_width
from stiffopt.discovery.thresholds import MIN_ACTIVE_SHARE, NAMED_EVIDENCE

# Shares of each run's start that members leave out: filters, contacts and warm-up act there.
START_CUTS = (0.03, 0.05, 0.10)
# Prior standard deviations of inertial parameters over their typical sizes in the members with free
# masses: the two widest of the re-identification.
FREE_WIDTHS = PRIOR_WIDTHS[-2:]
# Probability below which rounding made it zero.
_LEAST_ODDS = float(np.finfo(float).tiny)


def recurrence(
    comparison: Comparison,
    selected: Sequence[Selected],
    half_band: Comparison | None,
    *,
    free_bodies: bool,
) -> tuple[np.ndarray, tuple[Selected, ...]]:
    """Return the share (e,) of members that name each finding again, and findings with mean odds.

    `comparison`: with the noise estimated beside the findings. `selected`: findings with their
    rivals. `half_band`: the same runs in half the band. `free_bodies`: True where no tolerance of
    masses is stated, so that members free them.

    A member names a finding again as far as the evidence for it, beside the other findings, reaches
    the one required of all data in proportion to its rows, if its main amplitude keeps its sign. A
    rival that gains on it takes its probability, not that of the two together: one of them
    is there. Members in which an effect does not act are not counted for it. A drift between runs
    is named only as far as it is without each single run: one odd run is no drift.
    """
    signs = np.sign(comparison.fit([each.located for each in selected]).amplitudes())
    own = _Member(comparison, selected, signs, len(comparison.target))
    kinds = [[own.judge(kept) for kept in kind] for kind in _kept_rows(comparison)]
    for others in _other_members(comparison, half_band, free_bodies=free_bodies):
        kinds.append([_Member(other, selected, signs, own.count).judge() for other in others])
    share = _mean_by_kind([[(m.again, m.acts) for m in kind] for kind in kinds])
    ranked, odds = own.judge().leads, []
    for k, (each, before) in enumerate(zip(selected, ranked, strict=True)):
        own_odds = [
            [(odds_in_member(each, m.leads[k], before), m.acts[k]) for m in kind] for kind in kinds
        ]
        odds.append(_mean_by_kind(own_odds))
    drifts = np.array([each.located.effect.of_runs is not None for each in selected])
    if drifts.any():
        number = comparison.rows.run
        for left_out in np.unique(number):
            member = own.judge(number != left_out, rivals=False)
            share = np.where(drifts & member.acts, np.minimum(share, member.again), share)
    return np.nan_to_num(share, nan=1.0), tuple(map(_with_odds, selected, odds))


def _with_odds(selected: Selected, odds: np.ndarray) -> Selected:
    """Return a finding with probabilities (1 + r,) of its own and of its rivals, where known."""
    if not np.isfinite(odds).all():
        return selected
    itself, *theirs = map(float, odds)
    rivals = tuple((located, p) for (located, _), p in zip(selected.rivals, theirs, strict=True))
    return replace(selected, probability=itself, rivals=rivals)


def _mean_by_kind(
    kinds: Sequence[Sequence[tuple[np.ndarray, np.ndarray | np.bool_]]],
) -> np.ndarray:
    """Return the mean of values of members that count, every kind of equal weight; nan of none.

    A finding that rests on one kind of assumption does not become surer by many members of others.
    """
    means = []
    for kind in kinds:
        total = sum(np.where(counts, value, 0.0) for value, counts in kind)
        counted = sum(np.asarray(counts, dtype=float) for _, counts in kind)
        means.append(np.where(counted > 0, total / np.maximum(counted, 1), np.nan))
    known = np.isfinite(means)
    return np.where(
        known.any(axis=0), np.nansum(means, axis=0) / np.maximum(known.sum(axis=0), 1), np.nan
    )


def _kept_rows(comparison: Comparison) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return masks (m,) of the rows that are left without a stretch, and without starts of runs."""
    fold = number_folds(comparison)

    share = comparison.rows.sample_signal(lambda run: elapsed_shares(run.time))
    return (
        [fold != left_out for left_out in range(int(fold.max()) + 1)],
        [share >= cut for cut in START_CUTS],
    )


def _other_members(
    comparison: Comparison, half_band: Comparison | None, *, free_bodies: bool
) -> Iterator[Iterator[Comparison]]:
    """Yield the comparisons in half the band, and those with free masses, where there are any."""
    if half_band is not None:
        yield iter([half_band])
    if free_bodies:
        freed = (common_deviations(comparison, width) for width in FREE_WIDTHS)
        yield map(comparison.with_bodies, freed)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Judgement:
    """Judgement of a member on the findings."""

    again: np.ndarray  # (e,) how far each is named again, 0 to 1
    acts: np.ndarray  # (e,) of bool: findings that act in its rows
    # (1 + r,) log evidence for each finding, and the leads of its rivals over it in its place;
    # empty where not asked for.
    leads: Sequence[np.ndarray]


class _Member:
    """Columns of the findings and of their rivals in one comparison.

    `signs` (p,): of the amplitudes as found. `count`: rows of the comparison that they were found
    in.
    """

    def __init__(
        self, comparison: Comparison, selected: Sequence[Selected], signs: np.ndarray, count: int
    ) -> None:
        self.count = count
        located = [each.located for each in selected]
        self._selected, self._signs, self._target = selected, signs, comparison.target
        self._columns, self._prior, self._owner = stack_columns(comparison, located)
        self._rivals = [
            [comparison.effect_columns(rival) for rival, _ in each.rivals] for each in selected
        ]

    def judge(self, kept: np.ndarray | None = None, *, rivals: bool = True) -> _Judgement:
        """Return how far findings are named again, and the leads of their rivals if asked.

        `kept` (m,) of bool: rows that are fitted; default all.
        """
        if kept is None:
            kept = np.ones(len(self._target), dtype=bool)
        columns, target = self._columns[kept], self._target[kept]
        found = _fit(columns, target, self._prior)
        share = len(target) / self.count
        first = int(np.sum(self._owner < 0))
        again = np.zeros(len(self._selected))
        acts = np.zeros(len(self._selected), dtype=bool)
        leads = []
        for k, each in enumerate(self._selected):
            rows = np.flatnonzero(self._owner == k)
            square = float(np.sum(self._columns[:, rows] ** 2))
            acts[k] = np.sum(columns[:, rows] ** 2) > MIN_ACTIVE_SHARE * square
            mean, covariance = found.mean[rows], found.covariance[np.ix_(rows, rows)]
            gained = savage_dickey(mean, covariance)
            main = int(np.argmax(np.abs(mean) / np.sqrt(np.diag(covariance))))
            # Deviations of runs are about the mean of the runs left: their signs may change.
            drifts = each.located.effect.of_runs is not None
            same_sign = drifts or mean[main] * self._signs[rows[main] - first] > 0.0
            # A value that every arm has is kept without evidence too: then any is enough.
            asked = share * np.clip(each.loss, 0.0, NAMED_EVIDENCE)
            again[k] = same_sign * np.interp(gained, [0.0, asked], [0.0, 1.0])
            if rivals:
                ahead = [
                    self._lead(k, located, rival, kept, mean, covariance)
                    for (located, _), rival in zip(each.rivals, self._rivals[k], strict=True)
                ]
                leads.append(np.array([gained, *ahead]))
        return _Judgement(again=again, acts=acts, leads=leads)

    def _lead(
        self,
        k: int,
        located: LocatedEffect,
        columns: np.ndarray,
        kept: np.ndarray,
        mean: np.ndarray,
        covariance: np.ndarray,
    ) -> float:
        """Return the lead of a rival with some columns in place of a finding."""
        others = self._owner != k
        beside = np.column_stack([self._columns[:, others], columns])[kept]
        prior = np.concatenate([self._prior[others], np.ones(columns.shape[1])])
        found = _fit(beside, self._target[kept], prior)
        rows = slice(int(others.sum()), None)
        twin = located.effect.is_twin(self._selected[k].located.effect)
        measure = log_likelihood_gain if twin else savage_dickey
        return measure(found.mean[rows], found.covariance[rows, rows]) - measure(mean, covariance)


def odds_in_member(selected: Selected, leads: np.ndarray, ranked: np.ndarray) -> np.ndarray:
    """Return probabilities (1 + r,) of a finding and of its rivals in a member.

    `selected`: with the odds of the ranking. `leads`, `ranked` (1 + r,): log evidence for the
    finding and leads of the rivals, in the member and in the comparison of the ranking. Leads grow
    with the evidence, and count beyond that.
    """
    kept = np.clip(leads[0] / max(ranked[0], 1.0), 0.0, 1.0)
    gains = (leads[1:] - kept * ranked[1:]) / tempering_width(leads[0])
    known = np.array([selected.probability, *(p for _, p in selected.rivals)])
    return np.asarray(softmax(np.log(np.fmax(known, _LEAST_ODDS)) + np.append(0.0, gains)))


def _fit(columns: np.ndarray, target: np.ndarray, prior: np.ndarray) -> Posterior:
    """Return the posterior of all columns from all rows."""
    rows = np.zeros(len(target), dtype=int)
    return posterior(BlockSums(columns, target, rows, 1).own, prior, cross_validate=False)
