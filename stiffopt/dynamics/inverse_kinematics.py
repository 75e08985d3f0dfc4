"""Inverse kinematics: joint angles of a tool pose, within the joint limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.robot.frames import rotation_vector

if TYPE_CHECKING:
    from stiffopt.robot.frames import LinkFrame
    from stiffopt.robot.rigid_body import RigidBodies
    from stiffopt.robot.robot import Robot

# An angle error of 1 rad weighs as much as this distance: about the reach of a wrist. [m]
LENGTH_PER_RADIAN = 0.3
# Of one descent; further random starts are worth more than longer descents.
_MAX_GAUSS_NEWTON_STEPS = 200


class UnreachablePoseError(ProblemError):
    """No joint angles within the limits reach the tool pose.

    `distance`: smallest distance reached [m]. `angle`: angle error there, where an orientation was
    given [rad]. `joints` (n,): joint angles there. `limits`: the joint limits that stop the search,
    in words, by joint number from 0.
    """

    def __init__(
        self,
        message: str,
        distance: float,
        angle: float | None,
        joints: np.ndarray,
        limits: dict[int, str],
    ) -> None:
        self.distance, self.angle, self.joints, self.limits = distance, angle, joints, limits
        super().__init__(message)


def solve_pose(
    robot: Robot,
    position: object,
    rotation: object = None,
    near: object = None,
    *,
    seed: int = 1,
    restarts: int = 60,
    tolerance: float = 1e-10,
) -> np.ndarray:
    """Return joint angles (n,) of a tool pose, or of a position of the tool point.

    Damped Gauss-Newton steps from `near` (default the middle of the ranges), kept inside the joint
    limits; where they do not converge, from `restarts` seeded random angles as well, and the
    solution closest to `near` is returned. `tolerance` is of the pose: [m], and 0.3 m a radian.
    Raises `UnreachablePoseError` with the smallest distance and the active joint limits,
    `ProblemError` for poses that are not finite or have the wrong shape.
    """
    search = _Search.of(robot, position, rotation)
    middle = 0.5 * (search.lower + search.upper)
    start = middle if near is None else _as_vector(near, len(middle), "near")
    start = np.clip(start, search.lower, search.upper)
    best, error = search.descend(start, tolerance)
    if error <= tolerance:
        return search.nearest_turns(best, start)
    rng = np.random.default_rng(seed)
    found: list[np.ndarray] = []
    for _ in range(restarts):
        angles, left = search.descend(rng.uniform(search.lower, search.upper), tolerance)
        if left <= tolerance:
            found.append(search.nearest_turns(angles, start))
        elif left < error:
            best, error = angles, left
        # Eight suffice: each start ends in one of few branches.
        if len(found) == 8:
            break
    if found:
        return min(found, key=lambda q: float(np.linalg.norm(q - start)))
    raise _unreachable_error(robot, search, best)


@dataclass(frozen=True)
class _Search:
    """Arm, target pose and joint ranges of one search."""

    bodies: RigidBodies
    tool: LinkFrame
    position: np.ndarray
    rotation: np.ndarray | None
    lower: np.ndarray
    upper: np.ndarray
    turning: np.ndarray

    @classmethod
    def of(cls, robot: Robot, position: object, rotation: object) -> _Search:
        turning = ~robot.prismatic
        # A joint without limits is searched over one turn either way, a slide over 10 m.
        span = np.where(turning, 2.0 * np.pi, 10.0)
        return cls(
            robot.rigid_bodies(),
            robot.tool,
            _as_vector(position, 3, "position"),
            None if rotation is None else _as_vector(rotation, 9, "rotation").reshape(3, 3),
            np.where(np.isfinite(robot.position_lower), robot.position_lower, -span),
            np.where(np.isfinite(robot.position_upper), robot.position_upper, span),
            turning,
        )

    def error(self, q: np.ndarray) -> np.ndarray:
        """Return the position error [m] and, with an orientation, the angle error times 0.3 m."""
        position, rotation = self.bodies.pose(self.tool, q)
        left = self.position - position
        if self.rotation is None:
            return np.asarray(left)
        turn = rotation_vector(self.rotation @ rotation.T)
        return np.concatenate([left, LENGTH_PER_RADIAN * turn])

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return the Jacobian of the pose, weighted as the error."""
        full = self.bodies.jacobian(self.tool, q)
        if self.rotation is None:
            return np.asarray(full[:3])
        return np.vstack([full[:3], LENGTH_PER_RADIAN * full[3:]])

    def descend(self, start: np.ndarray, tolerance: float) -> tuple[np.ndarray, float]:
        """Return angles and norm of the error at the end of the iteration from `start`."""
        q, damping = start.copy(), 1e-3
        error = self.error(q)
        size = float(np.linalg.norm(error))
        for _ in range(_MAX_GAUSS_NEWTON_STEPS):
            if size <= tolerance or damping > 1e8:
                break
            step = self._damped_step(q, self.jacobian(q), error, damping)
            trial = np.clip(q + step, self.lower, self.upper)
            trial_error = self.error(trial)
            trial_size = float(np.linalg.norm(trial_error))
            if trial_size < size:
                stalled = size - trial_size < 1e-9 * size
                q, error, size, damping = trial, trial_error, trial_size, damping * 0.2
                if stalled:
                    break
            else:
                damping = max(damping, 1e-9) * 5.0
        return q, size

    def _damped_step(
        self, q: np.ndarray, jacobian: np.ndarray, error: np.ndarray, damping: float
    ) -> np.ndarray:
        """Return a damped step with joints fixed whose limit it would exceed."""
        pull = jacobian.T @ error
        free = np.flatnonzero(~self._blocked_by_limits(q, pull))
        step = np.zeros_like(q)
        if free.size:
            part = jacobian[:, free]
            # The small side of the normal equations: 3 or 6 rows.
            gram = part @ part.T
            # The floor keeps singular poses solvable; its share of a step is below rounding.
            floor = 1e-12 * (float(np.trace(gram)) + LENGTH_PER_RADIAN**2)
            gram += (damping * float(error @ error) + floor) * np.eye(len(error))
            step[free] = part.T @ np.linalg.solve(gram, error)
        largest = float(np.max(np.abs(step)))
        return step if largest <= 0.5 else step * (0.5 / largest)

    def _blocked_by_limits(self, q: np.ndarray, pull: np.ndarray) -> np.ndarray:
        return np.asarray(((q <= self.lower) & (pull < 0)) | ((q >= self.upper) & (pull > 0)))

    def limiting_joints(self, q: np.ndarray) -> np.ndarray:
        """Return the joints whose limit stops the search."""
        jacobian, error = self.jacobian(q), self.error(q)
        pull = jacobian.T @ error
        # Joints without effect, as of a stretched arm, must not be listed because of rounding.
        strong = np.abs(pull) > 1e-3 * np.linalg.norm(jacobian, axis=0) * np.linalg.norm(error)
        return np.flatnonzero(self._blocked_by_limits(q, pull) & strong)

    def nearest_turns(self, q: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Move each angle by full turns towards `near`, inside the limits: the same pose."""
        turns = np.where(self.turning, np.round((near - q) / (2.0 * np.pi)), 0.0)
        moved = q + 2.0 * np.pi * turns
        inside = (moved >= self.lower) & (moved <= self.upper)
        return np.where(inside, moved, q)

    def left(self, q: np.ndarray) -> tuple[float, float | None]:
        """Return the distance [m] and angle [rad] to the target at `q`."""
        error = self.error(q)
        angle = (
            None if self.rotation is None else float(np.linalg.norm(error[3:])) / LENGTH_PER_RADIAN
        )
        return float(np.linalg.norm(error[:3])), angle


def _as_vector(value: object, size: int, name: str) -> np.ndarray:
    array = np.asarray(value, dtype=float).reshape(-1)
    if array.size != size or not np.all(np.isfinite(array)):
        raise ProblemError(f"{name} must hold {size} finite numbers, got {value!r}.")
    return array


def _unreachable_error(robot: Robot, search: _Search, q: np.ndarray) -> UnreachablePoseError:
    distance, angle = search.left(q)
    place = ", ".join(f"{x:.4g}" for x in search.position)
    reached = f"{1000 * distance:.4g} mm away"
    if angle is not None:
        reached += f" and turned by {np.degrees(angle):.3g} deg"
    stops = {
        int(j): f"{robot.joint_names[j]} at its {side} limit {q[j]:.4g}"
        for j in search.limiting_joints(q)
        for side in ("lower" if q[j] <= search.lower[j] else "upper",)
    }
    cause = (
        f"Stopped by {', '.join(stops.values())}."
        if stops
        else "No joint limit is active: the target lies outside the reach of the links."
    )
    step = "Move the target, or start the search elsewhere by `near`."
    if angle is not None and replace(search, rotation=None).descend(q, 1e-6)[1] <= 1e-6:
        step = "The position alone can be reached: change the orientation, or leave it free."
    return UnreachablePoseError(
        f"the tool of {robot.name} cannot reach position [{place}] m"
        f"{' in the given orientation' if angle is not None else ''}: the closest pose found is "
        f"{reached}. {cause} {step}",
        distance,
        angle,
        q,
        stops,
    )
