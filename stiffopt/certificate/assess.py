"""Assess a motion on a fine grid: true stiffness, true deflection, worst violation of every limit.

The formulas of the optimiser are not used: dynamics and kinematics come from pinocchio, wind-up
from quadrature of the exact contact and reducer laws, friction from its unsmoothed law.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.certificate.rigid_body import (
    added_torques,
    link_torques,
    rigid_body_history,
    tool_positions,
)
from stiffopt.certificate.violations import (
    find_drive_violations,
    find_violations,
    pass_vias,
    relative_target_miss,
)
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.led_error import led_error
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.errors import NotSimulatedError
from stiffopt.exact.chain import compliance_along, windup_along
from stiffopt.problem.objective import OBJECTIVES
from stiffopt.result.assessment import Assessment, DriveHistory, LowestStiffness, Violation
from stiffopt.result.trajectory import JointMotion
from stiffopt.robot.bearings import bearing_deflections

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.tool_error import LedError
    from stiffopt.robot.robot import Robot

_MotionArrays = tuple[np.ndarray, np.ndarray, np.ndarray]

# Equal steps of the certificate's grid, plus one.
FINE_GRID_POINTS = 6001
# Points in every interval of a motion, fewer where these would be more in all: the time law of a
# path of minutes has steps of 3 ms.
_POINTS_IN_INTERVAL, _MIN_POINTS_IN_INTERVAL, _MAX_POINTS = 20, 4, 120_000
# Knots of the spline through a motion that was not planned for a lead [s]: commands of S-curves and
# toppra's motions within the motors' limits have these.
_LED_KNOT_SPACING = 0.02
# Joint speed [rad/s] or [m/s] below which dry friction has no direction: rounding of zero.
_STANDSTILL_SPEED = 1e-9


def assess(
    problem: TrajectoryProblem,
    motion: JointMotion,
    *,
    times: np.ndarray | None = None,
    led: LedError | None = None,
) -> Assessment:
    """Evaluate `motion` with the unsmoothed model.

    Parameters
    ----------
    problem : TrajectoryProblem
        Robot, limits and process force.
    motion : JointMotion
        A `Trajectory` or another callable of (times, order) for orders 0 to 3. Where it has a
        `link` motion, that one loads the springs and deflects the tool.
    times : array, optional [s]
        Default: 6001 equal steps and, where the motion has them, its own break times. Only then is
        the elastic arm simulated, where a limit or an objective concerns residual vibration.
    led : LedError, optional
        Of the same links with other motors, where known: an exact lead depends on the links alone.
    """
    robot = problem.robot
    whole = times is None
    if times is None:
        times = fine_grid(motion)
    position, velocity, acceleration, jerk = (np.asarray(motion(times, k)) for k in range(4))
    link = getattr(motion, "link", None)
    moved = _spring_side_motion(motion, times, (position, velocity, acceleration))
    body = rigid_body_history(robot, *moved)
    force = _process_forces(problem, motion, times)
    process = np.einsum("kij,ki->kj", body.jacobian, force)
    spring_torque = body.link_torque - process
    torque = _drive_torque(robot, spring_torque, position, velocity, acceleration)

    windup, static = joint_windup(robot, spring_torque), joint_windup(robot, body.gravity_torque)
    # Without a process force the intermediate load case is one of the two others.
    between = windup if link is None else static
    if np.any(process):
        # With planned links the process force is applied before the motion, else after it.
        loads = body.link_torque if link is None else body.gravity_torque - process
        between = joint_windup(robot, loads)
    deflection = _split_deflection(
        body.jacobian, static, between, windup, force_first=link is not None
    )
    if robot.tilts:
        for part, moves in _bearing_parts(robot, moved, force).items():
            deflection[part] = deflection[part] + moves
    compliance = joint_compliance(robot, spring_torque)
    with np.errstate(divide="ignore"):
        stiffness = 1.0 / compliance
    tool_speed = np.linalg.norm(np.einsum("kij,kj->ki", body.jacobian, velocity), axis=1)
    lowest = tuple(
        LowestStiffness(float(stiffness[k, j]), j + 1, float(times[k]))
        for j, k in enumerate(np.argmin(stiffness, axis=0))
    )
    assessment = Assessment(
        time=times,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        jerk=jerk,
        torque=torque,
        spring_torque=spring_torque,
        stiffness=stiffness,
        windup=windup,
        tool=body.tool if link is None else tool_positions(robot, position),
        tool_speed=tool_speed,
        deflection=deflection,
        violations=(),
        lowest_stiffness=lowest,
        link=None if link is None else moved[0],
        force=None if getattr(link or motion, "force", None) is None else force,
    )
    integrals = {name: kind.joint_integrals(robot, assessment) for name, kind in OBJECTIVES.items()}
    named = {
        f"{name}_{j}": float(value)
        for name, values in integrals.items()
        if values is not None
        for j, value in enumerate(values, start=1)
    }
    swing = None
    if whole and led is None and problem.judges_uncertain_arms:
        with suppress(NotSimulatedError):
            led = led_error(
                ElasticArm(robot, position[0], problem.process_force),
                # As commands of rivals do: a lead needs continuous jerk.
                smooth_motion(motion, _LED_KNOT_SPACING) if link is None else link,
                problem.uncertainty,
                problem.servo,
            )
    if whole and problem.judges_arrival:
        arm = ElasticArm(robot, position[0], problem.process_force)
        command = MotorMotion(times, position, velocity)
        swing = simulate(arm, command, band=problem.active_limits.settling_band)
    return find_violations(problem, replace(assessment, integrals=named, simulated=swing, led=led))


def drive_violations(
    problem: TrajectoryProblem, motion: JointMotion, times: np.ndarray | None = None
) -> list[Violation]:
    """Return the violations of drive limits, worst first, at a tenth of the cost of `assess`."""
    return find_drive_violations(problem, drive_history(problem, motion, times)[0])


def largest_via_miss(problem: TrajectoryProblem, links: JointMotion) -> float:
    """Return the largest miss of a via by the links, beyond its tolerance and relative to it."""
    if not problem.vias:
        return -np.inf
    position = np.asarray(links(fine_grid(links), 0))
    tool = tool_positions(problem.robot, position)
    instants = pass_vias(problem, position, tool)
    return max(
        float(relative_target_miss(problem, via, position[[k]], tool[[k]])[0]) - 1.0
        for via, k in zip(problem.vias, instants, strict=True)
    )


def drive_history(
    problem: TrajectoryProblem,
    motion: JointMotion,
    times: np.ndarray | None = None,
    spring_torque: np.ndarray | None = None,
) -> tuple[DriveHistory, np.ndarray]:
    """Return the drives' motion and torques, and the spring torques (K, n) [N m], as of `assess`.

    Known spring torques may be passed; they follow from the links' motion alone.
    """
    robot = problem.robot
    if times is None:
        times = fine_grid(motion)
    position, velocity, acceleration, jerk = (np.asarray(motion(times, k)) for k in range(4))
    if spring_torque is None:
        moved = _spring_side_motion(motion, times, (position, velocity, acceleration))
        force = _process_forces(problem, motion, times)
        if np.any(force):
            body = rigid_body_history(robot, *moved)
            spring_torque = body.link_torque - np.einsum("kij,ki->kj", body.jacobian, force)
        else:
            spring_torque = link_torques(robot, *moved)
    moves = np.stack([position, velocity, acceleration, jerk])
    return drives_of(robot, times, moves, spring_torque), spring_torque


def drives_of(
    robot: Robot, times: np.ndarray, moves: np.ndarray, spring_torque: np.ndarray
) -> DriveHistory:
    """Return the drives' motion and torques.

    `times` (K,) [s]; `moves` (4, K, n): positions, velocities, accelerations and jerks of the
    motors; `spring_torque` (K, n) [N m].
    """
    torque = _drive_torque(robot, spring_torque, *moves[:3])
    position, velocity, acceleration, jerk = moves
    return DriveHistory(times, position, velocity, acceleration, jerk, torque)


def _process_forces(
    problem: TrajectoryProblem, motion: JointMotion, times: np.ndarray
) -> np.ndarray:
    """Return the force on the tool (K, 3) [N]: the problem's, and that of the motion's path."""
    constant = np.asarray(problem.process_force, dtype=float)
    carrier = getattr(motion, "link", None) or motion
    history = getattr(carrier, "force", None)
    added = np.zeros((len(times), 3)) if history is None else history(times)
    return np.asarray(constant + added)


def _spring_side_motion(
    motion: JointMotion, times: np.ndarray, own: _MotionArrays
) -> _MotionArrays:
    """Return position, velocity and acceleration of the spring's link side; `own` are the motors'.

    They are the planned links' where the motion has some; limits are on the motors.
    """
    link = getattr(motion, "link", None)
    if link is None:
        return own
    return np.asarray(link(times)), np.asarray(link(times, 1)), np.asarray(link(times, 2))


def _drive_torque(
    robot: Robot,
    spring_torque: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
) -> np.ndarray:
    """Return the drive torques (K, n) [N m], rotors and friction included."""
    # Rounding of a velocity that is zero must not switch dry friction on.
    direction = np.where(np.abs(velocity) > _STANDSTILL_SPEED, np.sign(velocity), 0.0)
    friction = robot.coulomb * direction + robot.viscous * velocity
    torque = np.asarray(spring_torque + robot.rotor_inertia * acceleration + friction)
    if robot.added_torques:
        motion = position, velocity, acceleration, spring_torque
        torque += added_torques(robot, motion, direction, in_spring=False)
    return torque


def _bearing_parts(robot: Robot, moved: _MotionArrays, force: np.ndarray) -> dict[str, np.ndarray]:
    """Return the parts of the tool's deflection (K, 3) [m] by bearings and links, which are linear.

    `moved`: motion of the links. `force` (K, 3) ON the tool [N].
    """
    position = moved[0]
    static, held, total = (
        bearing_deflections(robot, *motion)[..., :3].sum(axis=1)
        for motion in ((position,), (position, None, None, force), (*moved, force))
    )
    return {"static": static, "process": held - static, "dynamic": total - held, "total": total}


def _split_deflection(
    jacobian: np.ndarray,
    static: np.ndarray,
    between: np.ndarray,
    spring: np.ndarray,
    *,
    force_first: bool,
) -> dict[str, np.ndarray]:
    """Return the parts of the tool's deflection (K, 3) [m] from wind-ups (K, n).

    Loads are applied one after another: weight, motion, process force; with `force_first` weight,
    process force, motion.
    """
    first, last = ("process", "dynamic") if force_first else ("dynamic", "process")
    # The wind-up of a slipping connection is infinite, so its parts are infinite, not undefined.
    with np.errstate(invalid="ignore"):
        parts = {
            "dynamic": np.zeros_like(spring),
            "static": static,
            "process": np.zeros_like(spring),
            "total": spring,
        }
        for part, (one, other) in {first: (between, static), last: (spring, between)}.items():
            if one is not other:
                parts[part] = one - other
        vectors = {k: -np.einsum("kij,kj->ki", jacobian, angle) for k, angle in parts.items()}
    return {part: np.where(np.isnan(v), np.inf, v) for part, v in vectors.items()}


def fine_grid(motion: JointMotion) -> np.ndarray:
    """Return the certificate's grid: 6001 equally spaced instants and the motion's break times."""
    grid = np.linspace(0.0, motion.duration, FINE_GRID_POINTS)
    breaks = np.asarray(getattr(motion, "times", ()), dtype=float)
    if breaks.size:
        # However short the mesh made it.
        inside = np.clip(_MAX_POINTS // len(breaks), _MIN_POINTS_IN_INTERVAL, _POINTS_IN_INTERVAL)
        inner = np.linspace(breaks[:-1], breaks[1:], int(inside) + 1).ravel()
        grid = np.union1d(grid, np.clip(inner, 0.0, motion.duration))
    return grid[np.concatenate(([True], np.diff(grid) > 1e-9 * motion.duration))]


def joint_windup(robot: Robot, torque: np.ndarray) -> np.ndarray:
    """Return the wind-up of every joint [rad] by the exact law; torque (K, n) [N m]."""
    columns = [
        np.zeros(len(torque)) if chain is None else windup_along(chain, torque[:, j])
        for j, chain in enumerate(robot.chains)
    ]
    return np.stack(columns, axis=1)


def joint_compliance(robot: Robot, torque: np.ndarray) -> np.ndarray:
    """Return the tangent compliance [rad/(N m)] of every joint by the exact law; 0 if rigid."""
    columns = [
        np.zeros(len(torque)) if chain is None else compliance_along(chain, torque[:, j])
        for j, chain in enumerate(robot.chains)
    ]
    return np.stack(columns, axis=1)
