"""Wind-up compensation: motor commands by which the links follow a plan, judged by the worst case.

The motors lead the links by the wind-up under the torque of the planned motion (decision 0028). A
plan that is not smooth enough is replaced by the nearest smooth spline. The knot spacing and the
share of the nominal wind-up are chosen for the least tool deviation on the worst arm within the
problem's uncertainties: wind-up is proportional to one over the stiffness, so that its mean lies
above the nominal one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.command.command_lead import ExistingCommand
from stiffopt.command.command_search import CommandChoice, CommandOnArms, CommandSearch
from stiffopt.elastic.uncertainty import AssumedUncertainty
from stiffopt.problem.formulation import smoothing_stages
from stiffopt.problem.motor_model import MotorLaw
from stiffopt.result.compensation import (
    COMMAND_FILE,
    MIN_SLOWDOWN,
    Compensation,
)
from stiffopt.result.store import export_times

if TYPE_CHECKING:
    from stiffopt.command.simulation import PlannedMotion
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.elastic.servo import Servo
    from stiffopt.elastic.uncertainty import Uncertainty
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Violation

# Objectives whose links are planned.
_LINK_PLANNING_OBJECTIVES = ("tool_error", "tool_deviation")

# Slowing of a rival whose command exceeds a limit, in all and in each step.
_MAX_RIVAL_SLOWDOWN = 1.5
_MIN_SLOWDOWN_STEP, _MAX_SLOWDOWN_STEP = 1.01, 1.1

Progress = Callable[[str], object]


def compensate(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motions: Sequence[PlannedMotion],
    *,
    known: CommandOnArms | None = None,
    rivals: Sequence[CommandOnArms] | None = None,
    law: MotorLaw | None = None,
    choice: CommandChoice | None = None,
    progress: Progress | None = None,
) -> Compensation:
    """Return the command of the first motion, and the effect of compensation on all motions.

    `motions` begin with the optimised one and are at rest at both ends; commands that exist already
    are given as `known` and `rivals`, the problem's motor law as `law`, and the `choice` of the
    first one is kept where limits allow it. Raises `NotSimulatedError`, and `RobotError` where an
    uncertainty takes a joint's damping above critical.
    """
    own = known
    if own is None:
        (own,) = commands_on_arms(problem, arm, motions[:1], law, choice=choice, progress=progress)
    refusal, command = _explain_refusal(problem, own.excess), None
    if not refusal:
        command = assess(problem, own.motors, times=export_times(own.motors.duration))
    alone = Compensation(
        motions=(own.for_reports(),),
        command=command,
        refusal=refusal,
        uncertainty=problem.uncertainty.statements(arm.robot.payload is not None, problem.servo),
        ahead=problem.led_servo.dead_time,
        draws=problem.uncertainty.draws,
    )
    if rivals is None:
        rivals = rival_commands(problem, arm, motions[1:], own.law, progress=progress)
    return compare_commands(problem, arm, own.motion, alone, rivals, own.law)


def compare_commands(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    own: PlannedMotion,
    alone: Compensation,
    rivals: Sequence[CommandOnArms],
    law: MotorLaw | None = None,
) -> Compensation:
    """Return a compensation with rivals beside the optimised motion, at equal duration."""
    motions = (*alone.motions, *(each.for_reports() for each in rivals))
    result = replace(alone, motions=motions)
    # A slower rival that is better in no error would be beaten by more at equal duration.
    slower = {
        each.rival.name: own.slowed_to(problem, each.rival.duration)
        for each in ([] if own.at is None or result.optimised.excess else result.beside_rivals)
        if each.rival.duration > (1.0 + MIN_SLOWDOWN) * own.duration
        and max(each.ratios.values(), default=0.0) > 1.0
    }
    slowed = rival_commands(problem, arm, list(slower.values()), law) if slower else []
    reports = (each.for_reports() for each in slowed)
    result = replace(result, slowed=dict(zip(slower, reports, strict=True)))
    best = result.best_rival
    if best is None or not (result.rival_wins or result.rival_better_in):
        return result
    winner = next(each for each in rivals if each.motion.name == best.name)
    motors, plan = winner.motors, winner.motion
    assert plan.at is not None
    return replace(
        result,
        rival_plan=assess(problem, plan.at(plan.duration), times=export_times(plan.duration)),
        rival_command=assess(problem, motors, times=export_times(motors.duration)),
    )


def rival_commands(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motions: Sequence[PlannedMotion],
    law: MotorLaw | None = None,
    *,
    progress: Progress | None = None,
) -> list[CommandOnArms]:
    """Return the commands of rivals, each slowed until its command keeps the limits, if it does."""
    law = law or MotorLaw(problem.robot, problem.process_force)
    return [
        _command_within_limits(problem, arm, each, law) for each in _tell_each(motions, progress)
    ]


def _command_within_limits(
    problem: TrajectoryProblem, arm: ElasticArm, motion: PlannedMotion, law: MotorLaw
) -> CommandOnArms:
    """Choose the command of a rival at the duration at which it keeps the limits, and judge it."""
    longest = _MAX_RIVAL_SLOWDOWN * motion.duration
    while True:
        search = CommandSearch(problem, arm, motion, law)
        chosen = search.chosen_command()
        excess = search.motor_violations(chosen.motors)
        if not excess or motion.at is None or motion.duration >= longest:
            return search.judge_existing(chosen)
        # Limits of the velocity scale with the duration, those of the jerk with its cube.
        over = (1.0 + excess[0].value) ** (1.0 / 3.0)
        factor = float(np.clip(over, _MIN_SLOWDOWN_STEP, _MAX_SLOWDOWN_STEP))
        motion = motion.slowed_to(problem, factor * motion.duration)


def _tell_each(
    motions: Sequence[PlannedMotion], progress: Progress | None
) -> Iterator[PlannedMotion]:
    for motion in motions:
        if progress is not None:
            progress(motion.name)
        yield motion


def judge_existing_command(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motions: Sequence[PlannedMotion],
    made: ExistingCommand,
    *,
    uncertainty: Uncertainty | None = None,
    damping: float | None = None,
    servo: Servo | None = None,
    file: str = COMMAND_FILE,
) -> Compensation:
    """Judge an existing command of the first motion beside new commands of the others.

    Commands of the others are chosen for the problem's uncertainties and the arm as modelled. All
    are judged by the `uncertainty` (default the problem's), the `damping` of all elastic joints
    [share of critical] and the `servo` given here. `file` is the name of the command's file, for
    reports.
    """
    law = MotorLaw(problem.robot, problem.process_force)
    chosen = [CommandSearch(problem, arm, each, law).chosen_command() for each in motions[1:]]
    led = problem.led_servo  # of the uncertainty for which the commands were made
    problem = problem if uncertainty is None else replace(problem, uncertainty=uncertainty)
    arm = arm if damping is None else arm.damped(damping)
    found = [
        CommandSearch(problem, arm, motion, law, servo=servo, led=led).judge_existing(command)
        for motion, command in zip(motions, [made, *chosen], strict=True)
    ]
    return Compensation(
        motions=tuple(each.for_reports() for each in found),
        command=None,
        refusal="",
        uncertainty=problem.uncertainty.statements(
            arm.robot.payload is not None, problem.servo if servo is None else None
        ),
        ahead=led.dead_time,
        draws=problem.uncertainty.draws,
        loop="" if servo is None else str(servo),
        file=file,
    )


def commands_on_arms(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motions: Sequence[PlannedMotion],
    law: MotorLaw | None = None,
    *,
    choice: CommandChoice | None = None,
    progress: Progress | None = None,
) -> list[CommandOnArms]:
    """Return the commands of motions with their results on all arms.

    Parameters as of `compensate`; `law` is the problem's motor law, where it exists already.
    """
    law = law or MotorLaw(problem.robot, problem.process_force)
    searches = (
        CommandSearch(problem, arm, each, law, choice=choice, progress=progress) for each in motions
    )
    return [search.judge_existing(search.chosen_command()) for search in searches]


def _explain_refusal(problem: TrajectoryProblem, excess: tuple[Violation, ...]) -> str:
    if not excess:
        return ""
    limits = " and ".join(dict.fromkeys(f"limits.scale.{each.limit}" for each in excess))
    named = "; ".join(each.describe() for each in excess)
    others = [
        name
        for name in _LINK_PLANNING_OBJECTIVES
        if all(name != o.name for o in problem.objectives)
    ]
    other = f"Minimise {' or '.join(others)}, which plan{'s' * (len(others) == 1)} the links"
    exceeded = (
        f"No command.csv: for the links to follow this motion, the motors would exceed {named}."
    )
    if any(each.name == "duration" for each in problem.objectives):
        if problem.uncertainty.stated:
            return f"{exceeded} Plan with lower {limits}."
        other = "State [uncertainty], for which the links of a fastest motion are planned"
    return (
        f"{exceeded} {other} within the motors' limits, allow a longer duration, or plan with "
        f"lower {limits}."
    )


def requests_command(problem: TrajectoryProblem) -> bool:
    """Return True where an objective, limit or stated uncertainty concerns the arm's elasticity."""
    asked = problem.leads_on_path or problem.uncertainty != AssumedUncertainty()
    return len(smoothing_stages(problem)) > 1 or asked
