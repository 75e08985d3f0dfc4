"""Shares of the limits that a timing may use along its path, backed off where they are exceeded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import scipy

from stiffopt.problem.limit import Limits
from stiffopt.result.assessment import Assessment, DriveHistory, Violation
from stiffopt.result.trajectory import Trajectory

# Limits that a timing can be backed off from.
BACKED_OFF = ("velocity", "acceleration", "jerk", "torque", "tool_speed")
# Extra back-off each time, and the largest excess that one round backs off from: larger ones fall
# faster than the limit.
_BACK_OFF_EXTRA, _MAX_BACK_OFF = 0.01, 0.4
# Time between the places of a piece at which its shares are kept [s].
_PLACE_SPACING = 4e-3

PlacedLaws = Sequence[tuple[float, Trajectory]]


class LimitShares:
    """Shares of the limits along the pieces of a path, all of them at first.

    `window`: time about an excess within which limits are backed off [s], as long as a law is
    averaged.
    """

    def __init__(self, window: float) -> None:
        self._window = window
        self._places: list[np.ndarray] = []
        self._shares: list[dict[str, np.ndarray]] = []

    def copy(self) -> LimitShares:
        """Return shares that are backed off further without these."""
        other = LimitShares(self._window)
        other._places = list(self._places)
        other._shares = [dict(each) for each in self._shares]
        return other

    def of_piece(self, number: int) -> Callable[[str, np.ndarray], np.ndarray] | None:
        """Return the shares (K,) of a limit by its name, at path parameters (K,) of a piece."""
        if not self._shares:
            return None
        places, shares = self._places[number], self._shares[number]
        return lambda name, s: np.interp(s, places, shares[name])

    @property
    def margins(self) -> dict[str, float]:
        """Largest unused share of every limit that was backed off."""
        unused = {
            name: max(1.0 - float(each[name].min()) for each in self._shares)
            for name in BACKED_OFF
            if self._shares
        }
        return {name: share for name, share in unused.items() if share > 0.0}

    def back_off(
        self,
        laws: PlacedLaws,
        limits: Limits,
        histories: Sequence[DriveHistory],
        excess: Sequence[Violation],
    ) -> None:
        """Back off about the instants at which motions of the laws exceed a limit.

        `laws`: those of the pieces, with the time at which each begins [s]. `histories`: the plan,
        and its motors.
        """
        if not self._shares:
            for _, law in laws:
                count = int(np.ceil(law.duration / _PLACE_SPACING)) + 1
                places = np.unique(law(np.linspace(0.0, law.duration, count))[:, 0])
                self._places.append(places)
                self._shares.append({name: np.ones(len(places)) for name in BACKED_OFF})
        time = histories[0].time
        for name in {each.limit for each in excess} & set(BACKED_OFF):
            uses = (np.interp(time, each.time, _uses(each, limits, name)) for each in histories)
            used = np.max(list(uses), axis=0)
            for each in excess:
                if each.limit == name:
                    # A limit that depends on position or speed may be less than the constant.
                    at = int(np.argmin(np.abs(time - each.time)))
                    used[at] = max(used[at], 1.0 + each.value)
            self._back_off_limit(name, laws, time, used)

    def _back_off_limit(
        self, name: str, laws: PlacedLaws, time: np.ndarray, used: np.ndarray
    ) -> None:
        """Divide the shares of a limit by its use (K,) at instants (K,) of the motion."""
        width = 1 + 2 * int(np.ceil(self._window / np.diff(time).mean()))
        about = scipy.ndimage.maximum_filter1d(used, width)
        over = np.where(about > 1.0, np.minimum(about, 1.0 + _MAX_BACK_OFF), 1.0 - _BACK_OFF_EXTRA)
        for (begin, law), places, shares in zip(laws, self._places, self._shares, strict=True):
            at = np.interp(places, law(np.clip(time - begin, 0.0, law.duration))[:, 0], over)
            shares[name] = shares[name] * (1.0 - _BACK_OFF_EXTRA) / at


def _uses(history: DriveHistory, limits: Limits, name: str) -> np.ndarray:
    """Largest use (K,) of a constant limit, relative to it."""
    if name == "tool_speed":
        speed = history.tool_speed if isinstance(history, Assessment) else 0.0 * history.time
        return np.asarray(speed / limits.tool_speed)
    values: Mapping[str, np.ndarray] = vars(history)
    return np.asarray(np.max(np.abs(values[name]) / getattr(limits, name), axis=1))
