"""Coordinates of the optimisation: joints, links, or a path parameter on a fixed joint path."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import casadi as ca
import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.limit import Limits, derivative_bounds
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.symbolic import Quantity

# Angular frequency of the acceleration times the duration; scales the derivatives of the links.
_SCALE_FREQUENCY = 40.0
# Each knot is a term of every row of the programme.
_MAX_KNOTS = 260
# Joint travel that scales velocity and acceleration of slow motions [rad].
_SCALE_TRAVEL = 20.0


def coordinates_of(problem: TrajectoryProblem) -> Coordinates:
    """Return the coordinates of a problem."""
    if problem.path is not None:
        return PathCoordinates(problem)
    if problem.plans_links:
        return LinkCoordinates(problem)
    return JointCoordinates(problem)


class Coordinates(ABC):
    """Map between the states of the optimal-control problem and the motion of the joints."""

    size: int
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    state_scale: np.ndarray
    control_scale: np.ndarray

    @abstractmethod
    def joint_motion(self, x: Quantity, u: Quantity) -> tuple[Quantity, Quantity, Quantity]:
        """Position, velocity and acceleration of the joints (n,) at a state and control."""

    @abstractmethod
    def state_bounds(self, margins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the states."""

    @abstractmethod
    def control_bounds(self, margins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the controls."""

    @abstractmethod
    def rate_bounds(self, margins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the controls' rate."""

    @abstractmethod
    def boundary_states(self, motion: ResolvedMotion) -> tuple[np.ndarray, np.ndarray]:
        """States at the start and at the end."""

    @property
    def order(self) -> int:
        """Order of the derivative of the coordinates that is the control."""
        return len(self.state_names) // self.size

    @property
    def bounds_joints(self) -> bool:
        """True where joint limits are bounds of states and controls rather than path rows."""
        return type(self) is JointCoordinates


class JointCoordinates(Coordinates):
    """Joint positions and velocities as states, joint accelerations as controls."""

    def __init__(self, problem: TrajectoryProblem) -> None:
        self.problem = problem
        self.limits: Limits = problem.active_limits
        n = self.size = problem.joints
        self.state_names = tuple(
            f"{quantity} of joint {j + 1}"
            for quantity in ("position", "velocity")
            for j in range(n)
        )
        self.control_names = tuple(f"acceleration of joint {j + 1}" for j in range(n))
        duration = _typical_duration(problem.duration)
        speed = np.where(np.isfinite(self.limits.velocity), self.limits.velocity, 1.0)
        speed = np.minimum(speed, _SCALE_TRAVEL / duration)
        self.state_scale = np.concatenate([np.ones(n), speed])
        self.control_scale = np.where(
            np.isfinite(self.limits.acceleration),
            np.minimum(self.limits.acceleration, 6.0 * _SCALE_TRAVEL / duration**2),
            6.0 * speed / duration,
        )

    def joint_motion(self, x: Quantity, u: Quantity) -> tuple[Quantity, Quantity, Quantity]:
        """States and controls themselves."""
        return x[: self.size], x[self.size :], u

    def state_bounds(self, margins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Limits on position and velocity."""
        (low, high), (back, forth) = (derivative_bounds(self.limits, k, margins) for k in (0, 1))
        return np.concatenate([low, back]), np.concatenate([high, forth])

    def control_bounds(self, margins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Limits on acceleration."""
        return derivative_bounds(self.limits, 2, margins)

    def rate_bounds(self, margins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Limits on jerk."""
        return derivative_bounds(self.limits, 3, margins)

    def boundary_states(self, motion: ResolvedMotion) -> tuple[np.ndarray, np.ndarray]:
        """Resolved poses with the boundary velocities."""
        zero = np.zeros(self.size)
        start, end = self.problem.boundary_velocity or (zero, zero)
        return np.concatenate([motion.start, start]), np.concatenate([motion.end, end])


class LinkCoordinates(JointCoordinates):
    """Link motion up to its snap as states, its crackle as controls.

    The motors lead by the wind-up, a function of the links' acceleration, so that a motor's jerk
    depends on the links' fifth derivative. Motor limits are path rows; state bounds only keep
    positions within their range.
    """

    def __init__(self, problem: TrajectoryProblem) -> None:
        super().__init__(problem)
        n = self.size
        names = ("position", "velocity", "acceleration", "jerk", "snap")
        self.state_names = tuple(
            f"{quantity} of link {j + 1}" for quantity in names for j in range(n)
        )
        self.control_names = tuple(f"crackle of link {j + 1}" for j in range(n))
        rate = _SCALE_FREQUENCY / _typical_duration(problem.duration)
        scales = [self.control_scale * rate**k for k in range(4)]
        self.state_scale = np.concatenate([self.state_scale, *scales[:3]])
        self.control_scale = scales[3]

    def joint_motion(self, x: Quantity, u: Quantity) -> tuple[Quantity, Quantity, Quantity]:
        """First three derivatives of the links."""
        n = self.size
        return x[:n], x[n : 2 * n], x[2 * n : 3 * n]

    def state_bounds(self, margins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Limits on position."""
        low, high = derivative_bounds(self.limits, 0, margins)
        free = np.full(4 * self.size, np.inf)
        return np.concatenate([low, -free]), np.concatenate([high, free])

    def control_bounds(self, margins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Infinite bounds: motors are limited by path rows."""
        free = np.full(self.size, np.inf)
        return -free, free

    rate_bounds = control_bounds

    def boundary_states(self, motion: ResolvedMotion) -> tuple[np.ndarray, np.ndarray]:
        """Resolved poses with the boundary velocities and no residual vibration."""
        start, end = super().boundary_states(motion)
        rest = np.zeros(3 * self.size)
        return np.concatenate([start, rest]), np.concatenate([end, rest])


class PathCoordinates(Coordinates):
    """Path parameter s in [0, 1] on a not-a-knot cubic spline through given waypoints."""

    def __init__(self, problem: TrajectoryProblem) -> None:
        assert problem.path is not None
        self.problem = problem
        self.limits = problem.active_limits
        if problem.boundary_velocity is not None:
            raise ProblemError(
                "A motion on a fixed path starts and ends at rest; remove motion.boundary_velocity."
            )
        self.size = 1
        self.state_names = ("path position", "path speed")
        self.control_names = ("path acceleration",)
        duration = _typical_duration(problem.duration)
        self.state_scale = np.array([1.0, 1.0 / duration])
        self.control_scale = np.array([6.0 / duration**2])
        path = problem.path
        if len(path.knots) > _MAX_KNOTS or path.stops.size:
            raise ProblemError(
                f"On a path with {len(path.knots)} knots and {path.stops.size} stops only the "
                "duration is minimised: name it as the objective, or give a path with at most "
                f"{_MAX_KNOTS} knots and no stops."
            )
        # q(s) = sum_i polynomial[i] s^i + sum_j jumps[j] max(s - knots[j], 0)^3, smooth to order 2.
        self.knots = path.knots[1:-1]
        self.polynomial = path.coefficients[0]
        self.jumps = np.diff(path.coefficients[:, 3], axis=0)

    def joint_motion(self, x: Quantity, u: Quantity) -> tuple[Quantity, Quantity, Quantity]:
        """Chain rule along the spline."""
        s, speed, acceleration = x[0], x[1], u[0]
        position, tangent, curvature = (self._spline_derivative(s, order) for order in range(3))
        return (
            position,
            tangent * speed,
            tangent * acceleration + curvature * speed * speed,
        )

    def _spline_derivative(self, s: Quantity, order: int) -> Quantity:
        """Derivative of the spline with respect to s, in truncated powers (C2 in s)."""
        factor = {0: (1, 1, 1, 1), 1: (0, 1, 2, 3), 2: (0, 0, 2, 6)}[order]
        value: Quantity = 0.0
        for degree in range(order, 4):
            value = value + ca.DM(self.polynomial[degree] * factor[degree]) * s ** (degree - order)
        for knot, jump in zip(self.knots, self.jumps, strict=True):
            value = value + ca.DM(jump * factor[3]) * ca.fmax(s - knot, 0.0) ** (3 - order)
        return value

    def state_bounds(self, margins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the whole path, without reversal."""
        return np.array([0.0, 0.0]), np.array([1.0, np.inf])

    def control_bounds(self, margins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Infinite bounds: joint limits are path rows."""
        return np.array([-np.inf]), np.array([np.inf])

    rate_bounds = control_bounds

    def boundary_states(self, motion: ResolvedMotion) -> tuple[np.ndarray, np.ndarray]:
        """Rest at both ends of the path."""
        return np.array([0.0, 0.0]), np.array([1.0, 0.0])


def _typical_duration(duration: tuple[float, float]) -> float:
    """Duration for scales [s]: 1 s, clipped to the allowed range."""
    return float(np.clip(1.0, *duration))
