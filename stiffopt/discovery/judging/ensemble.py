"""Perturbation ensemble: how often a finding comes again when data and model are perturbed.

The evidence of one fit takes its formulas for nature's. A finding that rests on a few seconds, on
the start of the runs, on one band or on the nominal masses does not come again in fits that lack
these. The probability of every finding is multiplied by the share of the members that name it
again, stretches, starts, band and masses of equal weight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.evidence import (
    BlockSums,
    Posterior,
    log_likelihood_gain,
    posterior,
    savage_dickey,
)
from stiffopt.discovery.comparison.inertial_parameters import body_units
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.search.cross_validation import number_folds, stack_columns
from stiffopt.discovery.search.rigid_model import PRIOR_WIDTHS
from stiffopt.discovery.search.rivals import Selected, tempering_width
from stiffopt.discovery.thresholds import MIN_ACTIVE_SHARE, NAMED_EVIDENCE, RIVAL_LOG_ODDS

# Shares of each run's start that members leave out: filters, contacts and warm-up act there.
START_CUTS = (0.03, 0.05, 0.10)
# Share of a finding's evidence, or of the required one if that is less, in proportion to the rows
# of a member, with which it is named again: evidence of equal stretches differs by about as much.
MIN_EVIDENCE_KEPT = 0.5
# Prior standard deviations of inertial parameters over their typical sizes in the members with free
# masses: the two widest of the re-identification.
FREE_WIDTHS = PRIOR_WIDTHS[-2:]


def recurrence(
    comparison: Comparison,
    selected: Sequence[Selected],
    half_band: Comparison | None,
    *,
    free_bodies: bool,
) -> np.ndarray:
    """Return the share (e,) of ensemble members in which each finding is named again.

    Parameters
    ----------
    comparison : Comparison
        With the noise estimated beside the findings.
    selected : sequence of Selected
        Findings with their rivals.
    half_band : Comparison or None
        The same runs in half the band.
    free_bodies : bool
        True where no tolerance of masses is stated, so that members free them.

    Notes
    -----
    A member names a finding again if the evidence for it, beside the other findings, reaches half
    of the one required of all data in proportion to its rows, its main amplitude keeps its sign,
    and no rival in its place is so far ahead that the finding would be none of its rivals: smaller
    leads are in the odds among rivals already. Members in which an effect does not act are not
    counted for it. A drift between runs is named only if it is named again without each single run:
    one odd run is no drift.
    """
    signs = np.sign(comparison.fit([each.located for each in selected]).amplitudes())
    own = _Member(comparison, selected, signs)
    kinds = [[own.named_again(kept) for kept in kind] for kind in _kept_rows(comparison)]
    for others in _other_members(comparison, half_band, free_bodies=free_bodies):
        kinds.append([_Member(other, selected, signs).named_again() for other in others])
    share = _mean_share(kinds, len(selected))
    drifts = np.array([each.located.effect.of_runs is not None for each in selected])
    if drifts.any():
        number = comparison.rows.sample_signal(lambda run: np.full(len(run.time), run.index))
        for left_out in np.unique(number):
            again, acts = own.named_again(number != left_out)
            share = np.where(drifts & acts & ~again, 0.0, share)
    return share


def _mean_share(kinds: Sequence[Sequence[tuple[np.ndarray, np.ndarray]]], count: int) -> np.ndarray:
    """Return the share (e,) of members that name a finding again, every kind of equal weight.

    A finding that rests on one kind of assumption does not become surer by many members of others.
    """
    shares = []
    for kind in kinds:
        named = sum((again & acts for again, acts in kind), np.zeros(count))
        counted = sum((acts for _, acts in kind), np.zeros(count))
        shares.append(np.where(counted > 0, named / np.maximum(counted, 1), np.nan))
    known = np.isfinite(shares)
    return np.where(
        known.any(axis=0), np.nansum(shares, axis=0) / np.maximum(known.sum(axis=0), 1), 1.0
    )


def _kept_rows(comparison: Comparison) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return masks (m,) of the rows that are left without a stretch, and without starts of runs."""
    fold = number_folds(comparison)

    def progress(run: PreparedRun) -> np.ndarray:
        return np.asarray((run.time - run.time[0]) / float(run.time[-1] - run.time[0]))

    share = comparison.rows.sample_signal(progress)
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
        units = body_units(comparison.robot)
        yield (comparison.with_bodies(width * units) for width in FREE_WIDTHS)


class _Member:
    """Columns of the findings and of their rivals in one comparison.

    Parameters
    ----------
    comparison : Comparison
    selected : sequence of Selected
    signs : array (p,)
        Of the amplitudes as found.
    """

    def __init__(
        self, comparison: Comparison, selected: Sequence[Selected], signs: np.ndarray
    ) -> None:
        located = [each.located for each in selected]
        self._selected, self._signs, self._target = selected, signs, comparison.target
        self._columns, self._prior, self._owner = stack_columns(comparison, located)
        self._rivals = [
            [comparison.effect_columns(rival) for rival, _ in each.rivals] for each in selected
        ]

    def named_again(self, kept: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return masks (e,) of the findings that are named again, and that act.

        Parameters
        ----------
        kept : array (m,) of bool, optional
            Rows that are fitted; default all.
        """
        if kept is None:
            kept = np.ones(len(self._target), dtype=bool)
        columns, target = self._columns[kept], self._target[kept]
        found = _fit(columns, target, self._prior)
        share = float(np.mean(kept))
        first = int(np.sum(self._owner < 0))
        again = np.zeros(len(self._selected), dtype=bool)
        acts = np.zeros(len(self._selected), dtype=bool)
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
            asked = MIN_EVIDENCE_KEPT * share * min(NAMED_EVIDENCE, each.loss)
            ahead = self._rival_lead(k, kept, mean, covariance) / tempering_width(gained)
            again[k] = gained >= asked and same_sign and ahead <= RIVAL_LOG_ODDS
        return again, acts

    def _rival_lead(
        self, k: int, kept: np.ndarray, mean: np.ndarray, covariance: np.ndarray
    ) -> float:
        """Return the largest lead of a rival in place of a finding; -inf without one."""
        others, effect = self._owner != k, self._selected[k].located.effect
        best = -math.inf
        for (located, _), rival in zip(self._selected[k].rivals, self._rivals[k], strict=True):
            columns = np.column_stack([self._columns[:, others], rival])[kept]
            prior = np.concatenate([self._prior[others], np.ones(rival.shape[1])])
            found = _fit(columns, self._target[kept], prior)
            rows = slice(int(others.sum()), None)
            measure = log_likelihood_gain if located.effect.is_twin(effect) else savage_dickey
            best = max(
                best,
                measure(found.mean[rows], found.covariance[rows, rows]) - measure(mean, covariance),
            )
        return best


def _fit(columns: np.ndarray, target: np.ndarray, prior: np.ndarray) -> Posterior:
    """Return the posterior of all columns from all rows."""
    rows = np.zeros(len(target), dtype=int)
    return posterior(BlockSums(columns, target, rows, 1).own, prior, cross_validate=False)
