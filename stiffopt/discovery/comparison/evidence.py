"""Linear Gaussian model of the rows: evidence, cross-validated density, posterior.

The predictive density of a block given the others is the ratio of two evidences, so that
cross-validation over whole recordings needs no fit beyond the sums of squares of each block.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Posterior:
    """Gaussian posterior of the parameters.

    Parameters
    ----------
    mean : array (p,)
    covariance : array (p, p)
    log_evidence : float
        Of all rows, up to a constant of the data.
    by_block : array (b,)
        Log density of every block given the other blocks, same constant; empty if not asked for.
    """

    mean: np.ndarray
    covariance: np.ndarray
    log_evidence: float
    by_block: np.ndarray

    @property
    def log_predictive(self) -> float:
        """Log density of all blocks, each given the others."""
        return float(np.sum(self.by_block))


class BlockSums:
    """Sums of squares of every block of rows.

    Parameters
    ----------
    columns : array (m, p)
    target : array (m,)
    block : array (m,) of int
    blocks : int

    Attributes
    ----------
    gram : array (b, p, p)
    moment : array (b, p)
    square : array (b,)
    """

    def __init__(
        self, columns: np.ndarray, target: np.ndarray, block: np.ndarray, blocks: int
    ) -> None:
        self._places = [np.flatnonzero(block == b) for b in range(blocks)]
        self._columns = [columns[p] for p in self._places]
        self._target = [target[p] for p in self._places]
        self.gram = np.array([c.T @ c for c in self._columns])
        self.moment = np.array([c.T @ y for c, y in zip(self._columns, self._target, strict=True)])
        self.square = np.array([float(y @ y) for y in self._target])

    def extended(self, added: np.ndarray) -> Sums:
        """Sums with further columns (m, k) beside those they were made of."""
        grams, moments = [], []
        parts = zip(self._places, self._columns, self._target, strict=True)
        for b, (places, columns, target) in enumerate(parts):
            new = added[places]
            cross = columns.T @ new
            grams.append(np.block([[self.gram[b], cross], [cross.T, new.T @ new]]))
            moments.append(np.concatenate([self.moment[b], new.T @ target]))
        return Sums(np.array(grams), np.array(moments), self.square)

    @property
    def own(self) -> Sums:
        """Sums without further columns."""
        return Sums(self.gram, self.moment, self.square)


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums of squares of blocks: gram (b, p, p), moment (b, p), square (b,)."""

    gram: np.ndarray
    moment: np.ndarray
    square: np.ndarray


@dataclass(frozen=True, eq=False)
class Added:
    """Posterior of parameters added to others.

    Parameters
    ----------
    mean : array (k,)
    covariance : array (k, k)
    base_mean : array (p,)
        Of the parameters that they were added to.
    log_evidence, log_predictive : float
        As of a `Posterior` of all of them.
    """

    mean: np.ndarray
    covariance: np.ndarray
    base_mean: np.ndarray
    log_evidence: float
    log_predictive: float


class Beside:
    """Posteriors with a few more parameters of unit prior, at the cost of those alone.

    Parameters
    ----------
    sums : Sums
        Without them.
    prior_sd : array (p,)
    """

    def __init__(self, sums: Sums, prior_sd: np.ndarray) -> None:
        self._prior = prior_sd
        # The whole first, then the whole without each block.
        gram, moment = _left_out(sums.gram), _left_out(sums.moment)
        scaled = gram * np.outer(prior_sd, prior_sd) + np.eye(len(prior_sd))
        factor = np.linalg.cholesky(scaled)
        self._inverse = np.linalg.inv(factor)
        self._half = np.einsum("bij,bj->bi", self._inverse, prior_sd * moment)
        log_size = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        square = np.sum(self._half**2, axis=1) - _left_out(sums.square)
        self._evidence = 0.5 * square - log_size

    def added(self, whole: Sums, kept: np.ndarray) -> Added:
        """Posterior with some of the columns that `whole` holds after the base's own."""
        p = len(self._prior)
        own = p + kept
        cross = _left_out(whole.gram[:, :p][:, :, own]) * self._prior[:, None]
        inner = _left_out(whole.gram[:, own][:, :, own])
        moment = _left_out(whole.moment[:, own])
        half = self._inverse @ cross
        left = inner + np.eye(len(kept)) - half.swapaxes(1, 2) @ half
        goal = moment - np.einsum("bpk,bp->bk", half, self._half)
        mean = np.linalg.solve(left, goal[..., None])[..., 0]
        evidence = (
            self._evidence + 0.5 * np.sum(goal * mean, axis=1) - 0.5 * np.linalg.slogdet(left)[1]
        )
        base = self._prior * (self._inverse[0].T @ (self._half[0] - half[0] @ mean[0]))
        return Added(
            mean=mean[0],
            covariance=np.linalg.inv(left[0]),
            base_mean=base,
            log_evidence=float(evidence[0]),
            log_predictive=float(np.sum(evidence[0] - evidence[1:])),
        )


def _left_out(parts: np.ndarray) -> np.ndarray:
    """Sum of all blocks, then the sums without each block."""
    total = parts.sum(axis=0)
    return np.concatenate([total[None], total - parts])


def posterior(sums: Sums, prior_sd: np.ndarray, *, cross_validate: bool = True) -> Posterior:
    """Posterior under independent zero-mean priors.

    Parameters
    ----------
    sums : Sums
        Of rows with unit noise.
    prior_sd : array (p,)
    """
    gram, moment = sums.gram.sum(axis=0), sums.moment.sum(axis=0)
    square = float(sums.square.sum())
    evidence, mean, covariance = _evidence(gram, moment, square, prior_sd)
    predictive = []
    if cross_validate:
        for g, m, s in zip(sums.gram, sums.moment, sums.square, strict=True):
            without, _, _ = _evidence(gram - g, moment - m, square - s, prior_sd)
            predictive.append(evidence - without)
    return Posterior(mean, covariance, evidence, np.array(predictive))


def _evidence(
    gram: np.ndarray, moment: np.ndarray, square: float, prior_sd: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Log evidence, mean and covariance; in units of the priors, where all is well scaled."""
    scaled = gram * np.outer(prior_sd, prior_sd) + np.eye(len(prior_sd))
    factor = np.linalg.cholesky(scaled)
    inverse = np.linalg.inv(factor)
    half = inverse @ (prior_sd * moment)
    evidence = 0.5 * (float(half @ half) - square) - float(np.log(np.diag(factor)).sum())
    root = inverse * prior_sd
    return evidence, root.T @ half, root.T @ root
