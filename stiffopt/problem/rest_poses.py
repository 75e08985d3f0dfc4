"""Torque, stiffness and deflection of the arm at rest in given poses, by the exact laws.

No motion can change the quantities of a fixed rest pose, nor avoid the sign change of a joint
torque between two of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.exact.chain import exact_compliance, exact_windup
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.robot.bearings import bearing_deflections
from stiffopt.units import joint_unit


@dataclass(frozen=True)
class RestPose:
    """Start or end pose of a motion."""

    name: str  # "start" or "end"
    angles: np.ndarray  # (n,) [rad]
    fixed: bool  # True if the arm is at rest in exactly this pose


def rest_poses(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[RestPose, RestPose]:
    """Start and end pose of the motion."""
    rest = problem.boundary_acceleration == "zero" and problem.rests_at_both_ends
    return (
        RestPose("start", motion.start, motion.start_fixed and rest),
        RestPose("end", motion.end, motion.end_fixed and rest),
    )


def gravity_torque(problem: TrajectoryProblem, angles: np.ndarray) -> np.ndarray:
    """Static torque (n,) [N m] in a pose, process force included."""
    torque = problem.robot.rigid_bodies().gravity_torque(angles)
    if np.any(problem.process_force):
        return np.asarray(torque - tool_jacobian(problem, angles).T @ problem.process_force)
    return torque


def tool_jacobian(problem: TrajectoryProblem, angles: np.ndarray) -> np.ndarray:
    """Position Jacobian (3, n) of the tool in base axes."""
    robot = problem.robot
    return np.asarray(robot.rigid_bodies().jacobian(robot.tool, angles)[:3])


def stiffness_at(problem: TrajectoryProblem, joint: int, torque: float) -> float:
    """Tangent stiffness [N m/rad] of a joint by the exact law."""
    chain = problem.robot.chains[joint - 1]
    if chain is None:
        return np.inf
    return float(1.0 / np.asarray(exact_compliance(chain, np.array([torque])))[0])


def rest_deflection(problem: TrajectoryProblem, angles: np.ndarray, part: str) -> float:
    """Magnitude [m] of the "total" or "process" part of the static tool deflection in a pose."""
    torque = gravity_torque(problem, angles)
    without_force = torque + tool_jacobian(problem, angles).T @ problem.process_force
    windup = np.zeros(problem.joints)
    for j, chain in enumerate(problem.robot.chains):
        if chain is not None:
            loaded, unloaded = exact_windup(chain, np.array([torque[j], without_force[j]]))
            windup[j] = loaded - (unloaded if part == "process" else 0.0)
    deflection = -tool_jacobian(problem, angles) @ windup
    pose, force = angles[None], problem.process_force
    deflection += bearing_deflections(problem.robot, pose, force=force)[0, :, :3].sum(axis=0)
    if part == "process":
        deflection -= bearing_deflections(problem.robot, pose)[0, :, :3].sum(axis=0)
    return float(np.linalg.norm(deflection))


def torque_sign_change(problem: TrajectoryProblem, motion: ResolvedMotion, joint: int) -> str:
    """Reason why the spring torque of a joint must change sign; empty if it need not."""
    poses = rest_poses(problem, motion)
    if problem.boundary_acceleration == "zero" and all(p.fixed for p in poses):
        start, end = (gravity_torque(problem, p.angles)[joint - 1] for p in poses)
        # Inverse kinematics leaves residual torques of about 1e-6 of the maximum.
        threshold = 1e-5 * float(problem.robot.torque_max[joint - 1])
        if start * end < 0 and min(abs(start), abs(end)) > threshold:
            unit = joint_unit("N m", bool(problem.robot.prismatic[joint - 1]))
            return f"{start:.3g} {unit} at rest at the start, {end:.3g} {unit} at the end"
        for where, torque in (("start", start), ("end", end)):
            if abs(torque) <= threshold:
                return f"it is zero at rest in the {where} pose"
    if (
        problem.robot.tree.bodies[joint - 1].parent == 0
        and problem.rests_at_both_ends
        and not np.any(problem.process_force)
        and _never_loaded_by_gravity(problem, joint)
    ):
        return "gravity does not load it, and it has no momentum at either end"
    return ""


def torque_sides(problem: TrajectoryProblem, motion: ResolvedMotion) -> np.ndarray:
    """Sign (n,) of the static torques in the start pose; 0 for torques that must change sign."""
    signs = np.sign(gravity_torque(problem, motion.start))
    forced = [bool(torque_sign_change(problem, motion, j + 1)) for j in range(problem.joints)]
    return np.asarray(np.where(forced, 0.0, signs))


def poses_within_limits(problem: TrajectoryProblem) -> np.ndarray:
    """Reproducible random poses (20, n) within the position limits, for pose-independent checks."""
    random = np.random.default_rng(0)
    limits = problem.active_limits
    low = np.where(np.isfinite(limits.position_lower), limits.position_lower, -np.pi)
    high = np.where(np.isfinite(limits.position_upper), limits.position_upper, np.pi)
    return np.asarray(low + (high - low) * random.random((20, problem.joints)))


def _never_loaded_by_gravity(problem: TrajectoryProblem, joint: int) -> bool:
    """Return True if the gravity torque of a first joint vanishes in all sampled poses."""
    bodies, poses = problem.robot.bodies_in_motion(), poses_within_limits(problem)
    torques = np.abs(bodies.gravity_torque(poses)[:, joint - 1])
    return bool(torques.max() < 1e-9 * float(problem.robot.torque_max[joint - 1]))
