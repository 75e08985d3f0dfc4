"""Simulation of a solution and search of its command, or a note on why there is none."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.budget.floor import error_floor_note
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.command.command_search import CommandChoice, CommandOnArms
from stiffopt.command.compensation import (
    compare_commands,
    compensate,
    requests_command,
    rival_commands,
)
from stiffopt.command.path_notes import with_path_notes
from stiffopt.command.simulation import (
    PlannedMotion,
    damping_sensitivity_note,
    elastic_arm,
    rival_motions,
    simulate_motions,
)
from stiffopt.elastic.arm import ElasticArm
from stiffopt.errors import NotSimulatedError
from stiffopt.interrupts import end_deferral, until_interrupted
from stiffopt.problem.motor_model import MotorLaw
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import ResolvedMotion
from stiffopt.result.simulation import Simulation
from stiffopt.result.status import ProgressCallback, SolveProgress, SolveStatus

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.solution import Solution

_COMMAND_NOT_REQUESTED = (
    "No command.csv: no objective or limit concerns the arm's elasticity. State [uncertainty] for "
    "a command with compensation of the wind-up, judged on uncertain arms."
)
COMMAND_INTERRUPTED = (
    "The search for a command was interrupted: no command.csv was written; solve again for it."
)
_SIMULATION_INTERRUPTED = (
    "The elastic simulation was interrupted; `stiffopt simulate` repeats it. No command.csv was "
    "written; solve again for it."
)


def with_simulation(
    problem: TrajectoryProblem,
    solution: Solution,
    progress: ProgressCallback | None = None,
    motion: ResolvedMotion | None = None,
    command: CommandOnArms | None = None,
    rivals: tuple[float, list[PlannedMotion], list[CommandOnArms]] | None = None,
    law: MotorLaw | None = None,
    *,
    choice: CommandChoice | None = None,
    compare: bool = True,
) -> Solution:
    """Return the solution with its simulation and its command, or with a note on why there is none.

    `motion` and `law` are the problem's where they exist already; `command` and `rivals` are of the
    solve, used where they belong to this solution and its duration, `choice` is that of a
    similar motion's command. Other rivals are simulated only with `compare`.
    """
    stopped, assessment = solution.status is SolveStatus.INTERRUPTED, solution.assessment
    if assessment is None or stopped or not problem.robot.yields:
        return solution
    motion = resolve(problem) if motion is None else motion
    if not problem.robot.tool_yields(assessment.position):
        return _add_note(solution, "Not simulated: no elastic joint moves the tool.")
    try:
        end_deferral()
        arm = _arm_of(problem, solution)
        counted = assessment.feasible(CERTIFICATE_TOLERANCE)
        own = PlannedMotion.of_solution(assessment, solution.trajectory, counted)
        if rivals is not None and not np.isclose(rivals[0], assessment.duration):
            rivals = None

        def simulated() -> tuple[list[PlannedMotion], Simulation] | None:
            others = rivals[1] if rivals else []
            if compare and not rivals:
                others = rival_motions(problem, motion, assessment.duration)
            motions = [own, *others]
            band = problem.active_limits.settling_band
            return motions, simulate_motions(problem, arm, motions, band=band)

        found = until_interrupted(simulated, lambda: None)
        if found is None:
            return _add_note(solution, _SIMULATION_INTERRUPTED)
        motions, simulation = found
        solution = replace(solution, simulation=simulation)
        unsure = damping_sensitivity_note(problem, assessment) if counted else ""
        solution = _add_note(solution, unsure) if unsure else solution
        if reason := _explain_missing_command(problem, own):
            return _add_note(solution, reason)
        if command is not None and command.motion.position is not own.position:
            command = None
        tell = progress_on_arms(progress, getattr(solution.objective, "value", np.nan))
        known = rivals[2] if rivals else None
        compensation = until_interrupted(
            lambda: compensate(
                problem,
                arm,
                motions,
                known=command,
                rivals=known,
                law=law,
                choice=choice,
                progress=tell,
            ),
            lambda: None,
        )
    except NotSimulatedError as error:
        return _add_note(solution, f"Not simulated on the elastic arm: {error}")
    if compensation is None:
        return _add_note(solution, COMMAND_INTERRUPTED)
    judged = _judge_beside_rivals(problem, replace(solution, compensation=compensation))
    judged = with_path_notes(problem, judged)
    floor = error_floor_note(problem.robot, problem.tolerances, judged)
    return _add_note(judged, floor) if floor else judged


def beside_rivals(
    problem: TrajectoryProblem, motion: ResolvedMotion, solution: Solution
) -> Solution:
    """Return a solution that was simulated alone with its rivals, and their commands."""
    assessment, simulation = solution.assessment, solution.simulation
    if assessment is None or simulation is None or len(simulation.motions) > 1:
        return solution
    motions = rival_motions(problem, motion, assessment.duration)
    if not motions:
        return solution
    arm, led = _arm_of(problem, solution), solution.compensation
    band = problem.active_limits.settling_band
    try:
        others = simulate_motions(problem, arm, motions, band=band).motions
        if led is not None:
            own = PlannedMotion.of_solution(assessment, solution.trajectory)
            led = compare_commands(problem, arm, own, led, rival_commands(problem, arm, motions))
    except NotSimulatedError:
        return solution
    simulation = replace(simulation, motions=(*simulation.motions, *others))
    return replace(solution, simulation=simulation, compensation=led)


def _arm_of(problem: TrajectoryProblem, solution: Solution) -> ElasticArm:
    """Return the elastic arm of a solution, under the force along its path."""
    assert solution.assessment is not None
    arm = elastic_arm(problem, solution.assessment.position[0])
    return arm if solution.trajectory is None else arm.under(solution.trajectory.force)


def _judge_beside_rivals(problem: TrajectoryProblem, solution: Solution) -> Solution:
    """Return the solution; a motion of least tool error is not optimal where a rival wins."""
    led = solution.compensation
    if not problem.judges_uncertain_arms or led is None or not led.rival_wins:
        return solution
    assert led.best_rival is not None
    message = f"{solution.message} But the command of the {led.best_rival.name} motion is better."
    lower = solution.status is SolveStatus.OPTIMAL
    status = SolveStatus.ACCEPTABLE if lower else solution.status
    return replace(solution, status=status, message=message)


def _explain_missing_command(problem: TrajectoryProblem, own: PlannedMotion) -> str:
    """Return why no command is made for a motion, "" where one is."""
    if not problem.rests_at_both_ends:
        return "No command.csv: the motion does not start and end at rest."
    if own.vibrates_after_arrival:
        return (
            "No command.csv: the plan has residual vibration within the limits; q of "
            "trajectory.csv is the command for it."
        )
    return "" if requests_command(problem) else _COMMAND_NOT_REQUESTED


def _add_note(solution: Solution, note: str) -> Solution:
    return replace(solution, notes=(*solution.notes, note))


def progress_on_arms(
    progress: ProgressCallback | None, objective: float
) -> Callable[[str], object]:
    """Return a callback that reports which motion is being compensated, by its objective."""
    start = time.perf_counter()
    numbers = itertools.count(1)

    def tell(name: str) -> None:
        if progress is not None:
            progress(
                SolveProgress(
                    stage=f"{name} motion on uncertain arms",
                    iteration=next(numbers),
                    objective=objective,
                    violation=0.0,
                    row="",
                    elapsed=time.perf_counter() - start,
                )
            )

    return tell
