"""`stiffopt budget`: error budget of the tool."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from stiffopt.cli import base
from stiffopt.errors import InputError
from stiffopt.folders import output_folder


@base.app.command
def budget(
    source: Path,
    *,
    out: base.Out | None = None,
    model: Path | None = None,
    stiffness: Path | None = None,
    margin: str = "0.1 m",
    changes: base.Changes = (),
    open_report: base.Open = False,
) -> int:
    """Compute the error budget of the tool: bounds, shares of their sources, best measurement.

    Writes budget.json, budget.csv and report.html: along the motion of a solve, or the quintic
    motion of a problem, and at rest over the box around it. [tolerances] and [uncertainty] of the
    problem file say what is not exactly known. `source`: problem file, or folder of a solve. `out`:
    folder for the results; default: out/NAME-budget. `model`: extended.toml of a diagnosis of this
    arm, whose findings replace the nominal robot. `stiffness`: folder of identify-stiffness of this
    arm, whose confidence replaces that of [uncertainty]. `margin`: of the box around the motion.
    """
    from stiffopt.budget.budget import ErrorModel, error_budget, list_assumptions
    from stiffopt.budget.identified_stiffness import narrow_stiffness
    from stiffopt.budget.measurements import rank_measurements
    from stiffopt.budget.store import write_budget
    from stiffopt.budget.volume import volume_budget
    from stiffopt.path.load import load_problem
    from stiffopt.recipe.stored_result import problem_states, read_result, solved_states
    from stiffopt.report.pages.budget import print_budget, write_budget_report
    from stiffopt.units import to_si

    around = to_si(base.number_or_text(margin), "length", "--margin")
    if around < 0.0:
        raise InputError(f"--margin {margin}: must be 0 or above.")
    if source.is_dir():
        stored = read_result(source, changes=changes)
        problem = replace(stored.problem, uncertainty=stored.uncertainty)
        states, compensated = solved_states(stored), stored.command is not None
    else:
        problem = load_problem(source, changes).problem
        states, compensated = problem_states(problem), False
    if model is not None:
        from stiffopt.discovery.extended.planning import (
            extended_problem,
            planner_model,
            read_model,
        )

        problem = extended_problem(problem, planner_model(problem.robot, read_model(model)))
    unsure = ErrorModel(
        robot=problem.robot,
        tolerances=problem.tolerances,
        uncertainty=problem.uncertainty,
        process_force=problem.process_force,
        compensated=compensated,
    )
    if stiffness is not None:
        unsure = replace(unsure, uncertainty=narrow_stiffness(unsure, stiffness))
    folder = out or base.default_folder(f"{source.resolve().stem}-budget", changes)
    with output_folder(folder, "budget") as stage:
        found = error_budget(unsure, states)
        volume = volume_budget(unsure, found, around)
        measurements = rank_measurements(unsure, found)
        assumptions = list_assumptions(unsure, solved=source.is_dir())
        write_budget_report(problem.title, found, volume, measurements, assumptions, stage)
        write_budget(found, volume, measurements, assumptions, stage)
    print_budget(found, volume, measurements, folder)
    base.show_report(folder, open_report)
    return 0
