"""Goals of a path's freedom, as rows of a quadratic programme: least deflection, least time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import scipy

from stiffopt.problem.freedom_task import EXCESS_WEIGHT, USED_SHARE, FreedomTask

# Stand-ins for limits that do not exist [rad/s], [rad/s^2].
_NO_VELOCITY, _NO_ACCELERATION = 1e3, 1e6
# Least scale of a deflection [m] or a time [s].
_SMALLEST_SCALE = 1e-9
# Largest relative change of the squared speed in one programme.
_SPEED_CHANGE = 0.5


@dataclass(frozen=True, eq=False)
class GoalRows:
    """Rows low <= A (step, further unknowns) <= high, and the gradient by the further unknowns."""

    matrix: np.ndarray
    low: np.ndarray
    high: np.ndarray
    gradient: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @property
    def extra(self) -> int:
        """Number of further unknowns."""
        return len(self.gradient)

    def with_excess(self, matrix: np.ndarray, excess: np.ndarray) -> GoalRows:
        """Return all rows, with those of an excess (R,) that changes with the step (R, Y).

        A further unknown is the largest excess, at its price.
        """
        count = len(matrix)
        other = np.zeros((count, self.extra))
        return GoalRows(
            np.vstack(
                [
                    np.hstack([self.matrix, np.zeros((len(self.matrix), 1))]),
                    np.hstack([matrix, other, -np.ones((count, 1))]),
                ]
            ),
            np.append(self.low, np.full(count, -np.inf)),
            np.append(self.high, -excess),
            np.append(self.gradient, EXCESS_WEIGHT),
            np.append(self.lower, 0.0),
            np.append(self.upper, np.inf),
        )

    def with_rows(
        self, matrix: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return all rows, with further ones (R, Y) of the step alone."""
        wide = np.hstack([matrix, np.zeros((len(matrix), self.extra))])
        return (
            np.vstack([self.matrix, wide]),
            np.append(self.low, low),
            np.append(self.high, high),
        )


class FreedomGoal(ABC):
    """Goal that is minimised over the freedom of a path.

    The cost is relative to that of a typical path, `scale` [m] or [s]. The largest excess of
    torques at rest is charged with a price that no gain of the goal pays.
    """

    def __init__(self, task: FreedomTask, scale: float) -> None:
        self._task = task
        self._scale = max(scale, _SMALLEST_SCALE)
        limits = task.limits
        finite = np.isfinite(limits.velocity), np.isfinite(limits.acceleration)
        self._velocity = USED_SHARE * np.where(finite[0], limits.velocity, _NO_VELOCITY)
        self._acceleration = USED_SHARE * np.where(finite[1], limits.acceleration, _NO_ACCELERATION)

    def evaluate(
        self, joints: np.ndarray, placement: np.ndarray, turns: np.ndarray, data: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Return the cost of joint positions (K, n), and numbers that `rows` needs."""
        cost, detail = self._evaluate(joints, placement, turns, data)
        excess = float(self._task.hold_excess(joints, placement, data).max(initial=0.0))
        return cost + EXCESS_WEIGHT * excess, detail

    @abstractmethod
    def _evaluate(
        self, joints: np.ndarray, placement: np.ndarray, turns: np.ndarray, data: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Return the cost without the price of holding torques, and numbers for `rows`."""

    @abstractmethod
    def rows(
        self, joints: np.ndarray, slopes: np.ndarray, detail: np.ndarray, squares: np.ndarray
    ) -> GoalRows:
        """Return the rows at joint positions with slopes (K, n, Y), and those of the squares."""

    @abstractmethod
    def value(self, detail: np.ndarray) -> float:
        """Return the deflection [m] or the time [s] of the detail of a cost."""


class DeflectionGoal(FreedomGoal):
    """Largest deflection at the speed of the path.

    The cost is its relative square, and twice the share by which the slowest joint is too slow for
    that speed.
    """

    def __init__(self, task: FreedomTask, scale: float) -> None:
        super().__init__(task, scale)
        h = task.least_steps
        self._steps, self._middles = h, 0.5 * (h[1:] + h[:-1])

    def _evaluate(
        self, joints: np.ndarray, placement: np.ndarray, turns: np.ndarray, data: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Return the cost, and the squared deflections (K,) over that of the scale."""
        error = self._task.errors(joints, placement, turns, data)
        rate, change = self._rates(joints)
        slow = max(float(np.abs(rate).max()) - 1.0, float(np.abs(change).max()) - 1.0, 0.0)
        relative = (error / self._scale) ** 2
        return float(relative.max()) + 2.0 * slow, relative

    def _rates(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return velocities and accelerations over their limits, of positions or slopes."""
        wide = (slice(None),) + (None,) * (joints.ndim - 1)
        limits = [
            each.reshape((1, -1) + (1,) * (joints.ndim - 2))
            for each in (self._velocity, self._acceleration)
        ]
        speed = np.diff(joints, axis=0) / self._steps[wide]
        return speed / limits[0], np.diff(speed, axis=0) / self._middles[wide] / limits[1]

    def rows(
        self, joints: np.ndarray, slopes: np.ndarray, detail: np.ndarray, squares: np.ndarray
    ) -> GoalRows:
        """Epigraph of the squares, and rates within 1 + slowing."""
        size = slopes.shape[2]
        count = len(detail)
        matrix = [np.hstack([squares / self._scale**2, np.tile([-1.0, 0.0], (count, 1))])]
        high = [-detail]
        for value, slope in zip(self._rates(joints), self._rates(slopes), strict=True):
            flat = slope.reshape(-1, size)
            # Rows far from their bound would only slow the programme.
            near = np.abs(value.ravel()) > 0.3
            for sign in (1.0, -1.0):
                tail = np.tile([0.0, -1.0], (int(near.sum()), 1))
                matrix.append(np.hstack([sign * flat[near], tail]))
                high.append(1.0 - sign * value.ravel()[near])
        bound = np.concatenate(high)
        return GoalRows(
            np.vstack(matrix), np.full(len(bound), -np.inf), bound, np.array([1.0, 2.0]),
            np.zeros(2), np.full(2, np.inf),
        )  # fmt: skip

    def value(self, detail: np.ndarray) -> float:
        """Return the largest deflection [m]."""
        return self._scale * float(np.sqrt(detail.max()))


class TimeGoal(FreedomGoal):
    """Least time on the path by its squared rate at the nodes, at rest at both ends.

    With the number of the node as path parameter s and b its squared rate: the joints' velocity is
    q' sqrt(b), their acceleration q'' b + q' b' / 2.
    """

    def _evaluate(
        self, joints: np.ndarray, placement: np.ndarray, turns: np.ndarray, data: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Return the relative time, and the squared rates (K,)."""
        ceiling, rows = self._rate_rows(joints)
        count = len(joints)
        found = scipy.optimize.linprog(
            -np.ones(count) / np.maximum(ceiling.max(), 1e-12),
            A_ub=np.vstack([rows, -rows]),
            b_ub=np.ones(2 * len(rows)),
            bounds=np.stack([np.zeros(count), ceiling], axis=1),
            method="highs",
        )
        rates = np.clip(found.x, 0.0, None)
        return self._time(rates) / self._scale, rates

    def _time(self, rates: np.ndarray) -> float:
        root = np.sqrt(rates)
        return float(np.sum(2.0 / np.maximum(root[1:] + root[:-1], 1e-9)))

    def _rate_rows(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ceilings (K,) of the squared rate, and rows |A b| <= 1 of the accelerations."""
        count = len(joints)
        step, bend = np.diff(joints, axis=0), np.diff(joints, 2, axis=0)
        with np.errstate(divide="ignore"):
            own = np.minimum(
                np.min((self._velocity / np.abs(step)) ** 2, axis=1),
                1.0 / np.maximum(self._task.least_steps, 1e-9) ** 2,
            )
        ceiling = np.minimum(np.append(own, np.inf), np.append(np.inf, own))
        ceiling[[0, -1]] = 0.0
        rows = np.zeros((count - 1, joints.shape[1], count))
        k = np.arange(count - 1)
        middle = step / self._acceleration
        rows[k, :, k] -= 0.5 * middle
        rows[k, :, k + 1] += 0.5 * middle
        curved = np.vstack([bend[:1], 0.5 * (bend[1:] + bend[:-1]), bend[-1:]]) / self._acceleration
        for end in (0, 1):
            rows[k, :, k + end] += 0.5 * curved
        return ceiling, rows.reshape(-1, count)

    def rows(
        self, joints: np.ndarray, slopes: np.ndarray, detail: np.ndarray, squares: np.ndarray
    ) -> GoalRows:
        """Linearised limits of step and squared rate."""
        count, n, size = slopes.shape
        _, rows = self._rate_rows(joints)
        rates, unit = detail, float(detail.max())
        # Change of the accelerations with the joints, at the present rates.
        turned = np.zeros((len(rows), size))
        for y in range(size):
            _, moved = self._rate_rows(slopes[:, :, y])
            turned[:, y] = moved @ rates
        value = rows @ rates
        own = 0.5 * (rates[1:] + rates[:-1])
        step, slope = np.diff(joints, axis=0), np.diff(slopes, axis=0)
        # |q'| sqrt(b) <= v as q'^2 b <= v^2, relative.
        square = 2.0 * step[:, :, None] * slope * own[:, None, None]
        square /= self._velocity[None, :, None] ** 2
        by_rate = step**2 / self._velocity**2
        fast = np.zeros((count - 1, n, count))
        k = np.arange(count - 1)
        fast[k, :, k] = fast[k, :, k + 1] = 0.5 * by_rate
        used = (by_rate * own[:, None]).ravel()
        matrix = np.vstack(
            [
                np.hstack([turned, rows * unit]),
                np.hstack([square.reshape(-1, size), fast.reshape(-1, count) * unit]),
            ]
        )
        feed = np.append(self._task.least_steps, np.inf), np.append(np.inf, self._task.least_steps)
        cap = 1.0 / np.maximum(np.minimum(*feed), 1e-9) ** 2
        cap[[0, -1]] = 0.0
        root = np.sqrt(np.maximum(rates, 1e-12 * unit))
        pairs = (root[1:] + root[:-1]) ** 2
        slow = -(np.append(1.0 / pairs, 0.0) + np.append(0.0, 1.0 / pairs)) / root
        slow[[0, -1]] = 0.0
        return GoalRows(
            matrix,
            np.concatenate([-1.0 - value, np.full(len(used), -np.inf)]),
            np.concatenate([1.0 - value, 1.0 - used]),
            slow * unit / self._scale,
            -_SPEED_CHANGE * rates / unit,
            np.minimum(_SPEED_CHANGE * rates, np.maximum(cap - rates, 0.0)) / unit,
        )

    def value(self, detail: np.ndarray) -> float:
        """Return the time [s]."""
        return self._time(detail)
