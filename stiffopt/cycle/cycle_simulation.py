"""Elastic simulation and duty of a cycle: payload changes excite the arm, rests let it settle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.problem.cycle import Cycle
from stiffopt.problem.rest_poses import gravity_torque
from stiffopt.result.cycle import CycleSimulation, CycleSolution, JoinedMotion, LegError
from stiffopt.result.duty import Duty, DutyHistory, duty_of
from stiffopt.result.solution import Solution

if TYPE_CHECKING:
    from stiffopt.elastic.servo import Servo
    from stiffopt.problem.trajectory import Target, TrajectoryProblem
    from stiffopt.result.simulation import SimulatedMotion
    from stiffopt.result.trajectory import JointMotion
    from stiffopt.robot.robot import Robot

# Rests until settled are multiples of this, as set-points of controllers are [s].
_REST_STEP = 2e-3
# Longest rest until settled [s]: 0.5 mm decay to 20 um at 5 Hz and 2 % of critical damping.
_MAX_REST = 5.0


def simulate_cycle(
    cycle: Cycle, solutions: Sequence[Solution], rests: np.ndarray
) -> tuple[CycleSimulation | None, np.ndarray]:
    """Simulation of the commands of all legs, and the rests (L,) [s] until the tool has settled.

    None for a rigid arm, whose rests are the stated ones.
    """
    robot = cycle.first.robot
    paths = [each.assessment.position for each in solutions if each.assessment is not None]
    if not robot.yields or not robot.tool_yields(np.concatenate(paths)):
        return None, rests
    motions = leg_motions(solutions)
    settling = np.array([leg.stop.until_settled for leg in cycle.legs])
    if settling.any():
        trial = simulate_motions(cycle, *motions, np.where(settling, _MAX_REST, rests))
        settled = [
            _MAX_REST if each.settling_time is None else each.settling_time for each in trial.legs
        ]
        whole = np.ceil(np.array(settled) / _REST_STEP) * _REST_STEP
        rests = np.where(settling, whole, rests)
    found = simulate_motions(cycle, *motions, rests)
    notes = [
        f"After {leg.name} the tool does not stay within the band of "
        f"{1e6 * found.simulated.band:.3g} um within {_MAX_REST:g} s."
        for leg, error in zip(cycle.legs, found.legs, strict=True)
        if leg.stop.until_settled and error.settling_time is None
    ]
    return replace(found, notes=(*notes, *found.notes)), rests


def leg_motions(solutions: Sequence[Solution]) -> tuple[list[JointMotion], list[JointMotion]]:
    """Motor commands and planned motions of the links of solved legs."""
    commands: list[JointMotion] = []
    plans: list[JointMotion] = []
    for each in solutions:
        assert each.trajectory is not None
        planned: JointMotion = each.trajectory
        plan = each.trajectory.link or each.trajectory
        led = None if each.compensation is None else each.compensation.command
        command = planned if led is None else MotorMotion(led.time, led.position, led.velocity)
        commands.append(command)
        plans.append(plan)
    return commands, plans


def simulate_motions(
    cycle: Cycle,
    commands: Sequence[JointMotion],
    plans: Sequence[JointMotion],
    rests: np.ndarray,
    *,
    servo: Servo | None = None,
    band: float | None = None,
    damping: float | None = None,
) -> CycleSimulation:
    """Simulation of motor commands of all legs, measured from the planned motions of the links.

    `rests` (L,) [s]. `servo`: default that of the problem, whose known dead time the commands are
    sent ahead. `band`: settling band [m]; default that of the problem. `damping`: of every elastic
    joint on its own, as a share of critical.
    """
    lasted = np.array([plan.duration for plan in plans])
    arrivals = np.cumsum(lasted + rests) - rests
    end = float(arrivals[-1] + rests[-1])
    starts = arrivals - lasted
    command, plan = (
        MotorMotion.of(JoinedMotion(parts, starts, end)) for parts in (commands, plans)
    )
    arms = [
        ElasticArm(leg.problem.robot, _stop_pose(leg.problem.start), leg.problem.process_force)
        for leg in cycle.legs
    ]
    arms[0] = arms[0] if damping is None else arms[0].damped(damping)
    arms = [_with_same_damping(arms[0], each) for each in arms]
    changes = [
        (float(time), arm)
        for time, arm, before in zip(arrivals[:-1], arms[1:], arms[:-1], strict=True)
        if arm.robot is not before.robot or np.any(arm.process_force != before.process_force)
    ]
    last = _after_last_event(cycle, arms[-1])
    if last is not None:
        changes.append((float(arrivals[-1]), last))
    first = cycle.first
    simulated = simulate(
        arms[0],
        command,
        servo=servo or first.servo,
        ahead=first.led_servo.dead_time,
        band=first.active_limits.settling_band if band is None else band,
        plan=plan,
        changes=changes,
    )
    errors = _leg_errors(cycle, simulated, arrivals, rests)
    return CycleSimulation(simulated=simulated, legs=tuple(errors), notes=simulated.notes)


def _stop_pose(target: Target) -> np.ndarray:
    """Joint angles (n,) of a stop, which every leg gives."""
    assert target.joints is not None
    return target.joints


def _with_same_damping(first: ElasticArm, arm: ElasticArm) -> ElasticArm:
    """Arm with the damping of another: that of its springs, whatever the payload."""
    arm.damping = first.damping
    return arm


def _after_last_event(cycle: Cycle, arm: ElasticArm) -> ElasticArm | None:
    """Arm after the event of the last leg; None where it stays as it is."""
    if cycle.after_last is None or cycle.after_last is arm.robot:
        return None
    last = cycle.legs[-1].problem
    return _with_same_damping(
        arm, ElasticArm(cycle.after_last, _stop_pose(last.end), last.process_force)
    )


def _leg_errors(
    cycle: Cycle, simulated: SimulatedMotion, arrivals: np.ndarray, rests: np.ndarray
) -> list[LegError]:
    """Tool error of each leg."""
    time, distance = simulated.time, simulated.distance
    found, start = [], 0.0
    robots = [*(leg.problem.robot for leg in cycle.legs), cycle.after_last]
    for k, (leg, arrival, rest) in enumerate(zip(cycle.legs, arrivals, rests, strict=True)):
        flight = (time >= start) & (time <= arrival)
        resting = (time > arrival) & (time <= arrival + rest)
        outside = np.flatnonzero(resting & (distance > simulated.band))
        settled: float | None = 0.0
        if outside.size:
            last = int(outside[-1])
            more = last + 1 < len(time) and time[last + 1] <= arrival + rest
            settled = float(time[last + 1] - arrival) if more else None
        after = robots[k + 1]
        found.append(
            LegError(
                flight=float(distance[flight].max()),
                rest=float(distance[resting].max()) if resting.any() else None,
                jump=0.0
                if after is None or after is leg.problem.robot
                else _static_jump(leg.problem, after),
                settling_time=settled,
            )
        )
        start = float(arrival + rest)
    return found


def _static_jump(problem: TrajectoryProblem, after: Robot) -> float:
    """Static displacement of the tool [m] at the end of a motion by another payload."""
    pose = _stop_pose(problem.end)
    places = []
    for robot in (problem.robot, after):
        arm = ElasticArm(robot, pose, problem.process_force)
        places.append(arm.tool(arm.static_equilibrium(pose[None]))[0])
    return float(np.linalg.norm(places[1] - places[0]))


def cycle_duty(cycle: Cycle, found: CycleSolution) -> Duty:
    """Duty of the drives over a solved cycle, with the holding torques of its rests."""
    histories = []
    for k, (leg, solved) in enumerate(zip(cycle.legs, found.legs, strict=True)):
        motion = solved.solution.assessment
        assert motion is not None
        histories.append(DutyHistory.of_motion(motion))
        if solved.dwell > 0.0:
            holding = cycle.legs[k + 1].problem if k + 1 < len(cycle.legs) else leg.problem
            pose = _stop_pose(leg.problem.end)
            held = np.repeat(gravity_torque(holding, pose)[None], 2, axis=0)
            histories.append(
                DutyHistory(
                    time=np.array([0.0, solved.dwell]),
                    velocity=np.zeros_like(held),
                    torque=held,
                    reducer_torque=held,
                )
            )
    return duty_of(cycle.first.robot, histories)
