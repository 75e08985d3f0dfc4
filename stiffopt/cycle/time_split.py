"""Split of a cycle's time between its legs: the one of least objective over the whole cycle.

Legs share nothing but the time. Each leg's objective falls with its duration T about as c / T^p;
the split that is best for these laws is solved for, the legs are solved again at their new
durations, and c and p follow from what they gave: a fixed point is the optimum of the whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import brentq

Combination = Literal["peak", "rms", "sum"]

# Exponent of a leg's objective over its duration before a second value is known: that of a
# deflection by acceleration torques.
_FIRST_EXPONENT = 2.0
_EXPONENT_RANGE = (0.2, 8.0)
# Change of a leg's duration in one step, and from which on two values give an exponent.
_MAX_STEP, _MIN_STEP = 1.8, 1.002
# Longer than a duration at which a leg was infeasible.
_MIN_FEASIBLE_FACTOR = 1.03


def combined(values: np.ndarray, durations: np.ndarray, by: Combination) -> float:
    """Objective over the cycle from those of the legs (L,)."""
    if by == "peak":
        return float(values.max())
    if by == "rms":
        return float(np.sqrt(values**2 @ durations / durations.sum()))
    return float(values.sum())


@dataclass
class TimeSplit:
    """Search for the split of a time."""

    total: float  # sum of the legs' durations [s]
    durations: np.ndarray  # (L,) first split [s]
    # "peak", "rms" or "sum": how the cycle's objective follows from those of its legs.
    by: Combination

    def __post_init__(self) -> None:
        count = len(self.durations)
        self._exponents = np.full(count, _FIRST_EXPONENT)
        self._values = np.full(count, np.nan)
        self._at = np.full(count, np.nan)
        self._least = np.zeros(count)

    def learn(self, values: np.ndarray) -> None:
        """Learn the legs' objectives (L,) at the present durations; nan where a leg failed."""
        failed = ~np.isfinite(values)
        self._least[failed] = _MIN_FEASIBLE_FACTOR * self.durations[failed]
        ratio = self.durations / self._at
        moved = ~failed & np.isfinite(ratio) & (np.abs(np.log(ratio)) > np.log(_MIN_STEP))
        moved &= (values > 0.0) & (self._values > 0.0)
        slope = -np.log(values[moved] / self._values[moved]) / np.log(ratio[moved])
        self._exponents[moved] = np.clip(slope, *_EXPONENT_RANGE)
        self._values = np.where(failed, self._values, values)
        self._at = np.where(failed, self._at, self.durations)

    def proposal(self) -> np.ndarray | None:
        """Better durations (L,) [s]; None where the legs cannot be made in the time."""
        low = np.maximum(self._least, self.durations / _MAX_STEP)
        high = np.maximum(_MAX_STEP * self.durations, low)
        if low.sum() > self.total:
            low = self._least
            if low.sum() > self.total:
                return None
        known = np.isfinite(self._values) & (self._values > 0.0)
        if not known.all():
            # Failed legs take what they need; the others give in proportion.
            wanted = np.where(known, self.durations, low)
            spare = np.maximum(wanted - low, 0.0)
            return np.asarray(low + spare * (self.total - low.sum()) / max(spare.sum(), 1e-12))
        exponents = self._exponents
        scales = np.log(self._values) + exponents * np.log(self._at)
        powers = exponents
        if self.by == "rms":
            scales, exponents = 2.0 * scales, 2.0 * exponents - 1.0
            exponents = np.maximum(exponents, _EXPONENT_RANGE[0])
        if self.by != "peak":
            scales, powers = scales + np.log(exponents), exponents + 1.0

        def durations(level: float) -> np.ndarray:
            return np.asarray(np.clip(np.exp((scales - level) / powers), low, high))

        reach = np.concatenate([scales - powers * np.log(low), scales - powers * np.log(high)])
        ends = float(reach.min()), float(reach.max())
        if durations(ends[0]).sum() < self.total:
            return np.asarray(high * self.total / high.sum())
        level = brentq(lambda each: durations(each).sum() - self.total, *ends, xtol=1e-12)
        found = durations(float(level))
        return np.asarray(found * self.total / found.sum())


# Share of the limit from which on a value counts as at it, width of the bracket of durations, and
# solves of a leg.
_REACHED_SHARE, _BRACKET_WIDTH, _MAX_SOLVES = 0.99, 0.005, 12


class ShortestDuration:
    """Search for the shortest duration at which an objective is within a limit.

    By the law c / T^p through the last two values, inside the bracket of the durations at which the
    limit was exceeded and kept. `duration`: first one [s].
    """

    def __init__(self, limit: float, duration: float) -> None:
        self._limit, self.duration = limit, duration
        self._low, self._high, self._solves = 0.0, np.inf, 0
        self._exponent = _FIRST_EXPONENT
        self._last: tuple[float, float] | None = None
        self._found = False

    def proposal(self) -> float | None:
        """Duration of the next solve [s]; None where the search has ended."""
        narrow = self._high <= (1.0 + _BRACKET_WIDTH) * self._low
        return None if self._found or narrow or self._solves >= _MAX_SOLVES else self.duration

    def learn(self, value: float) -> bool:
        """Learn the value at the proposed duration, nan where it failed; True if it is the best."""
        at, self._solves = self.duration, self._solves + 1
        kept = bool(value <= self._limit)
        if kept:
            self._high = min(self._high, at)
            self._found = value >= _REACHED_SHARE * self._limit
        else:
            self._low = max(self._low, at)
        wanted = at * _MAX_STEP ** (0.0 if kept else 0.5)
        if np.isfinite(value) and value > 0.0:
            if self._last is not None and abs(np.log(at / self._last[0])) > np.log(_MIN_STEP):
                slope = -np.log(value / self._last[1]) / np.log(at / self._last[0])
                self._exponent = float(np.clip(slope, *_EXPONENT_RANGE))
            self._last = (at, value)
            # Aimed at the middle of what counts as reached.
            aim = 0.5 * (1.0 + _REACHED_SHARE) * self._limit
            step = (value / aim) ** (1.0 / self._exponent)
            wanted = at * float(np.clip(step, 1.0 / _MAX_STEP, _MAX_STEP))
        if not self._low < wanted < self._high:
            wanted = float(np.sqrt(max(self._low, self._high / _MAX_STEP**2) * self._high))
        self.duration = wanted
        return kept and at == self._high
