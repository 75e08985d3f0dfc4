"""Torque of a joint's spring over its deflection, with what was found in the spring.

A link that crosses a play carries nothing meanwhile: over its torque the deflection jumps, and no
slope leads across. Over its deflection the torque is as smooth as it ever was.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

# Of the largest torque, changes by less of which have no mean slope.
_MIN_TORQUE_CHANGE = 1e-9


@dataclass(frozen=True, eq=False)
class SpringLaw:
    """A spring with a play by a table, straight between its entries and beyond them.

    Parameters
    ----------
    carried : array (m,)
        Torques, rising [N m].
    deflection : array (m,)
        Under them, rising [rad].
    windup : array (m,)
        Of that, the spring's own [rad].
    """

    carried: np.ndarray
    deflection: np.ndarray
    windup: np.ndarray

    @cached_property
    def max_stiffness(self) -> float:
        """Largest slope of its torque [N m/rad]."""
        return float(1.0 / np.min(self._interval_compliance))

    def share_of_play(self, deflection: np.ndarray) -> np.ndarray:
        """Of rates of deflections (k,), what share is free travel."""
        cell = self._interval(self.deflection, deflection)
        return np.asarray(1.0 - (np.diff(self.windup) / np.diff(self.deflection))[cell])

    def play(self, deflection: np.ndarray) -> np.ndarray:
        """Of deflections (k,), what is free travel [rad]."""
        return np.asarray(np.interp(deflection, self.deflection, self.deflection - self.windup))

    def torque(self, deflection: np.ndarray) -> np.ndarray:
        """Torque [N m] of deflections (k,) [rad]."""
        cell = self._interval(self.deflection, deflection)
        along = deflection - self.deflection[cell]
        return np.asarray(self.carried[cell] + along / self._interval_compliance[cell])

    def compliance(self, torque: np.ndarray) -> np.ndarray:
        """Mean slope of the deflection [rad/(N m)] over the time that each sample (k,) stands for.

        At the edge of a play the slope is another one a moment later.
        """
        passed = np.interp(torque, self.carried, self.deflection)
        middle = 0.5 * (passed[1:] + passed[:-1])
        before = np.concatenate([passed[:1], middle])
        after = np.concatenate([middle, passed[-1:]])
        change = self.torque(after) - self.torque(before)
        still = np.abs(change) < _MIN_TORQUE_CHANGE * np.max(np.abs(torque))
        here = self._interval_compliance[self._interval(self.carried, torque)]
        return np.asarray(np.where(still, here, (after - before) / np.where(still, 1.0, change)))

    @cached_property
    def _interval_compliance(self) -> np.ndarray:
        return np.diff(self.deflection) / np.diff(self.carried)

    @staticmethod
    def _interval(entries: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.clip(np.searchsorted(entries, values, "right") - 1, 0, len(entries) - 2)
