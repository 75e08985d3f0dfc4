"""Linear Gaussian model of the rows: log evidence, cross-validated density, posterior.

The predictive density of a block given the others is the ratio of two evidences: cross-validation
over recordings needs only the sums of products of each block.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

# Least information of the data on a direction of parameters, over the most on any: less is
# rounding.
_MIN_KNOWN_SHARE = 1e-9


@dataclass(frozen=True, eq=False)
class Posterior:
    """Gaussian posterior of the parameters."""

    mean: np.ndarray  # (p,)
    covariance: np.ndarray  # (p, p)
    log_evidence: float  # of all rows, up to a constant of the data
    # (b,) log density of every block given the other blocks, same constant; empty if not computed.
    by_block: np.ndarray

    @property
    def log_predictive(self) -> float:
        """Log density of all blocks, each given the others."""
        return float(np.sum(self.by_block))


class BlockSums:
    """Sums of products of rows: gram (b, p, p), moment (b, p) and square (b,) of every block.

    Of columns (m, p) and target (m,), whose blocks (m,) are numbered from 0.
    """

    def __init__(
        self, columns: np.ndarray, target: np.ndarray, block: np.ndarray, blocks: int
    ) -> None:
        order = np.argsort(block, kind="stable")
        edges = np.searchsorted(block[order], np.arange(blocks + 1))
        self._order = order
        self._parts = [slice(first, last) for first, last in pairwise(edges)]
        ordered, left = columns[order], target[order]
        self._transposed = [ordered[part].T.copy() for part in self._parts]
        self._target = [left[part] for part in self._parts]
        self.gram = np.array([c @ c.T for c in self._transposed])
        self.moment = np.array([c @ y for c, y in zip(self._transposed, self._target, strict=True)])
        self.square = np.array([float(y @ y) for y in self._target])

    def added_sums(self, added: np.ndarray) -> AddedSums:
        """Return the sums of further columns (m, k) with these."""
        ordered = added[self._order]
        new = [ordered[part] for part in self._parts]
        return AddedSums(
            np.array([c @ own for c, own in zip(self._transposed, new, strict=True)]),
            np.array([own.T @ own for own in new]),
            np.array([own.T @ y for own, y in zip(new, self._target, strict=True)]),
            np.arange(len(new)),
            len(new),
        )

    @property
    def own(self) -> Sums:
        """Sums without further columns."""
        return Sums(self.gram, self.moment, self.square)


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums of products by block: gram (b, p, p), moment (b, p), square (b,)."""

    gram: np.ndarray
    moment: np.ndarray
    square: np.ndarray


class AddedSums:
    """Sums of products of further columns, by parts of the rows on which they act.

    `cross` (a, p, k): with the columns that they are added to. `inner` (a, k, k). `moment` (a, k):
    with the target. `block` (a,) of int: block of each part.
    """

    def __init__(
        self,
        cross: np.ndarray,
        inner: np.ndarray,
        moment: np.ndarray,
        block: np.ndarray,
        blocks: int,
    ) -> None:
        self._parts, self._block, self._blocks = (cross, inner, moment), block, blocks

    @cached_property
    def total(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cross (p, k), inner (k, k) and moment (k,) of all rows."""
        cross, inner, moment = (part.sum(axis=0) for part in self._parts)
        return cross, inner, moment

    @cached_property
    def by_block(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cross, inner and moment of every block, (b, ...) each."""
        cross, inner, moment = (sum_by_block(x, self._block, self._blocks) for x in self._parts)
        return cross, inner, moment


def sum_by_block(parts: np.ndarray, block: np.ndarray, blocks: int) -> np.ndarray:
    """Return sums (b, ...) of parts (a, ...) by their blocks (a,)."""
    found = np.zeros((blocks, *parts.shape[1:]))
    # Parts are large and few: one addition per part is faster than a scatter of all entries.
    for part, own in zip(parts, block.tolist(), strict=True):
        found[own] += part
    return found


@dataclass(frozen=True, eq=False)
class AddedPosterior:
    """Posterior of parameters added to others."""

    mean: np.ndarray  # (k,)
    # covariance, precision (k, k)
    covariance: np.ndarray
    precision: np.ndarray
    log_evidence: float  # log evidence with all parameters, as of a `Posterior`
    base: Callable[[], np.ndarray]  # -> posterior mean (p,) of the other parameters

    def log_likelihood_at(self, values: np.ndarray) -> float:
        """Gain of the log likelihood by given values (k,) over zeros."""
        own = self.precision - np.eye(len(values))
        return float(values @ (self.precision @ self.mean - 0.5 * own @ values))


class AddedColumnsPosterior:
    """Posteriors with a few more parameters of unit prior, at the cost of those alone.

    `sums`: sums without them. `prior_sd` (p,).
    """

    def __init__(self, sums: Sums, prior_sd: np.ndarray) -> None:
        self._sums, self._prior = sums, prior_sd
        self._factored_whole = _FactoredSums(
            _sum_blocks(sums.gram), _sum_blocks(sums.moment), _sum_blocks(sums.square), prior_sd
        )

    @cached_property
    def _factored_without_block(self) -> _FactoredSums:
        """Factored sums of all blocks but each one."""
        own = self._sums
        gram, moment, square = (_sum_blocks(x) - x for x in (own.gram, own.moment, own.square))
        return _FactoredSums(gram, moment, square, self._prior)

    def added(self, sums: AddedSums, kept: np.ndarray) -> AddedPosterior:
        """Return the posterior with some of the further columns."""
        cross, inner, moment = sums.total
        if len(kept) < len(moment):
            cross, inner, moment = cross[:, kept], inner[kept][:, kept], moment[kept]
        return self._factored_whole.with_few(cross, inner, moment)

    def log_predictive(self, sums: AddedSums, kept: np.ndarray) -> float:
        """Return the log density of all blocks, each given the others, as of a `Posterior`."""
        all_cross, all_inner, all_moment = sums.by_block
        parts = (all_cross[:, :, kept], all_inner[:, kept][:, :, kept], all_moment[:, kept])
        cross, inner, moment = (_sum_blocks(x) - x for x in parts)
        without = self._factored_without_block.with_columns(cross, inner, moment)
        return float(np.sum(self.added(sums, kept).log_evidence - without))


class _FactoredSums:
    """Factored sums of several sets of blocks: gram (c, p, p), moment (c, p), square (c,)."""

    def __init__(
        self, gram: np.ndarray, moment: np.ndarray, square: np.ndarray, prior_sd: np.ndarray
    ) -> None:
        self._prior = prior_sd
        scaled = gram * np.outer(prior_sd, prior_sd) + np.eye(len(prior_sd))
        factor = np.linalg.cholesky(scaled)
        self._inverse = np.linalg.inv(factor)
        self._half_mean = np.einsum("bij,bj->bi", self._inverse, prior_sd * moment)
        log_size = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        self._log_evidence = 0.5 * (np.sum(self._half_mean**2, axis=1) - square) - log_size

    def with_few(self, cross: np.ndarray, inner: np.ndarray, moment: np.ndarray) -> AddedPosterior:
        """Return the posterior of further columns (p, k), (k, k), (k,) with the first set."""
        half = self._inverse[0] @ (cross * self._prior[:, None])
        precision = inner - half.T @ half
        # The remainder is not negative, although rounding of a difference of large numbers may be.
        diagonal = slice(None, None, len(moment) + 1)
        precision.flat[diagonal] = np.maximum(precision.flat[diagonal], 0.0) + 1.0
        goal = moment - self._half_mean[0] @ half
        if len(moment) == 1:
            covariance = 1.0 / precision
            log_size = math.log(precision[0, 0])
        else:
            covariance = np.linalg.inv(precision)
            log_size = float(np.linalg.slogdet(precision)[1])
        mean = covariance @ goal
        evidence = float(self._log_evidence[0]) + 0.5 * float(goal @ mean) - 0.5 * log_size

        def base() -> np.ndarray:
            rest = self._half_mean[0] - half @ mean
            return np.asarray(self._prior * (self._inverse[0].T @ rest))

        return AddedPosterior(mean, covariance, precision, evidence, base)

    def with_columns(self, cross: np.ndarray, inner: np.ndarray, moment: np.ndarray) -> np.ndarray:
        """Return the log evidence (c,) with further columns."""
        half = self._inverse @ (cross * self._prior[:, None])
        left = inner + np.eye(inner.shape[1]) - half.swapaxes(1, 2) @ half
        goal = moment - np.einsum("bpk,bp->bk", half, self._half_mean)
        mean = np.linalg.solve(left, goal[..., None])[..., 0]
        gained = 0.5 * np.sum(goal * mean, axis=1) - 0.5 * np.linalg.slogdet(left)[1]
        return np.asarray(self._log_evidence + gained)


def _sum_blocks(parts: np.ndarray) -> np.ndarray:
    """Return the sum of all blocks with a leading axis of one."""
    return np.asarray(parts.sum(axis=0, keepdims=True))


def savage_dickey(mean: np.ndarray, covariance: np.ndarray) -> float:
    """Return the log evidence for parameters (k,) of unit prior, by the Savage-Dickey ratio.

    Posterior over prior density at zero, from the posterior mean (k,) and covariance (k, k).
    """
    chi = float(mean @ np.linalg.solve(covariance, mean))
    return 0.5 * (chi + float(np.linalg.slogdet(covariance)[1]))


def log_likelihood_gain(mean: np.ndarray, covariance: np.ndarray) -> float:
    """Return the gain of the log likelihood by parameters (k,) at their best, whatever their prior.

    From the posterior mean (k,) and covariance (k, k) under unit priors.
    """
    precision = np.linalg.inv(covariance)
    known, axes = np.linalg.eigh(precision - np.eye(len(precision)))
    moment = axes.T @ precision @ mean
    seen = known > _MIN_KNOWN_SHARE * max(float(known.max()), 1.0)
    return 0.5 * float(np.sum(moment[seen] ** 2 / known[seen]))


def posterior(sums: Sums, prior_sd: np.ndarray, *, cross_validate: bool = True) -> Posterior:
    """Return the posterior under independent zero-mean priors.

    `sums`: sums of rows with unit noise. `prior_sd` (p,).
    """
    gram, moment = sums.gram.sum(axis=0), sums.moment.sum(axis=0)
    square = float(sums.square.sum())
    evidence, mean, covariance = _log_evidence_and_moments(gram, moment, square, prior_sd)
    predictive = []
    if cross_validate:
        for g, m, s in zip(sums.gram, sums.moment, sums.square, strict=True):
            without, _, _ = _log_evidence_and_moments(gram - g, moment - m, square - s, prior_sd)
            predictive.append(evidence - without)
    return Posterior(mean, covariance, evidence, np.array(predictive))


def _log_evidence_and_moments(
    gram: np.ndarray, moment: np.ndarray, square: float, prior_sd: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return log evidence, mean and covariance, scaled by the priors."""
    scaled = gram * np.outer(prior_sd, prior_sd) + np.eye(len(prior_sd))
    factor = np.linalg.cholesky(scaled)
    inverse = np.linalg.inv(factor)
    half = inverse @ (prior_sd * moment)
    evidence = 0.5 * (float(half @ half) - square) - float(np.log(np.diag(factor)).sum())
    root = inverse * prior_sd
    return evidence, root.T @ half, root.T @ root
