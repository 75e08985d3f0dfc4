"""A motion planned with the nominal robot and planned anew with what was found in recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stiffopt.certificate.assess import assess
from stiffopt.certificate.objective_value import objective_value
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.discovery.extended.model import ExtendedModel, load_extended
from stiffopt.discovery.extended.planner_model import PlannerModel, planner_model
from stiffopt.discovery.user_effects import load_effects
from stiffopt.elastic.uncertainty import bounds_from_deviations
from stiffopt.errors import more
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import Solution
from stiffopt.solver.solve import solve

Progress = Callable[[Any], object]


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoop:
    """Both motions and what the arm would do on either.

    Parameters
    ----------
    problem : TrajectoryProblem
        With the extended robot.
    planner : PlannerModel
    nominal : Solution
        Planned with the nominal robot.
    carried_over : Assessment or None
        The nominal motion on the extended robot.
    solution : Solution
        Planned with the extended robot; its notes tell the change.
    """

    problem: TrajectoryProblem
    planner: PlannerModel
    nominal: Solution
    carried_over: Assessment | None
    solution: Solution


def read_model(model: Path, effects: Path | None = None) -> ExtendedModel:
    """Extended model of a diagnosis, with the effects of a user's own file."""
    return load_extended(model, () if effects is None else load_effects(effects))


def solve_extended(
    problem: TrajectoryProblem, model: ExtendedModel, *, progress: Progress | None = None
) -> ClosedLoop:
    """Solve a problem with the nominal robot, then with the extended one.

    Parameters
    ----------
    problem : TrajectoryProblem
        With the nominal robot.
    model : ExtendedModel
    progress : callable, optional
        Called with a `SolveProgress` in every iteration of both solves.

    Raises
    ------
    ProblemError
        The problem cannot be met by the nominal or by the extended robot.
    InputFileError
        The model is of another robot.
    """
    planner = planner_model(problem.robot, model)
    changed = extended_problem(problem, planner)
    nominal = solve(problem, progress=progress, throw=False)
    carried = None
    if nominal.trajectory is not None:
        carried = assess(changed, nominal.trajectory)
    solution = solve(changed, progress=progress, throw=False)
    loop = ClosedLoop(
        problem=changed,
        planner=planner,
        nominal=nominal,
        carried_over=carried,
        solution=solution,
    )
    notes = (*solution.notes, *_changes(planner, model), *_comparison(loop))
    return replace(loop, solution=replace(solution, notes=notes))


def extended_problem(problem: TrajectoryProblem, planner: PlannerModel) -> TrajectoryProblem:
    """Return the problem with the extended robot, as uncertain as its findings."""
    unsure = bounds_from_deviations(
        problem.uncertainty, planner.stiffness_deviation, planner.payload_deviation
    )
    return replace(problem, robot=planner.robot, uncertainty=unsure)


def _changes(planner: PlannerModel, model: ExtendedModel) -> tuple[str, ...]:
    notes = [f"Planned with {model.source}. {text}" for text in planner.changes]
    if not planner.changes:
        notes.append(f"{model.source} holds nothing that a planner computes with.")
    if planner.left_out:
        notes.append(f"Left out, since a planner does not know it: {', '.join(planner.left_out)}.")
    return tuple(notes)


def _comparison(loop: ClosedLoop) -> tuple[str, ...]:
    """The motion planned without what was found against the one planned with it."""
    old, new, carried = loop.nominal.assessment, loop.solution.assessment, loop.carried_over
    if old is None or carried is None:
        return ("There is no motion of the nominal robot to compare with.",)
    notes = []
    if new is not None:
        for part in ("dynamic", "total"):
            promised, true, best = (
                each.deflection_summary()[part].peak for each in (old, carried, new)
            )
            notes.append(
                f"Peak {part} deflection of the motion planned without it:"
                f" {1e3 * promised:.4g} mm by the nominal model, {1e3 * true:.4g} mm by the"
                f" extended one; of the motion planned with it: {1e3 * best:.4g} mm"
                f"{_change(best, true)}."
            )
        notes.append(_objective(loop, carried))
    worst = carried.worst_violation
    if worst.value > CERTIFIED:
        notes.append(f"The motion planned without it would exceed {worst.describe()}.")
    return tuple(note for note in notes if note)


def _objective(loop: ClosedLoop, carried: Assessment) -> str:
    own = loop.solution.objective
    if own is None:
        return ""
    before = objective_value(loop.problem, carried)
    return (
        f"Objective of the motion planned without it, by the extended model: {before.value:.4g}"
        f" {before.unit}; planned with it: {own.value:.4g} {own.unit}"
        f"{_change(own.value, before.value)}."
    )


def _change(after: float, before: float) -> str:
    return f" ({more(after, before, 2)})" if before > 0.0 else ""
