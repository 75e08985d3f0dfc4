"""Weights of the duty in the legs' objectives, by which a cycle keeps the limits of its duty.

Legs share the duty as they share the time: its limits bound sums of integrals over all legs. Each
leg minimises its objective and a weighted integral for every exceeded limit. Where the limit is
just kept, the weights are the multipliers of the limits, and the legs the optimum of the cycle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stiffopt.problem.objective import Objective
from stiffopt.result.duty import DutyUse

# First weighted integral over the objective: that of a motion whose torque is all inertia.
_FIRST_SHARE = 1.0 / 3.0
# Change of the logarithm of a weight over that of the use: of a motion whose torque is all inertia
# first, then by the last two solves, within a range.
_FIRST_GAIN, _GAIN_RANGE, _MAX_STEP = 1.0, (0.3, 8.0), 2.0
# Share of a limit from which on it counts as just used, and the one that is aimed at.
_USED_SHARE, _AIMED_SHARE = 0.985, 0.994

Key = tuple[str, int]


@dataclass
class DutyWeights:
    """Search for the weights of the limits of a duty."""

    scale: float  # objective of the cycle without limits of the duty
    _weights: dict[Key, float] = field(default_factory=dict)
    _gains: dict[Key, float] = field(default_factory=dict)
    _last: dict[Key, tuple[float, float]] = field(default_factory=dict)

    def kept(self, uses: Sequence[DutyUse]) -> bool:
        """Return True where all limits hold, and none that has a weight is left unused."""
        shares = _largest_shares(uses)
        unused = any(shares[key] < _USED_SHARE for key in self._weights)
        return max(shares.values(), default=0.0) <= 1.0 and not unused

    def learn(self, uses: Sequence[DutyUse], integrals: dict[Key, float]) -> None:
        """Improve the weights by the uses of a solved cycle and the integrals over its legs."""
        for key, share in _largest_shares(uses).items():
            weight = self._weights.get(key)
            if weight is None:
                if share > 1.0:
                    self._weights[key] = _FIRST_SHARE * self.scale / max(integrals[key], 1e-12)
                    self._last[key] = self._weights[key], np.nan
                continue
            before, used = self._last[key]
            moved = np.log(weight / before)
            fell = np.log(used / share)
            if np.isfinite(fell) and abs(moved) > 1e-3 and moved * fell > 0.0:
                self._gains[key] = float(np.clip(moved / fell, *_GAIN_RANGE))
            self._last[key] = weight, share
            step = self._gains.get(key, _FIRST_GAIN) * np.log(share / _AIMED_SHARE)
            self._weights[key] = weight * float(np.exp(np.clip(step, -_MAX_STEP, _MAX_STEP)))

    def objectives(self) -> tuple[Objective, ...]:
        """Terms beside the objectives of each leg."""
        return tuple(
            Objective(name=name, joints=(joint,) if joint else (), weight=weight)
            for (name, joint), weight in self._weights.items()
        )


def _largest_shares(uses: Sequence[DutyUse]) -> dict[Key, float]:
    """Return the largest use of the limits of each integral."""
    found: dict[Key, float] = {}
    for each in uses:
        key = each.objective, each.joint
        found[key] = max(found.get(key, 0.0), each.share)
    return found
