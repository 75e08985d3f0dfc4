"""Rates with their intervals, and how honest stated probabilities are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

# Of a normal variable, two-sided 95 %.
Z95 = 1.959963984540054


def wilson(hits: int, total: int, z: float = Z95) -> tuple[float, float]:
    """Wilson score interval of a rate; (0, 1) where nothing was counted.

    Parameters
    ----------
    hits, total : int
    z : float
        Standard deviations.

    Notes
    -----
    E. B. Wilson, Probable inference, the law of succession, and statistical inference, 1927.
    """
    if total == 0:
        return 0.0, 1.0
    share = hits / total
    centre = (share + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z * np.sqrt(share * (1 - share) / total + z**2 / (4 * total**2)) / (1 + z**2 / total)
    # At the ends the formula is exact but for rounding.
    lower = 0.0 if hits == 0 else float(max(centre - half, 0.0))
    upper = 1.0 if hits == total else float(min(centre + half, 1.0))
    return lower, upper


@dataclass(frozen=True)
class Rate:
    """`hits` of `total`."""

    hits: int
    total: int

    @classmethod
    def of(cls, answers: Iterable[bool | None]) -> Rate:
        """Count the answers that are yes or no; None does not count."""
        known = [a for a in answers if a is not None]
        return cls(sum(known), len(known))

    @property
    def share(self) -> float:
        """Share of hits; nan where nothing was counted."""
        return self.hits / self.total if self.total else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson interval, 95 %."""
        return wilson(self.hits, self.total)

    def __str__(self) -> str:
        if not self.total:
            return "none counted"
        low, high = self.interval
        return f"{self.hits} of {self.total} = {self.share:.1%} ({low:.1%} to {high:.1%})"


def calibration_error(
    probability: Sequence[float], right: Sequence[bool], bins: int = 10
) -> tuple[float, list[tuple[float, float, int]]]:
    """Expected calibration error, and the mean probability, share right and count of each bin.

    Parameters
    ----------
    probability : sequence of float
    right : sequence of bool
    bins : int
        Of equal width on 0 to 1.
    """
    stated, hit = np.asarray(probability, dtype=float), np.asarray(right, dtype=float)
    if not stated.size:
        return float("nan"), []
    place = np.minimum((stated * bins).astype(int), bins - 1)
    lines = [
        (float(stated[place == b].mean()), float(hit[place == b].mean()), int((place == b).sum()))
        for b in range(bins)
        if (place == b).any()
    ]
    error = sum(count * abs(mean - share) for mean, share, count in lines) / stated.size
    return float(error), lines
