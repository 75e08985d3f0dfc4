"""Goals of a path's freedom, as rows of a quadratic programme: least deflection, least time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import scipy

from stiffopt.problem.freedom_task import (
    EXCESS_WEIGHT,
    USED_SHARE,
    FreedomTask,
    path_derivatives,
)

# Stand-ins for limits that do not exist [rad/s], [rad/s^2], [rad/s^3].
_NO_VELOCITY, _NO_ACCELERATION, _NO_JERK = 1e3, 1e6, 1e9
# Least scale of a deflection [m] or a time [s].
_SMALLEST_SCALE = 1e-9
# Use of a limit below which a programme leaves its row out: rows far below would only slow it.
_NEAR_USE = 0.3
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
            near = np.abs(value.ravel()) > _NEAR_USE
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
    """Least time on the path by its squared speed b at the nodes, at rest at ends and stops.

    With the distance s: the joints' velocity is q' sqrt(b), their acceleration q'' b + q' b' / 2;
    of their jerk, q''' b^(3/2) counts, which blends and turns ask for.
    """

    def __init__(self, task: FreedomTask, scale: float) -> None:
        super().__init__(task, scale)
        self._lengths = np.diff(task.along)
        jerk = task.limits.jerk
        self._jerk = USED_SHARE * np.where(np.isfinite(jerk), jerk, _NO_JERK)
        self._cap = _at_both_nodes((self._lengths / np.maximum(task.least_steps, 1e-9)) ** 2)
        rests = [0, len(task.along) - 1]
        rests += [int(np.argmin(np.abs(task.along - stop))) for stop in task.path.stops]
        self._cap[rests] = 0.0

    def _evaluate(
        self, joints: np.ndarray, placement: np.ndarray, turns: np.ndarray, data: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Return the relative time, and the squared speeds (K,)."""
        slope, bend, twist = path_derivatives(self._task.along, joints)
        with np.errstate(divide="ignore"):
            own = np.min((self._velocity / np.abs(slope)) ** 2, axis=1)
            jerky = np.min(np.cbrt((self._jerk / twist) ** 2), axis=1)
        ceiling = np.minimum(self._cap, _at_both_nodes(np.minimum(own, jerky)))
        rows = self._acceleration_rows(slope, bend)
        weights = np.append(self._lengths, 0.0) + np.append(0.0, self._lengths)
        found = scipy.optimize.linprog(
            -weights / np.maximum(ceiling.max(), 1e-12),
            A_ub=scipy.sparse.vstack([rows, -rows]),
            b_ub=np.ones(2 * rows.shape[0]),
            bounds=np.stack([np.zeros(len(joints)), ceiling], axis=1),
            method="highs",
        )
        rates = np.clip(found.x, 0.0, None)
        return self._time(rates) / self._scale, rates

    def _time(self, rates: np.ndarray) -> float:
        root = np.sqrt(rates)
        return float(np.sum(2.0 * self._lengths / np.maximum(root[1:] + root[:-1], 1e-9)))

    def _acceleration_rows(self, slope: np.ndarray, bend: np.ndarray) -> scipy.sparse.csr_matrix:
        """Rows |A b| <= 1 of the accelerations, joint by joint, of derivatives (K - 1, n)."""
        count = len(slope)
        blocks = []
        for j, limit in enumerate(self._acceleration):
            ramp, steady = 0.5 * slope[:, j] / self._lengths, 0.5 * bend[:, j]
            bands = [(steady - ramp) / limit, (steady + ramp) / limit]
            blocks.append(scipy.sparse.diags(bands, [0, 1], shape=(count, count + 1)))
        return scipy.sparse.vstack(blocks, format="csr")

    def rows(
        self, joints: np.ndarray, slopes: np.ndarray, detail: np.ndarray, squares: np.ndarray
    ) -> GoalRows:
        """Linearised limits of step and squared speed."""
        along, size = self._task.along, slopes.shape[2]
        rates, unit, count = detail, float(detail.max()), len(joints) - 1
        slope, bend, twist = path_derivatives(along, joints)
        moved = path_derivatives(along, slopes)
        own = 0.5 * (rates[1:] + rates[:-1])
        ramp = 0.5 * np.diff(rates) / self._lengths
        turned = moved[0] * ramp[:, None, None] + moved[1] * own[:, None, None]
        turned = (turned / self._acceleration[:, None]).swapaxes(0, 1).reshape(-1, size)
        by_rate = self._acceleration_rows(slope, bend)
        parts = [(sign * turned, sign * by_rate, sign * (by_rate @ rates)) for sign in (1.0, -1.0)]
        # |q'| sqrt(b) <= v as q'^2 b <= v^2, and |q'''| b^(3/2) <= J as its power of 2/3.
        mean = scipy.sparse.diags([0.5, 0.5], [0, 1], shape=(count, count + 1)).tocsr()
        for values, changes, limit, power in (
            (slope, moved[0], self._velocity, 2.0),
            (twist, moved[2], self._jerk, 2.0 / 3.0),
        ):
            share = (np.abs(values) / limit) ** power
            used = (share * own[:, None]).T.ravel()
            with np.errstate(divide="ignore", invalid="ignore"):
                factor = power * used / values.T.ravel()
            turned = factor[:, None] * changes.swapaxes(0, 1).reshape(-1, size)
            by_rate = scipy.sparse.vstack([mean.multiply(each[:, None]) for each in share.T])
            parts.append((turned, by_rate.tocsr(), used))
        near = [value > _NEAR_USE for _, _, value in parts]
        bound = np.concatenate(
            [1.0 - value[rows] for (_, _, value), rows in zip(parts, near, strict=True)]
        )
        root = np.sqrt(np.maximum(rates, 1e-12 * unit))
        pairs = self._lengths / (root[1:] + root[:-1]) ** 2
        slow = -(np.append(pairs, 0.0) + np.append(0.0, pairs)) / root
        slow[self._cap == 0.0] = 0.0
        return GoalRows(
            np.concatenate(
                [
                    np.hstack([turned[rows], unit * by_rate[rows].toarray()])
                    for (turned, by_rate, _), rows in zip(parts, near, strict=True)
                ]
            ),
            np.full(len(bound), -np.inf),
            bound,
            slow * unit / self._scale,
            -_SPEED_CHANGE * rates / unit,
            np.minimum(_SPEED_CHANGE * rates, np.maximum(self._cap - rates, 0.0)) / unit,
        )

    def value(self, detail: np.ndarray) -> float:
        """Return the time [s]."""
        return self._time(detail)


def _at_both_nodes(values: np.ndarray) -> np.ndarray:
    """Return at nodes (K,) the smaller of the values (K - 1,) of the steps beside them."""
    return np.asarray(np.minimum(np.append(values, np.inf), np.append(np.inf, values)))
