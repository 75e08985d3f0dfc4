"""Optimum of the freedom of a tool path, by sequential quadratic programming from a scan's best.

Unknowns are the placement, the coefficients of rotation and tilt, and those of joints beyond the
six that a pose fixes (a rail, a seventh axis). The other joints follow from the pose by Newton's
method, their derivatives by CasADi and the implicit function theorem. Every programme linearises
the goal at all nodes within a trust region; a step counts if the cost itself falls.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import casadi as ca
import numpy as np
import scipy

from stiffopt.errors import ProblemError
from stiffopt.problem.freedom_goals import DeflectionGoal, FreedomGoal, TimeGoal
from stiffopt.problem.freedom_scan import PathCandidate, refine_candidate, scan_candidates
from stiffopt.problem.freedom_task import POSE_JOINTS, FreedomTask
from stiffopt.problem.path_freedom import FreedomChoice, TurnBasis
from stiffopt.problem.pose_following import MIN_CONDITION

# Weight of the squared second differences of coefficients [1/rad^2]: below 0.1 % of the cost.
_ROUGHNESS_WEIGHT = 1e-4
# Trust region: first and smallest half-width [rad], factors after success and failure; steps.
_FIRST_STEP, _SMALLEST_STEP, _STEP_GROWTH, _STEP_SHRINKAGE, _MAX_STEPS = 0.15, 5e-4, 2.0, 0.35, 60
# Directions in which a cone of tilt is bounded: by a polygon inside it, 0.5 % smaller.
_CONE_SIDES = 32
# Least ratio of the singular values of a pose's Jacobian that a step may go to: a singular pose
# ends the region of a posture, and the path must not come near it.
_LEAST_CONDITION = 5.0 * MIN_CONDITION
# Excess of a holding torque from which it bounds a step: rows far below would only slow it.
_NEAR_EXCESS = -0.3


@dataclass(frozen=True, eq=False)
class FreedomOptimum:
    """Chosen freedom with its cost, and what it is compared with."""

    choice: FreedomChoice
    cost: float  # of the goal, less is better
    value: float  # largest deflection at the nodes [m], or estimated time [s]
    joints: np.ndarray  # (K, n) at the nodes [rad]

    @classmethod
    def at(
        cls,
        task: FreedomTask,
        placement: np.ndarray,
        turns: np.ndarray,
        joints: np.ndarray,
        cost: float,
        value: float,
    ) -> FreedomOptimum:
        """Return the optimum of its unknowns at the nodes of a task."""
        spline = scipy.interpolate.CubicSpline(task.along, joints)
        choice = FreedomChoice(
            task.origin, placement, task.basis, turns, lambda along: np.asarray(spline(along))
        )
        return cls(choice, cost, value, joints)


def optimise_freedom(task: FreedomTask, near: np.ndarray) -> list[FreedomOptimum]:
    """Return local optima of a path's freedom, the best first.

    Raises `ProblemError`: no candidate of the scan follows the path.
    """
    # Searches from different candidates.
    candidates = scan_candidates(task, near, 12)
    refined = [each for each in (refine_candidate(task, one) for one in candidates) if each]
    scale = min(refined, key=lambda each: each.rank).cost if refined else 1.0
    kind = DeflectionGoal if task.minimises_error else TimeGoal
    goal: FreedomGoal = kind(task, scale)
    searched = (_Search(task, goal, each).optimum() for each in refined)
    found = [each for each in searched if each is not None]
    if not found:
        raise ProblemError(
            "path.freedom: in no posture, rotation, tilt and placement that it allows does the arm "
            "follow the whole path. Allow more of them, or move the path."
        )
    return sorted(found, key=lambda each: each.cost)


class _Search:
    """Search from one candidate.

    The unknowns are linear in the parameters of each node: placement (6,), turns (3,) and joints
    beyond six, `values = constant + matrix y`.
    """

    def __init__(self, task: FreedomTask, goal: FreedomGoal, candidate: PathCandidate) -> None:
        self._task, self._goal = task, goal
        freedom, count = task.freedom, len(task.along)
        self._free = _free_joints(task, candidate)
        self._held = np.isin(np.arange(task.robot.n), self._free)
        self._data = task.node_data(task.along)
        # Joints beyond six always vary along the path.
        self._extra = TurnBasis.splines(task.path.length)
        turned = [freedom.tool_axis_rotation > 0.0, freedom.tilt > 0.0, freedom.tilt > 0.0]
        shifted = np.flatnonzero(freedom.placement > 0.0)
        parameters = 9 + len(self._free)
        blocks: list[np.ndarray] = []
        starts: list[np.ndarray] = []
        self._rough: list[slice] = []
        self._turn_slices: dict[int, slice] = {}
        size = 0
        for j in shifted:
            block = np.zeros((count, parameters, 1))
            block[:, j, 0] = 1.0
            blocks.append(block)
            starts.append(candidate.placement[[j]])
            size += 1
        self._shifted = shifted
        splines = [(6 + j, task.basis, candidate.turns[j]) for j in range(3) if turned[j]]
        splines += [(9 + i, self._extra, candidate.joints[:, j]) for i, j in enumerate(self._free)]
        for row, basis, value in splines:
            values = basis.matrix(task.along)
            block = np.zeros((count, parameters, basis.size))
            block[:, row] = values
            blocks.append(block)
            fitted = np.linalg.lstsq(values, np.broadcast_to(value, count), rcond=None)[0]
            starts.append(fitted)
            self._rough.append(slice(size, size + basis.size))
            if row < 9:
                self._turn_slices[row - 6] = self._rough[-1]
            size += basis.size
        self._matrix = np.concatenate([*blocks, np.zeros((count, parameters, 0))], axis=2)
        self._start = np.concatenate([*starts, np.zeros(0)])
        self._joints = candidate.joints

    def optimum(self) -> FreedomOptimum | None:
        """Return the optimum that the search ends at.

        None where the splines of joints beyond six do not pass through the candidate's poses, as
        with another joint at its limit.
        """
        y, radius = self._start, _FIRST_STEP
        state = self._evaluate(y, self._joints)
        if state is None:
            return None
        for _ in range(_MAX_STEPS):
            if radius < _SMALLEST_STEP or not len(y):
                break
            joints, cost, detail = state
            step = self._proposal(y, joints, detail, radius)
            trial = None if step is None else self._evaluate(y + step, joints)
            if (
                step is not None
                and trial is not None
                and self._merit(y + step, trial[1]) < (self._merit(y, cost) * (1.0 - 1e-6))
            ):
                y, state, radius = y + step, trial, min(radius * _STEP_GROWTH, _FIRST_STEP)
            else:
                radius *= _STEP_SHRINKAGE
        return self._result(y, state)

    def _merit(self, y: np.ndarray, cost: float) -> float:
        """Cost with the roughness of the splines."""
        rough = sum(float(np.sum(np.diff(y[own], 2) ** 2)) for own in self._rough)
        return cost * (1.0 + _ROUGHNESS_WEIGHT * rough)

    def _parameters(self, y: np.ndarray) -> np.ndarray:
        return np.asarray((self._matrix @ y).T)

    def _evaluate(
        self, y: np.ndarray, guess: np.ndarray
    ) -> tuple[np.ndarray, float, np.ndarray] | None:
        """Joint positions (K, n), cost, and detail of the goal; None where no pose is reached."""
        values = self._parameters(y)
        guess = guess.copy()
        guess[:, self._free] = values[9:].T
        task = self._task
        joints, found = task.solve_poses(guess, values[:6], values[6:9], self._data, self._held)
        if not found.all():
            return None
        cost, detail = self._goal.evaluate(joints, values[:6], values[6:9], self._data)
        return joints, cost, detail

    def _proposal(
        self, y: np.ndarray, joints: np.ndarray, detail: np.ndarray, radius: float
    ) -> np.ndarray | None:
        """Step of the quadratic programme within a trust region."""
        task, values, size = self._task, self._parameters(y), len(y)
        by_joints, by_parameters, moved, turned = self._derivatives(joints, values)
        slopes = np.zeros((len(joints), task.robot.n, size))
        own = ~self._held
        wanted = by_parameters @ self._matrix[:, :9]
        wanted += by_joints[:, :, self._held] @ self._matrix[:, 9:]
        slopes[:, own] = -np.linalg.solve(by_joints[:, :, own], wanted)
        slopes[:, self._held] = self._matrix[:, 9:]
        squares = np.einsum("kn,kny->ky", moved, slopes)
        squares += np.einsum("kp,kpy->ky", turned, self._matrix[:, :9])
        rows = self._goal.rows(joints, slopes, detail, squares)
        rows = rows.with_excess(*self._hold_rows(joints, values[:6], slopes))
        extra = rows.extra
        curvature = np.zeros((size + extra, size + extra))
        # Curvature of the programme that keeps unknowns without effect where they are.
        curvature[:size, :size] = 1e-4 * np.eye(size)
        gradient = np.concatenate([np.zeros(size), rows.gradient])
        for part in self._rough:
            bend = np.diff(np.eye(part.stop - part.start), 2, axis=0)
            curvature[part, part] += 2.0 * _ROUGHNESS_WEIGHT * bend.T @ bend
            gradient[part] += 2.0 * _ROUGHNESS_WEIGHT * bend.T @ (bend @ y[part])
        curvature[size:, size:] += 1e-6 * np.eye(extra)
        lower, upper = self._step_bounds(y, radius)
        matrix, low, high = rows.with_rows(*self._posture_rows(joints, slopes, radius))
        cone, allowed = self._cone_rows(y)
        matrix = np.vstack([matrix, np.hstack([cone, np.zeros((len(cone), extra))])])
        low, high = np.append(low, np.full(len(cone), -np.inf)), np.append(high, allowed)
        quadratic, linear = (ca.DM(scipy.sparse.csc_matrix(each)) for each in (curvature, matrix))
        shapes = {"h": quadratic.sparsity(), "a": linear.sparsity()}
        solver = ca.conic("step", "piqp", shapes, {"error_on_fail": False})
        found = solver(
            h=quadratic,
            g=gradient,
            a=linear,
            lba=low,
            uba=high,
            lbx=np.concatenate([lower, rows.lower]),
            ubx=np.concatenate([upper, rows.upper]),
        )
        if not solver.stats()["success"]:
            return None
        return np.asarray(np.clip(np.asarray(found["x"]).ravel()[:size], lower, upper))

    def _derivatives(self, joints: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """Jacobians of the residual by joints and parameters, gradients of the squared error."""
        count, n = joints.shape
        found = self._task.derivatives.map(count)(joints.T, values[:6], values[6:9], self._data)
        by_joints, by_parameters, moved, turned = (np.asarray(each) for each in found)
        return (
            by_joints.reshape(6, count, n).transpose(1, 0, 2),
            by_parameters.reshape(6, count, 9).transpose(1, 0, 2),
            moved.reshape(count, n),
            turned.reshape(count, 9),
        )

    def _step_bounds(self, y: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
        freedom = self._task.freedom
        half = np.full(len(y), np.inf)
        reach = np.full(len(y), radius)
        shifts = freedom.placement[self._shifted]
        half[: len(shifts)] = shifts
        # A placement may cross a third of its box at once.
        reach[: len(shifts)] = shifts * radius / (3.0 * _FIRST_STEP)
        if 0 in self._turn_slices and not freedom.rotates_freely:
            half[self._turn_slices[0]] = freedom.tool_axis_rotation
        return np.maximum(-reach, np.minimum(-half - y, 0.0)), np.minimum(
            reach, np.maximum(half - y, 0.0)
        )

    def _cone_rows(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows that keep each pair of tilt coefficients, and so their splines, in the cone."""
        if 1 not in self._turn_slices:
            return np.zeros((0, len(y))), np.zeros(0)
        first, second = self._turn_slices[1], self._turn_slices[2]
        count = first.stop - first.start
        rows, bounds = [], []
        for angle in 2.0 * np.pi * np.arange(_CONE_SIDES) / _CONE_SIDES:
            row = np.zeros((count, len(y)))
            row[:, first], row[:, second] = (
                np.cos(angle) * np.eye(count),
                np.sin(angle) * np.eye(count),
            )
            rows.append(row)
            bounds.append(self._task.freedom.tilt * np.cos(np.pi / _CONE_SIDES) - row @ y)
        return np.concatenate(rows), np.concatenate(bounds)

    def _posture_rows(
        self, joints: np.ndarray, slopes: np.ndarray, radius: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of the joints' positions, and of the distance from singular poses."""
        # A joint turns by about the square of a step more than its slope says: room for that.
        room = radius**2
        lower, upper = self._task.position_range
        low = np.minimum(lower + room - joints, 0.0).ravel()
        high = np.maximum(upper - room - joints, 0.0).ravel()
        near = np.minimum(-low, high) < 1.0
        least, largest, slope = self._task.singular_values(joints, self._held)
        regular = np.einsum("kn,kny->ky", slope, slopes)
        return (
            np.vstack([slopes.reshape(-1, slopes.shape[2])[near], regular]),
            np.append(low[near], np.minimum(_LEAST_CONDITION * largest - least, 0.0)),
            np.append(high[near], np.full(len(least), np.inf)),
        )

    def _hold_rows(
        self, joints: np.ndarray, placement: np.ndarray, slopes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes (R, Y) with the step, and excess (R,) of torques at rest near their limits."""
        task, (count, n) = self._task, joints.shape
        found = task.hold_derivatives.map(count)(joints.T, placement, self._data)
        by_joints, by_placement = (
            np.asarray(each).reshape(2 * n, count, -1).transpose(1, 0, 2) for each in found
        )
        changes = by_joints @ slopes + by_placement @ self._matrix[:, :6]
        excess = task.hold_excess(joints, placement, self._data)
        near = excess > _NEAR_EXCESS
        return changes[near], excess[near]

    def _result(self, y: np.ndarray, state: tuple[np.ndarray, float, np.ndarray]) -> FreedomOptimum:
        task, (joints, cost, detail) = self._task, state
        turns = np.zeros((task.basis.size, 3))
        for j, own in self._turn_slices.items():
            turns[:, j] = y[own]
        placement = np.zeros(6)
        placement[self._shifted] = y[: len(self._shifted)]
        value = self._goal.value(detail)
        return FreedomOptimum.at(task, placement, turns, joints, cost, value)


def _free_joints(task: FreedomTask, candidate: PathCandidate) -> np.ndarray:
    """Return the joints beyond six whose motion is free, so that the others fix the pose best."""
    n = task.robot.n
    if n <= POSE_JOINTS:
        return np.zeros(0, dtype=int)
    count = len(candidate.joints)
    placement, turns = (
        np.repeat(each[:, None], count, axis=1) for each in (candidate.placement, candidate.turns)
    )
    _, jacobian = task.linearised_pose.map(count)(
        candidate.joints.T, placement, turns, task.node_data(task.along)
    )
    whole = np.asarray(jacobian).reshape(6, count, n).transpose(1, 0, 2)

    def worst(free: tuple[int, ...]) -> float:
        kept = np.delete(whole, free, axis=2)
        return float(np.linalg.svd(kept, compute_uv=False)[:, -1].min())

    return np.array(max(combinations(range(n), n - POSE_JOINTS), key=worst))
