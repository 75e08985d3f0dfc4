"""Load cases from a pose at rest, a solved trajectory or an assessed motion.

The wind-up that counts as tool deflection is "total", "dynamic" (less the sag at rest) or "process"
(by the process force only).
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from stiffopt.certificate.rigid_body import RigidBodyHistory, rigid_body_history
from stiffopt.errors import InputFileError, ProblemError
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.motion_table import read_motion_table
from stiffopt.robot.joint_load import joint_frames, joint_wrenches
from stiffopt.robot.robot import Robot

# Tolerance of recorded torques over the largest one for the same arm and load [-].
_TORQUE_TOLERANCE = 1e-3
# Torques within this of those of the joint motion [-]: links follow their motors.
_MOTION_TORQUE_TOLERANCE = 0.01
# Degree of the spline through a recorded link motion.
_SPLINE_DEGREE = 5


def pose_case(
    robot: Robot, name: str, angles: np.ndarray, force: np.ndarray, deflection: str = "total"
) -> LoadCase:
    """Return the load case of an arm at rest, with torques gravity minus J^T F.

    `robot` has payload and tool, `angles` (n,) [rad]; `force` (3,) acts ON the tool, base axes [N].
    With the `deflection` "dynamic" the case has none, since the arm is at rest.
    """
    rest = np.zeros_like(angles)[None]
    pose = np.asarray(angles, dtype=float)[None]
    body = rigid_body_history(robot, pose, rest, rest)
    gravity, jacobian = body.gravity_torque[0], body.jacobian[0]
    frames, arm = joint_frames(robot, pose)
    return LoadCase(
        name=name,
        torque=gravity - jacobian.T @ force,
        reference_torque=gravity if deflection == "process" else None,
        jacobian=None if deflection == "dynamic" else jacobian,
        wrench=joint_wrenches(robot, pose, rest, rest, np.asarray(force, dtype=float))[0],
        reference_wrench=(
            joint_wrenches(robot, pose, rest, rest, np.zeros(3))[0]
            if deflection == "process"
            else None
        ),
        frames=frames[0],
        arm=arm[0],
        source="pose",
    )


def trajectory_history(
    robot: Robot,
    name: str,
    path: str | os.PathLike[str],
    force: np.ndarray,
    deflection: str | None = None,
    whole: bool = False,
) -> LoadHistory:
    """Return the spring torques along a solved trajectory.

    `path` is a CSV with the columns t, q1.., tau_spring1.. in SI, as written by a solve, `force`
    (3,) the process force of that motion [N]. With a `deflection`, tool, payload and force must be
    those of the motion, checked if the file has tool_x.., qd1.. and qdd1..; without, torques alone
    are read. `whole` returns all six components of the joint loads: it requires payload and force
    of the motion and the columns qd1.. and qdd1... Raises `InputFileError`: not a trajectory file,
    or one of another robot.
    """
    path = Path(path)
    table = _read_trajectory(path, robot.n)
    time, spring = table["t"], table["tau_spring"]
    source = f"trajectory {path.name}"
    position, velocity, acceleration = _link_motion(table, robot)
    # Accelerations of a spline through samples are less accurate than recorded ones.
    share = _TORQUE_TOLERANCE if position is table["q"] else _MOTION_TORQUE_TOLERANCE
    wrench = frames = arm = None
    if whole:
        if velocity is None or acceleration is None:
            raise InputFileError(
                path,
                "qd1, qdd1",
                "the flanges of the study carry forces and tilting moments besides torque, which "
                "need velocity and acceleration. Give the trajectory.csv of a solve, or set "
                '`bearing = "beside"` of the flanges in the robot file.',
            )
        wrench = joint_wrenches(
            robot, position, velocity, acceleration, np.asarray(force, dtype=float)
        )
        frames, arm = joint_frames(robot, position)
        revolute = ~robot.prismatic
        _check_torque(path, robot, spring[:, revolute], wrench[:, revolute, 5], share)
    if deflection is None:
        return LoadHistory(name=name, time=time, torque=spring, wrench=wrench, source=source)
    rest = np.zeros_like(position)
    known = velocity is not None and acceleration is not None
    body = rigid_body_history(
        robot,
        position,
        rest if velocity is None else velocity,
        rest if acceleration is None else acceleration,
    )
    tool = table.get("tool_")
    if tool is not None:
        own = body.tool
        if position is not table["q"]:
            own = rigid_body_history(robot, table["q"], rest, rest).tool
        _check_tool(path, robot, own, tool)
    pushed = np.einsum("kin,i->kn", body.jacobian, force)
    reference = _reference_torque(deflection, spring, pushed, body)
    if reference is not None and known:
        _check_torque(path, robot, spring, body.link_torque - pushed, share)
    return LoadHistory(
        name=name,
        time=time,
        torque=spring,
        reference_torque=reference,
        jacobian=body.jacobian,
        wrench=wrench,
        reference_wrench=(
            None
            if wrench is None
            else _reference_wrench(deflection, robot, position, velocity, acceleration)
        ),
        frames=frames,
        arm=arm,
        source=source,
    )


def motion_histories(
    problem: TrajectoryProblem, motion: Assessment, objective: str
) -> tuple[LoadHistory, ...]:
    """Return torques and poses along a motion by pinocchio, on the certificate's grid.

    `problem`: robot and process force. `objective`: minimised deflection. First the history of that
    deflection; a second one of the full spring torque if the process force does not count in the
    deflection.
    """
    body = rigid_body_history(problem.robot, motion.position, motion.velocity, motion.acceleration)
    # Loaded and reference torque. Dynamic: less the sag, without force. Process: by the force only.
    torque, reference = {
        "dynamic_deflection": (body.link_torque, body.gravity_torque),
        "process_deflection": (motion.spring_torque, body.link_torque),
        "total_deflection": (motion.spring_torque, None),
    }[objective]
    frames, arm = joint_frames(problem.robot, motion.position)
    found = [
        LoadHistory(
            name="motion",
            time=motion.time,
            torque=torque,
            reference_torque=reference,
            jacobian=body.jacobian,
            wrench=_motion_wrench(problem, motion, torque is motion.spring_torque),
            reference_wrench=_reference_wrench(
                objective.removesuffix("_deflection"),
                problem.robot,
                motion.position,
                motion.velocity,
                motion.acceleration,
            ),
            frames=frames,
            arm=arm,
            source="motion of this study",
        )
    ]
    if np.any(problem.process_force) and torque is body.link_torque:
        found.append(
            LoadHistory(
                name="motion under the process force",
                time=motion.time,
                torque=motion.spring_torque,
                wrench=_motion_wrench(problem, motion, True),
                source="motion of this study",
            )
        )
    return tuple(found)


def _motion_wrench(problem: TrajectoryProblem, motion: Assessment, pushed: bool) -> np.ndarray:
    """Return the joint loads along a motion (K, n, 6), with or without process force."""
    return joint_wrenches(
        problem.robot,
        motion.position,
        motion.velocity,
        motion.acceleration,
        np.asarray(problem.process_force, dtype=float) * pushed,
    )


def _reference_torque(
    deflection: str, spring: np.ndarray, pushed: np.ndarray, body: RigidBodyHistory
) -> np.ndarray | None:
    """Return the torques whose wind-up does not count (K, n) [N m]."""
    if deflection == "total":
        return None
    if deflection == "process":
        if not np.any(pushed):
            raise ProblemError(
                "the process deflection of a trajectory needs the force that acted in it. Give "
                "tool.process_force, or `force` in the load case."
            )
        return np.asarray(spring + pushed)
    if np.any(pushed):
        raise ProblemError(
            "the dynamic deflection excludes the effect of a force on the tool, which this load "
            "case has. Set deflection to 'total' or 'process', or drop the force."
        )
    return body.gravity_torque


def _reference_wrench(
    deflection: str,
    robot: Robot,
    position: np.ndarray,
    velocity: np.ndarray | None,
    acceleration: np.ndarray | None,
) -> np.ndarray | None:
    """Return the joint loads that do not count in the deflection (K, n, 6)."""
    rest = np.zeros_like(position)
    if deflection == "dynamic":
        return joint_wrenches(robot, position, rest, rest, np.zeros(3))
    if deflection == "process":
        assert velocity is not None
        assert acceleration is not None
        return joint_wrenches(robot, position, velocity, acceleration, np.zeros(3))
    return None


def _read_trajectory(path: Path, joints: int) -> dict[str, np.ndarray]:
    """Read the arrays of a trajectory file."""
    table = read_motion_table(path, joints, ("tau_spring", "q"), ("qd", "qdd", "link", "tool_"))
    time = table["t"]
    for row in np.flatnonzero(np.diff(time) <= 0):
        raise InputFileError(
            path,
            f"row {row + 2}, t",
            f"{time[row + 1]:g} follows {time[row]:g}; the time must increase from row to row.",
        )
    return table


def _link_motion(
    table: dict[str, np.ndarray], robot: Robot
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Return position, velocity and acceleration (K, n) of the links.

    If the file has a link motion that differs from the joint motion, as with vibration
    suppression, its derivatives are those of a spline.
    """
    position, spring = table["q"], table["tau_spring"]
    link, velocity, acceleration = (table.get(each) for each in ("link", "qd", "qdd"))
    if link is None or velocity is None or acceleration is None or len(link) <= _SPLINE_DEGREE:
        return position, velocity, acceleration
    turning = ~robot.prismatic
    torque = joint_wrenches(robot, position, velocity, acceleration, np.zeros(3))[..., 5]
    own = np.abs(torque - spring)[:, turning].max(initial=0.0)
    if own <= _MOTION_TORQUE_TOLERANCE * np.abs(spring[:, turning]).max(initial=0.0):
        return position, velocity, acceleration
    spline = make_interp_spline(table["t"], link, _SPLINE_DEGREE)
    rate, second = (spline.derivative(order)(table["t"]) for order in (1, 2))
    return link, np.asarray(rate), np.asarray(second)


def _check_tool(path: Path, robot: Robot, own: np.ndarray, written: np.ndarray) -> None:
    miss = float(np.linalg.norm(own - written, axis=1).max())
    # Tolerance of recorded tool positions for the same tool [m].
    if miss > 1e-6:
        raise InputFileError(
            path,
            "tool_x, tool_y, tool_z",
            f"the tool of the trajectory is up to {1e3 * miss:.4g} mm away from that of "
            f"{robot.name} in the study. Give the study the [tool] of the trajectory problem.",
        )


def _check_torque(
    path: Path, robot: Robot, written: np.ndarray, own: np.ndarray, share: float
) -> None:
    miss = np.abs(own - written)
    joint = int(np.argmax(miss.max(axis=0)))
    worst, largest = float(miss[:, joint].max()), float(np.abs(written[:, joint]).max())
    if worst > share * max(largest, float(np.abs(written).max()) * _TORQUE_TOLERANCE):
        raise InputFileError(
            path,
            f"tau_spring{joint + 1}",
            f"differs by up to {worst:.3g} N m from the torque of {robot.name} of the study in "
            "this motion. Give the study the [payload] and the tool.process_force of the "
            "trajectory problem.",
        )
