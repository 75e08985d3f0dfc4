"""Poses of an arm along a motion: joint positions, wind-up, and shares in the deflection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.certificate.assess import joint_windup
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.robot.batched_kinematics import tool_jacobians
from stiffopt.robot.robot import Robot

FRAMES = 121


@dataclass(frozen=True)
class Poses:
    """A motion at K instants."""

    time: np.ndarray  # (K,) [s]
    position: np.ndarray  # (K, n) planned joint positions [rad]
    # (K, n) wind-up of each joint [rad] by part of the deflection; the bent arm is at position -
    # bend.
    bend: dict[str, np.ndarray]
    # (K, n) share of each joint in the tool's deflection by part: projection of its contribution on
    # the whole deflection, over the whole; the shares of an instant add up to 1.
    share: dict[str, np.ndarray]
    deflection: dict[str, np.ndarray]  # (K,) deflection of the tool by part [m]

    @classmethod
    def bent(
        cls,
        robot: Robot,
        time: np.ndarray,
        position: np.ndarray,
        bend: dict[str, np.ndarray],
        deflection: dict[str, np.ndarray] | None = None,
    ) -> Poses:
        """Poses with the shares, and the deflections where none are given, of wind-ups."""
        jacobian = tool_jacobians(robot.tree, robot.tool, position)[1]
        moved = {part: np.einsum("kin,kn->ki", jacobian, each) for part, each in bend.items()}
        sizes = {part: np.linalg.norm(each, axis=1) for part, each in moved.items()}
        shares = {part: joint_shares(jacobian, each) for part, each in bend.items()}
        return cls(time, position, bend, shares, sizes if deflection is None else deflection)


def poses_along(problem: TrajectoryProblem, motion: Assessment) -> Poses:
    """Return poses at equal time steps and at the instants of the largest deflections.

    Parts of the deflection that are zero throughout, or infinite where a connection slips, are
    omitted.
    """
    robot = problem.robot
    wanted = np.linspace(0.0, motion.duration, FRAMES)
    chosen = {int(k) for k in np.searchsorted(motion.time, wanted)}
    sizes = {part: np.linalg.norm(each, axis=1) for part, each in motion.deflection.items()}
    parts = [part for part, size in sizes.items() if np.isfinite(size).all() and np.any(size > 0)]
    chosen |= {int(np.argmax(sizes[part])) for part in parts}
    at = np.array(sorted(k for k in chosen if k < len(motion.time)))
    position = motion.position[at]
    bodies = robot.rigid_bodies()
    jacobian = tool_jacobians(robot.tree, robot.tool, position)[1]
    process = np.einsum("kij,i->kj", jacobian, np.asarray(problem.process_force, dtype=float))
    total = motion.windup[at]
    static = joint_windup(robot, np.array([bodies.gravity_torque(q) for q in position]))
    link = joint_windup(robot, motion.spring_torque[at] + process) if process.any() else total
    # Where a connection slips, differences of infinite wind-ups are nan and omitted below.
    with np.errstate(invalid="ignore"):
        process_bend, dynamic = total - link, link - static
    bends = {"total": total, "static": static, "process": process_bend, "dynamic": dynamic}
    return Poses.bent(
        robot,
        motion.time[at],
        position,
        {part: bends[part] for part in parts},
        {part: sizes[part][at] for part in parts},
    )


def stored_poses(
    robot: Robot,
    time: np.ndarray,
    position: np.ndarray,
    windup: np.ndarray | None = None,
) -> Poses:
    """Return poses of a stored motion at equal time steps.

    `time` (K,) [s]. `position` and `windup` (K, n) [rad]; without wind-up there are no parts of the
    deflection.
    """
    at = np.unique(np.searchsorted(time, np.linspace(0.0, time[-1], FRAMES)))
    at = at[at < len(time)]
    q = position[at]
    bends: dict[str, np.ndarray] = {}
    if windup is not None and np.any(windup):
        weight = np.array([robot.rigid_bodies().gravity_torque(each) for each in q])
        bends = {"dynamic": windup[at] - joint_windup(robot, weight), "total": windup[at]}
    return Poses.bent(robot, time[at], q, bends)


def joint_shares(jacobian: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Return the share of each joint (K, n) in the tool's deflection; the shares add up to 1."""
    each = jacobian * bend[:, None, :]
    whole = each.sum(axis=2)
    square = np.sum(whole**2, axis=1)
    along = np.einsum("kin,ki->kn", each, whole)
    return np.asarray(along / np.where(square > 0.0, square, np.inf)[:, None])
