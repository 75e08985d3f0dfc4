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

    def part(self, kept: np.ndarray) -> Sums:
        """Sums with some of the columns only."""
        return Sums(self.gram[:, kept][:, :, kept], self.moment[:, kept], self.square)


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
