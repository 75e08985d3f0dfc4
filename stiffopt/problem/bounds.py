"""Values that an objective or a limit cannot get past whatever the motion, found before solving.

- The lowest stiffness of a joint whose torque must change sign is its stiffness at zero torque. The
  torque must change sign where gravity pulls the two rest poses to opposite sides, and, for a first
  joint that gravity does not load, because its momentum is zero at both ends.
- The peak of the total deflection cannot be below the static sag of a pose at which the arm rests.
- With a free duration and no upper bound, deflection, torque and compliance fall for ever.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.exact.chain import exact_compliance, exact_windup
from stiffopt.problem.objectives import Objective
from stiffopt.problem.resolve import ResolvedMotion, gravity_torque, tool_jacobian
from stiffopt.problem.trajectory import TrajectoryProblem

# Objectives that do not ask for an ever slower motion.
_ENDING = ("duration", "joint_stiffness")


_ACCEPT = ", or set minimise.accept_bound = true."

# Peaks that a pose at rest fixes, with what fixes them and what to minimise instead.
_PINNED = {
    "total_deflection": (
        "the static sag",
        "'dynamic_deflection' (what the motion adds), or ",
    ),
    "process_deflection": ("what the process force does at rest", ""),
}


@dataclass(frozen=True)
class Bound:
    """A value that the objective cannot beat.

    Parameters
    ----------
    objective : str
    value : float
        In the objective's SI unit; inf where it has no optimum.
    text : str
        A sentence with the value and its cause.
    degenerate : bool
        Whether the objective is pinned to it, so that the motion is left undetermined.
    """

    objective: str
    value: float
    text: str
    degenerate: bool


def find_bounds(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[Bound, ...]:
    """Bounds of all objectives of a problem."""
    found: list[Bound] = []
    for objective in problem.objectives:
        alone = len(problem.objectives) == 1
        if alone and np.isinf(problem.duration[1]) and objective.name not in _ENDING:
            found.append(_endless(objective))
        if objective.name == "joint_stiffness":
            found += _stiffness_bounds(problem, motion, objective)
        if objective.name in _PINNED and objective.measure == "peak":
            found += _rest_bounds(problem, motion, objective.name)
    return tuple(found)


def check_bounds(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[str, ...]:
    """Refuse degenerate objectives and limits that no motion can meet; notes about the rest.

    Raises
    ------
    ProblemError
        With the value that cannot be beaten, its cause and the choices.
    """
    _check_limits(problem, motion)
    bounds = find_bounds(problem, motion)
    accepted = {o.name for o in problem.objectives if o.accept_bound}
    refused = [b for b in bounds if b.degenerate and b.objective not in accepted]
    if refused:
        raise ProblemError("\n".join(b.text for b in refused))
    return tuple(b.text.removesuffix(_ACCEPT) + "." * b.text.endswith(_ACCEPT) for b in bounds)


def shortest_duration(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[float, str]:
    """A duration [s] that no motion can undercut, and the sentence why; (0, "") where none is seen.

    Each joint on its own, from rest to rest: its way, its velocity and its acceleration limit.
    """
    if not (motion.start_fixed and motion.end_fixed) or problem.boundary_velocity is not None:
        return 0.0, ""
    limits = problem.active_limits
    way = np.abs(motion.end - motion.start)
    with np.errstate(divide="ignore", invalid="ignore"):
        ramp = np.where(np.isinf(limits.acceleration), 0.0, limits.velocity / limits.acceleration)
        needed = np.where(
            way <= limits.velocity * ramp,
            2.0 * np.sqrt(way / limits.acceleration),
            way / limits.velocity + ramp,
        )
    needed = np.nan_to_num(needed, nan=0.0)
    j = int(np.argmax(needed))
    unit = "m" if problem.robot.prismatic[j] else "rad"
    return float(needed[j]), (
        f"Joint {j + 1} has to move by {way[j]:.4g} {unit} and needs {needed[j]:.4g} s or more for "
        f"that within its velocity limit {limits.velocity[j]:.4g} {unit}/s and its acceleration "
        f"limit {limits.acceleration[j]:.4g} {unit}/s^2; the duration allows "
        f"{problem.duration[1]:.4g} s."
    )


def _endless(objective: Objective) -> Bound:
    return Bound(
        objective.name,
        np.inf,
        f"{objective.name} with a free duration and no upper bound has no optimum: a slower motion "
        "is always better, down to the value at rest. Give motion.duration an upper bound or a "
        "fixed value, or add the objective 'duration' with a weight.",
        True,
    )


def _stiffness_bounds(
    problem: TrajectoryProblem, motion: ResolvedMotion, objective: Objective
) -> list[Bound]:
    found = []
    for joint in objective.joints or range(1, problem.joints + 1):
        if problem.robot.chains[joint - 1] is None:
            raise ProblemError(
                f"Joint {joint} of {problem.robot.name} has no drivetrain, so it has no stiffness. "
                "Describe its elements in the robot file, or leave it out of minimise.joints."
            )
        cause = sign_change(problem, motion, joint)
        weight = objective.weight_of(joint)
        if cause:
            value = stiffness_at(problem, joint, 0.0)
            found.append(
                Bound(
                    objective.name,
                    value / weight,
                    f"The torque of joint {joint} must change sign ({cause}), so its lowest "
                    f"stiffness is the one at zero torque, {value:.4g} N m/rad, whatever the "
                    f"motion. Leave joint {joint} out (minimise.joints), minimise "
                    f"'mean_compliance' or 'dynamic_deflection' instead{_ACCEPT}",
                    True,
                )
            )
            continue
        for where, angles, fixed in _rest_poses(problem, motion):
            if fixed:
                torque = gravity_torque(problem, angles)[joint - 1]
                value = stiffness_at(problem, joint, float(torque))
                found.append(
                    Bound(
                        objective.name,
                        value / weight,
                        f"The lowest stiffness of joint {joint} cannot exceed {value:.4g} N m/rad, "
                        f"its value at rest in the {where} pose ({torque:.3g} N m).",
                        False,
                    )
                )
    return found


def sign_change(problem: TrajectoryProblem, motion: ResolvedMotion, joint: int) -> str:
    """Why the spring torque of a joint must pass zero; empty where it need not."""
    poses = _rest_poses(problem, motion)
    if problem.boundary_acceleration == "zero" and all(fixed for _, _, fixed in poses):
        start, end = (gravity_torque(problem, angles)[joint - 1] for _, angles, _ in poses)
        # Angles solved numerically leave a residue of the order of 1e-6 of the torque.
        threshold = 1e-5 * float(problem.robot.torque_max[joint - 1])
        if start * end < 0 and min(abs(start), abs(end)) > threshold:
            return f"{start:.3g} N m at rest at the start, {end:.3g} N m at the end"
        for where, torque in (("start", start), ("end", end)):
            if abs(torque) <= threshold:
                return f"it is zero at rest in the {where} pose"
    if (
        problem.robot.tree.bodies[joint - 1].parent == 0
        and problem.boundary_velocity is None
        and not np.any(problem.process_force)
        and _never_loaded_by_gravity(problem, joint)
    ):
        return "gravity does not load it, and it has no momentum at either end"
    return ""


def torque_sides(problem: TrajectoryProblem, motion: ResolvedMotion) -> np.ndarray:
    """Sign of each joint's torque at rest in the start pose; 0 where it must change (n,)."""
    signs = np.sign(gravity_torque(problem, motion.start))
    forced = [bool(sign_change(problem, motion, j + 1)) for j in range(problem.joints)]
    return np.asarray(np.where(forced, 0.0, signs))


def stiffness_at(problem: TrajectoryProblem, joint: int, torque: float) -> float:
    """Tangent stiffness [N m/rad] of a joint by the exact law."""
    chain = problem.robot.chains[joint - 1]
    if chain is None:
        return np.inf
    return float(1.0 / np.asarray(exact_compliance(chain, np.array([torque])))[0])


def rest_deflection(problem: TrajectoryProblem, angles: np.ndarray, objective: str) -> float:
    """Length [m] of the tool's "total_deflection" or "process_deflection" at rest in a pose."""
    torque = gravity_torque(problem, angles)
    without_force = torque + tool_jacobian(problem, angles).T @ problem.process_force
    windup = np.zeros(problem.joints)
    for j, chain in enumerate(problem.robot.chains):
        if chain is not None:
            loaded, unloaded = exact_windup(chain, np.array([torque[j], without_force[j]]))
            windup[j] = loaded - (unloaded if objective == "process_deflection" else 0.0)
    return float(np.linalg.norm(tool_jacobian(problem, angles) @ windup))


def _never_loaded_by_gravity(problem: TrajectoryProblem, joint: int) -> bool:
    """Whether a first joint's gravity torque is zero in all of many poses."""
    random = np.random.default_rng(0)
    limits = problem.active_limits
    low = np.where(np.isfinite(limits.position_lower), limits.position_lower, -np.pi)
    high = np.where(np.isfinite(limits.position_upper), limits.position_upper, np.pi)
    poses = low + (high - low) * random.random((20, problem.joints))
    torques = [abs(gravity_torque(problem, pose)[joint - 1]) for pose in poses]
    return bool(max(torques) < 1e-9 * float(problem.robot.torque_max[joint - 1]))


def _rest_bounds(problem: TrajectoryProblem, motion: ResolvedMotion, objective: str) -> list[Bound]:
    """Deflections of given rest poses, below which the peak over the motion cannot be."""
    values = [
        (rest_deflection(problem, angles, objective), where)
        for where, angles, fixed in _rest_poses(problem, motion)
        if fixed
    ]
    if not values:
        return []
    value, where = max(values)
    what, other = _PINNED[objective]
    text = (
        f"The peak {objective.replace('_', ' ')} cannot be below {what} of the {where} pose, "
        f"{1e3 * value:.4g} mm, whatever the motion. Minimise {other}its rms{_ACCEPT}"
    )
    return [Bound(objective, value, text, True)]


def _rest_poses(
    problem: TrajectoryProblem, motion: ResolvedMotion
) -> list[tuple[str, np.ndarray, bool]]:
    """Start and end: name, angles, and whether the arm rests just there."""
    rest = problem.boundary_acceleration == "zero" and problem.boundary_velocity is None
    return [
        ("start", motion.start, motion.start_fixed and rest),
        ("end", motion.end, motion.end_fixed and rest),
    ]


def _check_limits(problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
    """Stiffness floors and deflection caps that the rest poses or a sign change rule out."""
    limits = problem.active_limits
    for joint, floor in limits.joint_stiffness.items():
        if not 1 <= joint <= problem.joints:
            raise ProblemError(
                f"limits.joint_stiffness names joint {joint}; allowed: 1 to {problem.joints}."
            )
        cause = sign_change(problem, motion, joint)
        value = stiffness_at(problem, joint, 0.0)
        if cause and value < floor:
            raise ProblemError(
                f"limits.joint_stiffness: joint {joint} cannot stay above {floor:.4g} N m/rad, "
                f"because its torque must change sign ({cause}) and its stiffness at zero torque "
                f"is {value:.4g} N m/rad. Lower the limit or leave the joint out."
            )
    for where, angles, fixed in _rest_poses(problem, motion):
        if not fixed:
            continue
        sag = rest_deflection(problem, angles, "total_deflection")
        if sag > limits.total_deflection:
            raise ProblemError(
                f"limits.total_deflection: the static sag of the {where} pose is "
                f"{1e3 * sag:.4g} mm, above the limit {1e3 * limits.total_deflection:.4g} mm, "
                "whatever the motion. Raise the limit, or use limits.dynamic_deflection."
            )
        torque = gravity_torque(problem, angles)
        for joint, floor in limits.joint_stiffness.items():
            value = stiffness_at(problem, joint, float(torque[joint - 1]))
            if value < floor:
                raise ProblemError(
                    f"limits.joint_stiffness: joint {joint} has {value:.4g} N m/rad at rest in the "
                    f"{where} pose, below the limit {floor:.4g} N m/rad, whatever the motion. "
                    "Lower the limit, choose another pose, or free the boundary acceleration."
                )
