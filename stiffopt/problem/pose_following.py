"""Joint positions along a path of tool poses, in one posture, and splines through them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy

from stiffopt.dynamics.inverse_kinematics import (
    LENGTH_PER_RADIAN,
    UnreachablePoseError,
    solve_pose,
)
from stiffopt.errors import ProblemError
from stiffopt.result.joint_path import JointPath
from stiffopt.robot.batched_kinematics import frame_positions, frame_rotations
from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.rigid_body import RigidBodies
from stiffopt.robot.robot import Robot

# Steps within each piece of a path.
_STEPS_PER_PIECE = 4
# Larger joint steps between neighbouring poses are a change of posture [rad].
_MAX_JOINT_STEP = 0.6
# Least ratio of the singular values of the Jacobian, its rotations times a length [m/rad]: below,
# the joints turn faster than the tool by more than its inverse.
MIN_CONDITION = 2e-3

Poses = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


class PathEndsError(ProblemError):
    """A posture does not follow a path to its end.

    `place`: where it ends [m]. `start` (n,): joint positions at the start of the path. `limited`:
    numbers from 0 of joints whose limits end it, none where it is singular. `cause`: in words.
    """

    def __init__(
        self, place: float, start: np.ndarray, cause: str, limited: Sequence[int] = ()
    ) -> None:
        self.place, self.start, self.cause, self.limited = place, start, cause, list(limited)
        super().__init__(
            f"path, {place:.3f} m from its start: {cause} Choose another posture by path.near, or "
            "another path."
        )


class PoseFollower:
    """Inverse kinematics at any distance along a path, close to poses solved step by step.

    `poses`: positions (K, 3) [m] and rotations (K, 3, 3) at distances (K,) [m]. `breaks` (m,):
    distances at which pieces of the path meet, 0 and its length among them [m]. `near` (n,) or
    callable: selects the solution at the start, or at each distance [m]. Raises `ProblemError`: the
    start is out of reach; `PathEndsError`: the posture ends before the path does.
    """

    def __init__(
        self,
        robot: Robot,
        poses: Poses,
        breaks: np.ndarray,
        near: np.ndarray | Callable[[float], np.ndarray],
    ) -> None:
        self._robot, self._poses = robot, poses
        shares = np.arange(_STEPS_PER_PIECE) / _STEPS_PER_PIECE
        inside = (breaks[:-1, None] + np.diff(breaks)[:, None] * shares).ravel()
        # Longest step along the path [m], least and largest number of steps.
        steps = int(np.clip(breaks[-1] / 5e-3, 400, 4000))
        self._along = np.union1d(inside, np.linspace(0.0, breaks[-1], steps + 1))
        positions, rotations = poses(self._along)
        found: list[np.ndarray] = []
        inverses = []
        bodies = robot.rigid_bodies()
        for place, position, rotation in zip(self._along, positions, rotations, strict=True):
            before = found[-1] if found else None
            guess = near(float(place)) if callable(near) else near if before is None else before
            # No restarts after the first pose: they could change the posture.
            restarts = 0 if found else 60
            try:
                q = np.asarray(solve_pose(robot, position, rotation, guess, restarts=restarts))
            except UnreachablePoseError as error:
                if not found:
                    raise ProblemError(f"path, {place:.3f} m from its start: {error}") from error
                cause = _describe_end(robot, position, rotation, error)
                raise PathEndsError(place, found[0], cause, [*error.limits]) from error
            jacobian = _weighted_jacobian(bodies, robot.tool, q)
            cause = _describe_singularity(q, q if before is None else before, jacobian)
            if cause:
                raise PathEndsError(place, found[0] if found else q, cause)
            found.append(q)
            inverses.append(np.linalg.pinv(jacobian))
        self._joints, self._inverses = np.stack(found), np.stack(inverses)

    def __call__(self, along: np.ndarray) -> np.ndarray:
        """Joint positions (K, n) at distances (K,) [m]."""
        q = np.stack([np.interp(along, self._along, column) for column in self._joints.T], axis=1)
        nearest = np.clip(np.searchsorted(self._along, along), 1, len(self._along) - 1)
        nearest -= along - self._along[nearest - 1] < self._along[nearest] - along
        inverse = self._inverses[nearest]
        positions, rotations = self._poses(along)
        for _ in range(25):
            error = self._pose_errors(q, positions, rotations)
            q = q + np.einsum("kij,kj->ki", inverse, error)
            # With the Jacobian of the nearest step; an error of 1e-11 m is rounding.
            if np.abs(error).max() <= 1e-11:
                break
        return q

    def errors(self, q: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance [m] and angle [rad] (K,) of joint positions (K, n) from the path's poses."""
        error = self._pose_errors(q, *self._poses(along))
        return (
            np.linalg.norm(error[:, :3], axis=1),
            np.linalg.norm(error[:, 3:], axis=1) / LENGTH_PER_RADIAN,
        )

    def _pose_errors(
        self, q: np.ndarray, positions: np.ndarray, rotations: np.ndarray
    ) -> np.ndarray:
        tree, tool = self._robot.tree, self._robot.tool
        axes = frame_rotations(tree, tool, q)
        turn = scipy.spatial.transform.Rotation.from_matrix(
            rotations @ axes.swapaxes(1, 2)
        ).as_rotvec()
        left = positions - frame_positions(tree, tool, q)
        return np.hstack([left, LENGTH_PER_RADIAN * turn])


def _weighted_jacobian(bodies: RigidBodies, tool: LinkFrame, q: np.ndarray) -> np.ndarray:
    """Return the Jacobian of the tool (6, n), its rotations times a length [m/rad]."""
    jacobian = np.array(bodies.jacobian(tool, q))
    jacobian[3:] *= LENGTH_PER_RADIAN
    return jacobian


def _describe_singularity(q: np.ndarray, before: np.ndarray, jacobian: np.ndarray) -> str:
    """Return what is singular at a step of a path, "" where nothing is."""
    step = np.abs(q - before)
    j = int(np.argmax(step))
    if step[j] > _MAX_JOINT_STEP:
        return (
            f"joint {j + 1} would turn by {np.degrees(step[j]):.0f} deg in one step, through a "
            "singular pose."
        )
    values = np.linalg.svd(jacobian, compute_uv=False)
    if values[-1] < MIN_CONDITION * values[0]:
        return f"the pose is singular, {_turning_joints(jacobian)} would turn at any speed."
    return ""


def _turning_joints(jacobian: np.ndarray) -> str:
    """Return the joints that move the tool least, as of a singular pose."""
    turning = np.abs(np.linalg.svd(jacobian)[2][min(jacobian.shape) - 1])
    # Least share of a joint that takes part, of the largest.
    taking_part = np.flatnonzero(turning > 0.5 * turning.max())
    return f"joint{'s' * (len(taking_part) > 1)} {' and '.join(str(k + 1) for k in taking_part)}"


def _describe_end(
    robot: Robot, position: np.ndarray, rotation: np.ndarray, error: UnreachablePoseError
) -> str:
    """Return why a posture does not reach a pose from the step before."""
    if error.limits:
        return f"stopped by {', '.join(error.limits.values())}."
    try:
        solve_pose(robot, position, rotation, error.joints)
    except UnreachablePoseError:
        return str(error)
    jacobian = _weighted_jacobian(robot.rigid_bodies(), robot.tool, error.joints)
    return (
        f"the posture ends in a singular pose, where {_turning_joints(jacobian)} would turn at any "
        "speed; the tool is within reach in another posture."
    )


# Shares of the interval between two knots at which the error is measured.
_CHECKED_SHARES = (0.25, 0.5, 0.75)
MAX_KNOTS = 30_000

Curve = Callable[[np.ndarray], np.ndarray]


def fit_joint_path(
    curve: Curve,
    breaks: np.ndarray,
    error: Callable[[np.ndarray, np.ndarray], np.ndarray],
    tolerance: float,
) -> tuple[JointPath, float]:
    """Fit a cubic spline to a curve; knots are inserted where its error exceeds the tolerance.

    `curve` gives joint positions (K, n) at parameters (K,) from 0 to 1, with knots at `breaks`;
    `error` (K,) is that of joint positions which stand for it. Returns the path and its largest
    error; raises `ProblemError` where more than `MAX_KNOTS` knots would be needed.
    """
    # Intervals of a piece in the first round.
    steps = np.linspace(0.0, 1.0, 4, endpoint=False)
    knots = np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * steps).ravel(), breaks[-1])
    points = curve(knots)
    for _ in range(40):
        path, span = JointPath.at_knots(knots, points), np.diff(knots)
        at = (knots[:-1, None] + span[:, None] * np.array(_CHECKED_SHARES)).ravel()
        worst = error(path(at), at).reshape(len(span), -1).max(axis=1)
        wide = worst > tolerance
        if not wide.any():
            return path, float(worst.max())
        # Halved, an interval must not be far shorter than its neighbours.
        least = np.where(wide, 0.5 * span, span)
        near = np.minimum(np.append(least[1:], np.inf), np.append(np.inf, least[:-1]))
        # Largest ratio of neighbouring intervals: a spline oscillates between very uneven ones.
        wide |= span > 8.0 * near
        new = 0.5 * (knots[:-1] + knots[1:])[wide]
        if len(knots) + len(new) > MAX_KNOTS:
            break
        order = np.argsort(np.concatenate([knots, new]), kind="stable")
        points = np.concatenate([points, curve(new)])[order]
        knots = np.concatenate([knots, new])[order]
    raise ProblemError(
        f"a joint spline with {len(knots)} knots follows the path within {worst.max():.3g} only; "
        f"asked is {tolerance:.3g}. Give a larger tolerance, or smooth the path."
    )
