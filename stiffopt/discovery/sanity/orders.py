"""Other readings of the same files: swapped joints and columns, turned signs, units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.balance import Motion
from stiffopt.discovery.sanity.samples import Samples

# Units that positions of turning and of sliding joints may be in, in SI.
DEGREE, MILLIMETRE = np.pi / 180.0, 1e-3
# Of clocks in ms, us and ns, and of stamps counted with another rate.
_CLOCKS = (1e-3, 1e-6, 1e-9, 0.01, 0.1, 10.0, 100.0, 1e3)


@dataclass(frozen=True, eq=False)
class Reading:
    """Which column a joint takes, and what its values are multiplied with.

    Parameters
    ----------
    position_from, torque_from : tuple of int (n,)
        Number (from 0) of the joint whose columns each joint takes.
    position_scale, torque_scale : tuple of float (n,)
    time_scale : float
        What the time is multiplied with.
    steps : int
        In how many steps it differs from the file's own reading.
    in_degrees : tuple of bool (n,)
        Joints whose positions the file says to be in degrees.
    """

    position_from: tuple[int, ...]
    torque_from: tuple[int, ...]
    position_scale: tuple[float, ...]
    torque_scale: tuple[float, ...]
    time_scale: float = 1.0
    steps: int = 0
    in_degrees: tuple[bool, ...] = ()

    @staticmethod
    def as_described(n: int, position_scale: np.ndarray | None = None) -> Reading:
        """The file's own reading, whose positions have been multiplied with a scale (n,)."""
        order, ones = tuple(range(n)), (1.0,) * n
        stated = np.ones(n) if position_scale is None else np.abs(position_scale)
        degrees = tuple(bool(is_) for is_ in np.isclose(stated, DEGREE))
        return Reading(order, order, ones, ones, in_degrees=degrees)

    def motion(self, samples: Samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration (m, n) of the joints in this reading."""
        take, scale = list(self.position_from), np.array(self.position_scale)
        position, velocity, acceleration = (
            values[:, take] * scale / self.time_scale**order
            for order, values in enumerate(
                (samples.position, samples.velocity, samples.acceleration)
            )
        )
        return position, velocity, acceleration

    def torque(self, measured: np.ndarray) -> np.ndarray:
        """Torques (m, n) of the joints in this reading."""
        scaled: np.ndarray = measured[:, list(self.torque_from)] * np.array(self.torque_scale)
        return scaled

    def neighbours(self, prismatic: np.ndarray) -> Iterator[Reading]:
        """Readings one step further: units, two joints swapped, a sign turned, a clock."""
        n, parts = len(self.position_from), ("position", "torque", "both")
        for which in (*np.eye(n, dtype=bool), ~prismatic, prismatic, np.ones(n, dtype=bool)):
            other = self.in_other_units(prismatic, which)
            if other != self:
                yield other
        for part in parts:
            for one, two in combinations(range(n), 2):
                yield self._swapped(part, one, two)
            for joint in range(n):
                yield self._turned(part, joint)
        if self.time_scale == 1.0:
            for factor in _CLOCKS:
                yield self._stepped(time_scale=factor)

    def in_other_units(self, prismatic: np.ndarray, which: np.ndarray) -> Reading:
        """Positions of these joints (n,) in degrees or mm, unless they are by now."""
        scale = tuple(
            s * (MILLIMETRE if slides else DEGREE) if chosen and abs(s) == 1.0 else s
            for s, slides, chosen in zip(self.position_scale, prismatic, which, strict=True)
        )
        return self if scale == self.position_scale else self._stepped(position_scale=scale)

    def _stepped(self, **changes: Any) -> Reading:
        return replace(self, steps=self.steps + 1, **changes)

    def _swapped(self, part: str, one: int, two: int) -> Reading:
        changes: dict[str, Any] = {}
        for kind in ("position", "torque"):
            if part in (kind, "both"):
                for field in (f"{kind}_from", f"{kind}_scale"):
                    values = list(getattr(self, field))
                    values[one], values[two] = values[two], values[one]
                    changes[field] = tuple(values)
        return self._stepped(**changes)

    def _turned(self, part: str, joint: int) -> Reading:
        changes: dict[str, Any] = {}
        for kind in ("position", "torque"):
            if part in (kind, "both"):
                field = f"{kind}_scale"
                changes[field] = _times(getattr(self, field), joint, -1.0)
        return self._stepped(**changes)


def _times(scale: tuple[float, ...], joint: int, factor: float) -> tuple[float, ...]:
    return tuple(s * factor if k == joint else s for k, s in enumerate(scale))


class Motions:
    """Motions of readings by the nominal model, each computed once."""

    def __init__(self, robot: RobotModel, samples: Samples) -> None:
        self._robot, self._samples = robot, samples
        self._kept: dict[tuple[object, ...], Motion] = {}

    def of(self, reading: Reading) -> Motion:
        """Motion of a reading; torques do not matter to it."""
        key = (reading.position_from, reading.position_scale, reading.time_scale)
        if key not in self._kept:
            self._kept[key] = Motion.of(self._robot, *reading.motion(self._samples))
        return self._kept[key]
