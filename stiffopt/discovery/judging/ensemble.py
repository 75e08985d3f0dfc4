"""Perturbation ensemble: how often a finding comes again when data and model are perturbed.

The evidence of one fit takes its formulas for nature's. A finding that rests on a few seconds, on
the start of the runs, on one band or on the nominal masses does not come again in fits that lack
these. The probability of every finding is multiplied by the share of the members that name it
again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.inertial_parameters import body_units
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.search.cross_validation import number_folds
from stiffopt.discovery.search.rigid_model import PRIOR_WIDTHS
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.thresholds import MIN_ACTIVE_SHARE, NAMED_EVIDENCE

# Shares of each run's start that members leave out: filters, contacts and warm-up act there.
START_CUTS = (0.03, 0.05, 0.10)
# Share of a finding's evidence, or of the required one if that is less, in proportion to the rows
# of a member, with which it is named again: evidence of equal stretches differs by about as much.
MIN_EVIDENCE_KEPT = 0.5
# Prior standard deviation of inertial parameters over their typical sizes in the member with free
# masses: the second widest of the re-identification.
FREE_WIDTH = PRIOR_WIDTHS[-2]


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
        True where no tolerance of masses is stated, so that a member frees them.

    Notes
    -----
    A member names a finding again if the evidence for it, beside the other findings, reaches half
    of the one required of all data in proportion to its rows, its main amplitude keeps its sign,
    and no rival in its place has more evidence. Members in which an effect does not act are not
    counted for it. A drift between runs is named only if it is named again without each single run:
    one odd run is no drift.
    """
    named, counted = np.zeros(len(selected)), np.zeros(len(selected))
    for member, kept in _members(comparison, half_band, free_bodies=free_bodies):
        again, acts = _named_in(member, selected, kept)
        named += again & acts
        counted += acts
    share = np.where(counted > 0, named / np.maximum(counted, 1), 1.0)
    drifts = np.array([each.located.effect.of_runs is not None for each in selected])
    if drifts.any():
        number = comparison.rows.sample_signal(lambda run: np.full(len(run.time), run.index))
        for left_out in np.unique(number):
            again, acts = _named_in(comparison, selected, number != left_out)
            share = np.where(drifts & acts & ~again, 0.0, share)
    return share


def _members(
    comparison: Comparison, half_band: Comparison | None, *, free_bodies: bool
) -> Iterator[tuple[Comparison, np.ndarray]]:
    """Yield comparisons with masks (m,) of the rows that each member keeps."""
    fold = number_folds(comparison)
    for left_out in range(int(fold.max()) + 1):
        yield comparison, fold != left_out

    def progress(run: PreparedRun) -> np.ndarray:
        return np.asarray((run.time - run.time[0]) / float(run.time[-1] - run.time[0]))

    share = comparison.rows.sample_signal(progress)
    for cut in START_CUTS:
        yield comparison, share >= cut
    if half_band is not None:
        yield half_band, np.ones(half_band.rows.size, dtype=bool)
    if free_bodies:
        freed = comparison.with_bodies(FREE_WIDTH * body_units(comparison.robot))
        yield freed, np.ones(comparison.rows.size, dtype=bool)


def _named_in(
    member: Comparison, selected: Sequence[Selected], kept: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return masks (e,) of the findings that a member names again, and that act in it."""
    effects = [each.located for each in selected]
    parts = [member.effect_columns(each) for each in effects]
    share = float(np.mean(kept))
    _, sd, nuisance = member.nuisance
    own = np.column_stack([nuisance, *parts])[kept]
    target = member.target[kept]
    gram, moment = own.T @ own, own.T @ target
    prior = np.concatenate([sd, np.ones(own.shape[1] - len(sd))])
    owner = np.repeat(np.arange(-1, len(parts)), [len(sd), *(p.shape[1] for p in parts)])
    again = np.zeros(len(parts), dtype=bool)
    acts = np.zeros(len(parts), dtype=bool)
    mean, covariance = _fit(gram, moment, prior)
    signs = member.fit(effects).amplitudes()
    for k, (each, part) in enumerate(zip(selected, parts, strict=True)):
        square = float(np.sum(part**2))
        acts[k] = np.sum(part[kept] ** 2) > MIN_ACTIVE_SHARE * square
        rows = np.flatnonzero(owner == k)
        gained = _evidence(mean, covariance, rows)
        main = rows[int(np.argmax(np.abs(mean[rows]) / np.sqrt(np.diag(covariance)[rows])))]
        # Deviations of runs are about the mean of the runs that are left: their signs may change.
        drifts = each.located.effect.of_runs is not None
        same_sign = drifts or mean[main] * signs[main - len(sd)] > 0.0
        others = owner != k
        ahead = any(
            _evidence_in_place(gram, moment, prior, own, target, others, member, rival, kept)
            > gained
            for rival, _ in each.rivals
        )
        asked = MIN_EVIDENCE_KEPT * share * min(NAMED_EVIDENCE, each.loss)
        again[k] = gained >= asked and same_sign and not ahead
    return again, acts


def _fit(gram: np.ndarray, moment: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return posterior mean (p,) and covariance (p, p)."""
    scaled = gram * np.outer(prior, prior) + np.eye(len(prior))
    covariance = np.linalg.inv(scaled) * np.outer(prior, prior)
    return covariance @ moment, covariance


def _evidence(mean: np.ndarray, covariance: np.ndarray, rows: np.ndarray) -> float:
    """Return the log evidence for parameters of unit prior: the Savage-Dickey ratio."""
    own = covariance[np.ix_(rows, rows)]
    chi = float(mean[rows] @ np.linalg.solve(own, mean[rows]))
    return 0.5 * (chi + float(np.linalg.slogdet(own)[1]))


def _evidence_in_place(
    gram: np.ndarray,
    moment: np.ndarray,
    prior: np.ndarray,
    own: np.ndarray,
    target: np.ndarray,
    others: np.ndarray,
    member: Comparison,
    rival: LocatedEffect,
    kept: np.ndarray,
) -> float:
    """Return the log evidence for a rival beside the other columns."""
    added = member.effect_columns(rival)[kept]
    cross = own[:, others].T @ added
    whole = np.block([[gram[np.ix_(others, others)], cross], [cross.T, added.T @ added]])
    goal = np.concatenate([moment[others], added.T @ target])
    mean, covariance = _fit(whole, goal, np.concatenate([prior[others], np.ones(added.shape[1])]))
    return _evidence(mean, covariance, np.arange(int(others.sum()), len(goal)))
