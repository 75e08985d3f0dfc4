"""Checks of poses, lengths, masses and clearance before a solve."""

from __future__ import annotations

import re

import numpy as np

from stiffopt.connection import TimingBelt
from stiffopt.errors import ProblemError
from stiffopt.problem.trajectory import ResolvedMotion, Target, TrajectoryProblem
from stiffopt.robot.frames import link_frame, link_names
from stiffopt.robot.robot import Robot

_FULL_TURN = 2.0 * np.pi
# Tool offsets and centres of mass farther out, in reaches of the arm, are in another unit.
_MAX_OFFSET_OVER_REACH = 2.0


def check_plausible(problem: TrajectoryProblem) -> None:
    """Raise `ProblemError` where an angle or a length cannot be meant in rad or m.

    Refused are angles beyond one turn outside the joint's range, positions beyond the reach, and
    tool offsets or centres of mass far beyond the arm's length.
    """
    robot = problem.robot
    reach = max_reach(robot)
    _check_robot(robot)
    for where, target in located_targets(problem):
        if target.rpy is not None:
            for k in np.flatnonzero(np.abs(target.rpy) > _FULL_TURN + 1e-9):
                raise ProblemError(_full_turn_message(f"{where}.rpy[{k + 1}]", target.rpy[k]))
        for key in ("joints", "near"):
            angles = getattr(target, key)
            if angles is not None and angles.shape == (problem.joints,):
                _check_angles(problem, f"{where}.{key}", angles)
        if target.position is not None:
            distance = float(np.linalg.norm(target.position))
            if distance > reach * 1.001:
                listed = _format_vector(target.position)
                raise ProblemError(
                    f"{where}.position = {listed} m lies {distance:.4g} m from the base;"
                    f" {robot.name} with its tool reaches no farther than {reach:.4g} m."
                    f" Lengths are in m: was {listed} mm meant? Then write"
                    f' texts such as "{target.position[0]:g} mm".'
                )
    if problem.path is not None:
        for number, angles in enumerate(problem.path.points, start=1):
            _check_angles(problem, f"motion.path[{number}]", angles)


def inconsistent_inertias(robot: Robot) -> tuple[str, ...]:
    """Name links whose principal inertias violate the triangle inequality, in one sentence."""
    wrong = []
    for body in robot.tree.bodies:
        least, middle, largest = np.linalg.eigvalsh(body.inertia)
        # Excess of a principal inertia over the sum of the other two that rounding of files
        # explains.
        if largest > 1.01 * (least + middle):
            wrong.append(
                f"{body.name} ({_format_vector(np.array([least, middle, largest]))} kg m^2)"
            )
    if not wrong:
        return ()
    return (
        "Principal inertias of which one exceeds the sum of the other two belong to no rigid body: "
        f"{', '.join(wrong)}. Torques and vibration depend on them: check the URDF and the "
        "[[link]] sections.",
    )


def shifted_numbers(robot: Robot) -> tuple[str, ...]:
    """Name the joints by number where the numbers in their names are others, in one sentence."""
    own = [re.search(r"(\d+)$", name) for name in robot.joint_names]
    if [each and int(each[1]) for each in own] == list(range(1, robot.n + 1)) or None in own:
        return ()
    named = ", ".join(f"{k} is {name}" for k, name in enumerate(robot.joint_names, start=1))
    return (f"Joints are numbered from the base, unlike their names: {named}.",)


def slack_belts(robot: Robot) -> tuple[str, ...]:
    """Name each belt that goes slack below the largest torque of its joint."""
    found = []
    for joint, chain in zip(robot.joint_names, robot.chains, strict=True):
        for belt in () if chain is None else chain.elements.values():
            if not isinstance(belt, TimingBelt) or belt.preload is None:
                continue
            slack = float(belt.slack_torque())
            if slack < belt.torque_max:
                needed = belt.preload * belt.torque_max / slack
                found.append(
                    f"Joint {joint}, belt {belt.name}: with a tension of {belt.preload:g} N one"
                    f" span goes slack at {slack:.3g} N m on the pulley, below the"
                    f" {belt.torque_max:.3g} N m of the largest joint torque; beyond it the belt is"
                    f" half as stiff as reported. Give it {needed:.3g} N, or lower torque_max."
                )
    return tuple(found)


def max_reach(robot: Robot) -> float:
    """Upper bound of the tool's distance from the base [m]; infinite on an unlimited slide."""
    way = 0.0
    for j, body in enumerate(robot.tree.bodies):
        way += float(np.linalg.norm(body.translation))
        if body.prismatic:
            way += max(abs(robot.position_lower[j]), abs(robot.position_upper[j]))
    return way + float(np.linalg.norm(robot.tool.offset))


def _check_angles(problem: TrajectoryProblem, where: str, angles: np.ndarray) -> None:
    limits = problem.active_limits
    for j in np.flatnonzero(np.abs(angles) > _FULL_TURN + 1e-9):
        low, high = limits.position_lower[j], limits.position_upper[j]
        if problem.robot.prismatic[j] or (np.isfinite(high - low) and low <= angles[j] <= high):
            continue
        name = problem.robot.joint_names[j]
        raise ProblemError(_full_turn_message(f"{where}[{j + 1}] ({name})", float(angles[j])))


def _full_turn_message(where: str, value: float) -> str:
    return (
        f"{where} = {value:g} rad is more than a whole turn. A bare number is in rad: for degrees"
        f' write "{value:g} deg" (in Python, numpy.radians({value:g})).'
    )


def _check_robot(robot: Robot) -> None:
    _check_masses(robot)
    tool = float(np.linalg.norm(robot.tool.offset))
    # Links fixed to the last joint and the last link itself count as arm; the length of the last
    # link shows only in its mass distribution.
    arm = max_reach(robot) - tool + max(_tool_link_length(robot), _last_link_length(robot))
    if not 0.0 < arm < np.inf:
        return
    if tool > _MAX_OFFSET_OVER_REACH * arm:
        raise ProblemError(
            f"tool.offset: the tool lies {tool:.4g} m from its joint, the whole arm of {robot.name}"
            f' is {arm:.4g} m long. Lengths are in m; for millimetres write "78.5 mm".'
        )
    arm = max_reach(robot) + _tool_link_length(robot)
    for j, body in enumerate(robot.tree.bodies, start=1):
        far = float(np.linalg.norm(body.centre))
        if body.mass > 0.0 and far > _MAX_OFFSET_OVER_REACH * arm:
            raise ProblemError(
                f"the centre of mass behind joint {j} ({body.name}), payload included, lies"
                f" {far:.4g} m from the joint; the whole arm is {arm:.4g} m long. Lengths are in m:"
                " look at payload.com and at the URDF."
            )


def _tool_link_length(robot: Robot) -> float:
    """Distance of the tool's link from its joint [m]."""
    if robot.tool.link not in link_names(robot.model):
        return 0.0
    return float(np.linalg.norm(link_frame(robot.model, robot.tool.link).offset))


def _last_link_length(robot: Robot) -> float:
    """Length of the rod with the rotational inertia of the last link, without payload [m]."""
    last = robot.with_payload_times(0.0).tree.bodies[-1]
    if last.mass <= 0.0:
        return 0.0
    about_centre = np.linalg.eigvalsh(last.inertia)[-1] / last.mass
    return float(np.sqrt(3.0 * (about_centre + last.centre @ last.centre)))


def _check_masses(robot: Robot) -> None:
    """Raise `ProblemError` where no link has a mass."""
    total = float(sum(body.mass for body in robot.tree.bodies))
    payload = 0.0 if robot.payload is None else float(robot.payload[0])
    # Share of the total mass below which the links count as massless.
    if total - payload <= 1e-9 * total and not robot.rotor_inertia.any():
        zero = "those of the payload alone" if payload else "zero"
        raise ProblemError(
            f"no link of {robot.name} has a mass: its URDF gives no <inertial>, so all torques and"
            f" deflections are {zero}. Give masses in [[link]] sections of a robot file (`stiffopt"
            " init robot` of the URDF guesses some), or in the URDF."
        )


def _format_vector(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:g}" for value in values) + "]"


def check_clear_poses(problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
    """Raise `ProblemError` where a fixed pose falls below the clearance."""
    if not problem.avoids_collisions:
        return
    clearance = problem.stated_cell.clearance
    for where, pose in _fixed_poses(problem, motion):
        distance = problem.clearance_model.distances(pose)
        k = int(np.argmin(distance))
        # Accuracy of computed distances [m].
        if distance[k] < clearance - 1e-5:
            met = _describe_collision(problem, problem.clearance_model.pairs[k], float(distance[k]))
            raise ProblemError(f"{where}: {met}")


def clearance_at_poses(problem: TrajectoryProblem, motion: ResolvedMotion) -> float:
    """Largest clearance that all fixed poses keep [m]."""
    model = problem.clearance_model
    return min(
        (float(model.distances(q).min()) for _, q in _fixed_poses(problem, motion)), default=np.inf
    )


def _fixed_poses(
    problem: TrajectoryProblem, motion: ResolvedMotion
) -> list[tuple[str, np.ndarray]]:
    """Poses that fix all joints, each with its key in problem files."""
    every = zip(located_targets(problem), (motion.start, *motion.vias, motion.end), strict=True)
    return [(where, pose) for (where, target), pose in every if target.fixes_pose]


def located_targets(problem: TrajectoryProblem) -> list[tuple[str, Target]]:
    """Start, vias and end, each with its key in problem files."""
    vias = [(f"motion.via[{k}]", via) for k, via in enumerate(problem.vias, start=1)]
    return [("motion.start", problem.start), *vias, ("motion.end", problem.end)]


def _describe_collision(problem: TrajectoryProblem, pair: tuple[str, str], distance: float) -> str:
    one, other = pair
    choices = ["Choose another pose"]
    if other in problem.stated_cell.names:
        choices.append(f"correct the place of {other}")
    advice = ", ".join([*choices, "or plan without avoidance by method.collisions = 'check'."])
    if distance < 0.0:
        return (
            f"{one} is {-1e3 * distance:.1f} mm deep in {other} at this pose, so no motion is free "
            f"of collisions. {advice}"
        )
    clearance = problem.stated_cell.clearance
    return (
        f"{one} is {1e3 * distance:.1f} mm from {other} at this pose, below cell.clearance of "
        f"{1e3 * clearance:.1f} mm. Lower the clearance. {advice}"
    )
