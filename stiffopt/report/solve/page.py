"""report.html of a solve: one self-contained page with figures, tables and what they rest on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from stiffopt.certificate.objective_value import is_maximised
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.problem.objectives import UNITS
from stiffopt.report.common.citations import solve_references
from stiffopt.report.common.motions import (
    better_baseline,
    compared_motions,
    focus_part,
    joint_units,
)
from stiffopt.report.common.quantities import engineering, percent, significant
from stiffopt.report.common.rendering import PageFigure, page_figure, write_page
from stiffopt.report.solve.figures import (
    deflection_figure,
    motion_figure,
    stiffness_figure,
    torque_figure,
)
from stiffopt.report.solve.space_figures import path_figure, windup_figure
from stiffopt.report.solve.tables import (
    Table,
    baseline_table,
    certificate_table,
    deflection_table,
    estimated_table,
    homotopy_table,
    inputs_table,
    limits_table,
    solver_table,
)
from stiffopt.report.solve.wording import (
    comparison,
    limit_text,
    objective_phrase,
    objective_text,
)
from stiffopt.result.assessment import Assessment
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.solution import Solution

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem

REPORT_FILE = "report.html"


def write_solve_report(
    problem: TrajectoryProblem,
    solution: Solution,
    directory: str | Path,
) -> Path:
    """Write report.html into `directory`; return its path.

    Parameters
    ----------
    problem : TrajectoryProblem
    solution : Solution
        Of any status; a page is made also where there is no motion.
    directory : path

    Returns
    -------
    Path
    """
    context = {
        "title": problem.title or f"Motion of {problem.robot.name}",
        "headline": _headline(problem, solution),
        "comparison": comparison(problem, solution),
        "status": str(solution.status).replace("_", " "),
        "usable": solution.status.usable,
        "message": solution.message,
        "tiles": _tiles(problem, solution),
        "notes": solution.notes,
        "figures": [],
        "certificate": None,
        "baselines": baseline_table(solution, CERTIFIED),
        "inputs": inputs_table(problem),
        "limits": limits_table(problem),
        "estimated": estimated_table(problem.robot),
        "solver": solver_table(solution),
        "homotopy": homotopy_table(solution.solver.homotopy),
        "versions": Table(("", ""), tuple(sorted(solution.versions.items()))),
        "references": solve_references(problem, solution.baselines),
        "inputs_hash": solution.inputs_hash,
        "match": _match(problem, solution),
    }
    if solution.assessment is not None:
        context |= _motion_context(problem, solution, solution.assessment)
    return write_page("solve.html.j2", Path(directory) / REPORT_FILE, context)


def _motion_context(
    problem: TrajectoryProblem, solution: Solution, assessment: Assessment
) -> dict[str, Any]:
    return {
        "figures": _figures(problem, solution, assessment),
        "certificate": certificate_table(assessment, CERTIFIED),
        "points": len(assessment.time),
        "tolerance": percent(CERTIFIED),
        "deflection": deflection_table(solution),
    }


def _headline(problem: TrajectoryProblem, solution: Solution) -> str:
    if solution.objective is None:
        return "No motion found"
    text = objective_text(solution.objective)
    if not solution.status.usable:
        text = f"{str(solution.status).replace('_', ' ')}: {text}"
    return text[0].upper() + text[1:]


def _tiles(problem: TrajectoryProblem, solution: Solution) -> list[dict[str, str]]:
    tiles = []
    if solution.ratio_to_better_baseline is not None:
        better = better_baseline(solution, is_maximised(problem))
        tiles.append(
            {
                "name": "objective over baseline",
                "value": significant(solution.ratio_to_better_baseline, 3),
                "note": f"of {better}, the better feasible one",
            }
        )
    if solution.assessment is not None:
        tiles += _motion_tiles(problem, solution.assessment)
    if solution.objective is not None:
        tiles += [_term_tile(name, each) for name, each in solution.objective.terms.items()]
    record = solution.solver
    tiles.append(
        {
            "name": "solved in",
            "value": f"{record.build_s + record.solve_s:.1f} s",
            "note": f"{record.iterations} iterations, {record.intervals} intervals",
        }
    )
    return tiles


def _term_tile(term: str, value: float) -> dict[str, str]:
    name, _, measure = term.partition(" ")
    return {
        "name": "term of the objective",
        "value": engineering(value, UNITS.get(name, ""), 3),
        "note": objective_phrase(name, measure),
    }


def _motion_tiles(problem: TrajectoryProblem, assessment: Assessment) -> list[dict[str, str]]:
    worst, low = assessment.worst_violation, assessment.min_stiffness
    unit = joint_units(problem)[low.joint - 1].stiffness
    deflection = assessment.deflection_summary()[focus_part(problem)]
    return [
        {
            "name": f"{focus_part(problem)} deflection",
            "value": engineering(deflection.peak, "m", 3),
            "note": f"peak; rms {engineering(deflection.rms, 'm', 3)}",
        },
        {"name": "duration", "value": f"{assessment.duration:.4g} s", "note": "start to end"},
        {
            "name": "lowest joint stiffness",
            "value": significant(low.value, 3),
            "note": f"{unit}, joint {low.joint} at {low.time:.3f} s",
        },
        {
            "name": "limit exceeded by" if worst.value > CERTIFIED else "tightest limit",
            "value": _tile_percent(worst.value),
            "note": f"{limit_text(worst)} at {worst.time:.3f} s",
        },
    ]


def _tile_percent(violation: float) -> str:
    text = f"{significant(100 * abs(violation), 2)} %" if abs(violation) >= 1e-4 else "0 %"
    return text if violation > CERTIFIED else f"{text} off"


def _figures(
    problem: TrajectoryProblem, solution: Solution, assessment: Assessment
) -> list[PageFigure]:
    part = focus_part(problem)
    motions = compared_motions(solution)
    better = better_baseline(solution, is_maximised(problem))
    other = next((motion for motion in motions if motion.name == better), None)
    beside = f" Thin dashed: {better}." if other is not None else ""
    shown = [motions[0], *([other] if other is not None else [])]
    return [
        page_figure(
            deflection_figure(motions, part),
            f"Left: {part} deflection against the baselines. Right: all parts for this motion. "
            f"Dots mark the peaks.{_missing(solution)}",
            "Tool deflection",
        ),
        page_figure(
            path_figure(problem, shown, part),
            "Path of the tool in two projections, circle at the start and square at the end; the "
            "deflection is enlarged by the factor in the legend.",
            "Tool path",
        ),
        page_figure(
            motion_figure(problem, assessment, other),
            "Bounds are dashed with the forbidden side shaded; a bound far from the curve is "
            f"written in the corner.{beside}",
            "Joint motion",
        ),
        page_figure(
            torque_figure(problem, assessment),
            "Solid: drive torque with its bounds, which rotor inertia and friction enter. Dashed: "
            "torque in the joint's spring, which drives stiffness and wind-up.",
            "Torque",
        ),
        page_figure(
            stiffness_figure(problem, assessment),
            "Unsmoothed tangent stiffness at the spring torque. Dots mark the lowest values; it "
            "falls where the torque passes through zero.",
            "Joint stiffness",
        ),
        page_figure(
            windup_figure(problem, assessment, part),
            "Which joints and which elements yield, for the whole spring torque at that instant.",
            "Where the wind-up comes from",
        ),
    ]


def _missing(solution: Solution) -> str:
    """Why baselines are not drawn."""
    absent = {n: b.reason for n, b in solution.baselines.items() if b.assessment is None}
    return "".join(f" No {name} motion: {reason}" for name, reason in absent.items())


def _match(problem: TrajectoryProblem, solution: Solution) -> str:
    current_hash = inputs_hash(problem)
    if current_hash == solution.inputs_hash:
        return "Results match inputs: the inputs on this page are those that were solved."
    return (
        "Results do NOT match inputs: the inputs have changed since the solve (their hash is now "
        f"{current_hash}). Solve again."
    )
