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
    log_predictive : float
        Sum over blocks of the log density given the other blocks, same constant.
    """

    mean: np.ndarray
    covariance: np.ndarray
    log_evidence: float
    log_predictive: float


@dataclass(frozen=True, eq=False)
class BlockSums:
    """Sums of squares of every block.

    Parameters
    ----------
    gram : array (b, p, p)
    moment : array (b, p)
    square : array (b,)
    """

    gram: np.ndarray
    moment: np.ndarray
    square: np.ndarray

    @classmethod
    def of(
        cls, columns: np.ndarray, target: np.ndarray, block: np.ndarray, blocks: int
    ) -> BlockSums:
        """Sums over the rows of each block; columns (m, p), target (m,), block (m,)."""
        grams, moments, squares = [], [], []
        for b in range(blocks):
            own = block == b
            part, y = columns[own], target[own]
            grams.append(part.T @ part)
            moments.append(part.T @ y)
            squares.append(float(y @ y))
        return cls(np.array(grams), np.array(moments), np.array(squares))

    def extended(
        self,
        added: np.ndarray,
        columns: np.ndarray,
        target: np.ndarray,
        block: np.ndarray,
    ) -> BlockSums:
        """Sums with further columns (m, k) beside those they were made of."""
        grams, moments = [], []
        for b in range(len(self.square)):
            own = block == b
            new = added[own]
            cross = columns[own].T @ new
            grams.append(np.block([[self.gram[b], cross], [cross.T, new.T @ new]]))
            moments.append(np.concatenate([self.moment[b], new.T @ target[own]]))
        return BlockSums(np.array(grams), np.array(moments), self.square)


def posterior(sums: BlockSums, prior_sd: np.ndarray, *, cross_validate: bool = True) -> Posterior:
    """Posterior under independent zero-mean priors.

    Parameters
    ----------
    sums : BlockSums
        Of rows with unit noise.
    prior_sd : array (p,)
    """
    gram, moment = sums.gram.sum(axis=0), sums.moment.sum(axis=0)
    square = float(sums.square.sum())
    evidence, mean, covariance = _evidence(gram, moment, square, prior_sd)
    predictive = 0.0
    if cross_validate:
        for g, m, s in zip(sums.gram, sums.moment, sums.square, strict=True):
            without, _, _ = _evidence(gram - g, moment - m, square - s, prior_sd)
            predictive += evidence - without
    return Posterior(mean, covariance, evidence, predictive)


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
