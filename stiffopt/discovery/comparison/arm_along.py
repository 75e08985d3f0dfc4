"""Signals of the whole arm along a motion, worked out where an effect asks for them.

What a run of ten minutes would hold of the bodies' torques alone is more than all else of it, and
most effects and predictions ask for none of them.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any

import numpy as np

from stiffopt.discovery.comparison.bodies import A_BODY
from stiffopt.discovery.comparison.nominal_robot import RobotModel

# Torques of single bodies that are kept of all runs of a robot, those asked for last [bytes].
_BODY_TORQUE_CACHE_BYTES = 2**26
# Torques of changed bodies that are kept of a run, those asked for last.
_MAX_CACHED_CHANGES = 3


class BodyRegressor:
    """Joint torques along a motion for a unit of every inertial parameter (K, n, 10 n).

    Parameters
    ----------
    robot : RobotModel
    q, v, a : array (K, n)
        Motion of the links.
    """

    def __init__(self, robot: RobotModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        self._robot, self._motion = robot, (q, v, a)
        self._changes: dict[bytes, np.ndarray] = {}

    def of(self, body: int) -> np.ndarray:
        """Torques (K, n, 10) for the parameters of one body (from 0)."""
        kept = self._robot.body_torque_cache
        found = kept.pop((self, body), None)
        if found is None:
            size = self._motion[0].nbytes * A_BODY
            # Room is made before: a long run has none for one more.
            while (
                kept
                and size + sum(each.nbytes for each in kept.values()) > _BODY_TORQUE_CACHE_BYTES
            ):
                kept.pop(next(iter(kept)))
            found = self._robot.body_torques(body, *self._motion)
        kept[self, body] = found
        return found

    def torque(self, change: np.ndarray) -> np.ndarray:
        """Torques (K, n) of changed parameters (n, 10) of all bodies."""
        key = change.tobytes()
        if key not in self._changes:
            while len(self._changes) >= _MAX_CACHED_CHANGES:
                self._changes.pop(next(iter(self._changes)))
            self._changes[key] = self._robot.changed_torque(change, *self._motion)
        return self._changes[key]

    def __getitem__(self, where: Any) -> np.ndarray:
        """Entries as of an array: [..., k] is what one parameter of one body does."""
        if isinstance(where, tuple) and where[0] is Ellipsis and isinstance(where[1], int):
            body, parameter = divmod(where[1], A_BODY)
            return np.asarray(self.of(body)[..., parameter])
        return np.asarray(self.__array__()[where])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """All of it, which a long run has no room for more than once."""
        return np.asarray(self._robot.body_regressor(*self._motion), dtype=dtype)


class LazyArmSignals:
    """Tool, weight and bodies of an arm along the motion of its links.

    Parameters
    ----------
    robot : RobotModel
    q, v, a : array (K, n)

    Attributes
    ----------
    body_regressor : BodyRegressor
    """

    def __init__(self, robot: RobotModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        self._robot, self._motion = robot, (q, v, a)
        self.body_regressor = BodyRegressor(robot, q, v, a)

    @cached_property
    def _tool(self) -> tuple[np.ndarray, np.ndarray]:
        return self._robot.tool(self._motion[0])

    @property
    def tool_position(self) -> np.ndarray:
        """Of the tool in the base frame (K, 3) [m]."""
        return self._tool[0]

    @property
    def tool_jacobian(self) -> np.ndarray:
        """Of that position (K, 3, n)."""
        return self._tool[1]

    @property
    def tool_velocity(self) -> np.ndarray:
        """Of the tool (K, 3) [m/s]."""
        return np.asarray(np.einsum("kij,kj->ki", self._tool[1], self._motion[1]))

    @cached_property
    def tilt(self) -> np.ndarray:
        """Change of the torques for a turn of the base about x and y (K, n, 2) [N m/rad]."""
        return self._robot.tilt(self._motion[0])

    def head(self, count: int) -> LazyArmSignals:
        """The first samples, of what is worked out for all of them."""
        return _ArmHead(self, count)

    def decimate(self, every: int) -> LazyArmSignals:
        """Every so many samples."""
        return LazyArmSignals(self._robot, *(x[::every] for x in self._motion))

    def with_bodies(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> LazyArmSignals:
        """The same with the bodies' torques along another motion."""
        other = copy(self)
        other.body_regressor = BodyRegressor(self._robot, q, v, a)
        return other


class _RegressorHead(BodyRegressor):
    def __init__(self, whole: BodyRegressor, count: int) -> None:
        super().__init__(whole._robot, *(x[:count] for x in whole._motion))
        self._whole, self._count = whole, count

    def of(self, body: int) -> np.ndarray:
        return self._whole.of(body)[: self._count]

    def torque(self, change: np.ndarray) -> np.ndarray:
        return self._whole.torque(change)[: self._count]


class _ArmHead(LazyArmSignals):
    def __init__(self, whole: LazyArmSignals, count: int) -> None:
        super().__init__(whole._robot, *(x[:count] for x in whole._motion))
        self._whole, self._count = whole, count
        self.body_regressor = _RegressorHead(whole.body_regressor, count)

    @cached_property
    def _tool(self) -> tuple[np.ndarray, np.ndarray]:
        position, jacobian = self._whole._tool
        return position[: self._count], jacobian[: self._count]

    @cached_property
    def tilt(self) -> np.ndarray:
        return self._whole.tilt[: self._count]
