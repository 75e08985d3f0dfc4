"""report.html of a solve: a self-contained page with figures, tables and assumptions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stiffopt.baseline.baselines import better_baseline
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.problem.objective import OBJECTIVES
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.report.common.citations import solve_references
from stiffopt.report.common.page import Filters, PageFigures, write_page
from stiffopt.report.common.robot import estimated_inputs, joint_units
from stiffopt.report.common.text import capital, scale, words
from stiffopt.report.scene.poses import poses_along
from stiffopt.report.scene.still import ArmInSpace, embedded_scene
from stiffopt.report.solve import compensation, wording
from stiffopt.report.solve.figures import (
    PARTS,
    ComparedMotion,
    compared_motions,
    deflection_figure,
    focus_part,
    motion_figure,
    stiffness_figure,
    torque_figure,
)
from stiffopt.report.solve.simulation import deviation_figure
from stiffopt.report.solve.space_figures import path_figure, windup_figure
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.solution import Baseline, Solution

REPORT_FILE = "report.html"


def write_solve_report(
    problem: TrajectoryProblem,
    solution: Solution,
    directory: str | Path,
) -> Path:
    """Write report.html into `directory`; return its path.

    Parameters
    ----------
    solution : Solution
        Solution of any status; the page is written also without a motion.
    """
    motions, part = compared_motions(solution), focus_part(problem)
    summaries = [motion.assessment.deflection_summary() for motion in motions]
    parts = [p for p in PARTS if any(summary[p].peak > 0 for summary in summaries)]
    largest = max((summary[p].peak for summary in summaries for p in parts), default=0.0)
    stages = solution.solver.homotopy
    absent = {name: b.reason for name, b in solution.baselines.items() if b.assessment is None}
    context = {
        "problem": problem,
        "solution": solution,
        "title": problem.title or f"Motion of {problem.robot.name}",
        "headline": _page_headline(solution),
        "comparison": wording.comparison(problem, solution),
        "read_first": [
            text for text in (wording.difference_text(problem, solution), *solution.notes) if text
        ],
        "simulated": solution.simulation and wording.simulation_section(solution.simulation),
        "better": better_baseline(problem, solution.baselines),
        "absent": "".join(f" No {name} motion: {reason}" for name, reason in absent.items()),
        "terms": [] if solution.objective is None else _objective_terms(solution.objective.terms),
        "units": joint_units(problem.robot),
        "tolerance": CERTIFICATE_TOLERANCE,
        "part": part,
        "motions": motions,
        "deflection_parts": parts,
        "deflection_unit": scale(largest, "m")[1],
        "stage_names": list(dict.fromkeys(name for stage in stages for name in stage)),
        "estimated": estimated_inputs(problem.robot),
        "references": solve_references(problem, solution.baselines),
        "current_hash": inputs_hash(problem),
        "space": None,
        "still": "",
    }
    filters: Filters = compensation.COMPENSATION_FILTERS | {
        "limit": wording.limit_text,
        "excess": wording.violation_text,
        "amount": lambda value: wording.objective_amount(
            solution.objective.name if solution.objective else "",
            value,
            solution.objective.unit if solution.objective else "",
        ),
        "phrase": lambda objective: wording.objective_phrase(objective.name, objective.measure),
    }
    figures = _draw_figures(problem, solution, part)
    if motions:
        better = better_baseline(problem, solution.baselines)
        arm = arm_in_space(problem, _shown_motions(motions, better), part)
        figures.draw("arm", arm.still, "The arm with the paths of its tool, planned and deflected")
        context |= {"space": arm.embedded, "still": arm.caption}
    path = Path(directory) / REPORT_FILE
    return write_page("solve/page.html.j2", path, context, figures, filters)


def _page_headline(solution: Solution) -> str:
    if solution.objective is None:
        return "No motion found"
    text = wording.headline_text(solution)
    return capital(text if solution.status.usable else f"{words(solution.status)}: {text}")


def _objective_terms(terms: dict[str, float]) -> list[tuple[str, str]]:
    """Return phrase and formatted value of each term of a weighted sum."""
    split = [(*term.partition(" ")[::2], value) for term, value in terms.items()]
    return [
        (
            wording.objective_phrase(name, by),
            wording.objective_amount(name, value, OBJECTIVES[name].unit, 3),
        )
        for name, by, value in split
    ]


def _shown_motions(motions: list[ComparedMotion], better: Baseline | None) -> list[ComparedMotion]:
    """Return the motion and, where there is one, the better feasible baseline."""
    return [
        motions[0],
        *(m for m in motions[1:] if better is not None and m.name == better.name),
    ]


def _draw_figures(problem: TrajectoryProblem, solution: Solution, part: str) -> PageFigures:
    figures = PageFigures("solve", svg=False, png=False)
    motion, motions = solution.assessment, compared_motions(solution)
    if motion is None:
        return figures
    shown = _shown_motions(motions, better_baseline(problem, solution.baselines))
    other = shown[1] if len(shown) > 1 else None
    for name, figure, description in (
        (
            "deflection",
            deflection_figure(motions, part),
            f"Tool deflection over time, {part} part and all parts",
        ),
        ("path", path_figure(problem, shown, part), f"Tool path with {part} deflection enlarged"),
        (
            "motion",
            motion_figure(problem, motion, other),
            "Joint positions, velocities, accelerations and jerks",
        ),
        ("torque", torque_figure(problem, motion), "Drive torque of each joint with its bounds"),
        (
            "stiffness",
            stiffness_figure(problem, motion),
            "Tangent stiffness of each joint over time",
        ),
        (
            "windup",
            windup_figure(problem, motion, part),
            "Wind-up of each joint split by element",
        ),
    ):
        figures.draw(name, figure, description)
    if solution.simulation is not None:
        figures.draw(
            "simulation",
            deviation_figure(solution.simulation),
            "Deviation of the tool over time on the elastic arm, in flight and after arrival",
        )
    if solution.compensation is not None:
        figures.draw(
            "compensation",
            compensation.compensation_figure(solution.compensation),
            compensation.COMPENSATED,
        )
    return figures


def arm_in_space(
    problem: TrajectoryProblem, motions: Sequence[ComparedMotion], part: str
) -> ArmInSpace:
    """Return scene and still of the first motion, with a ghost of the second."""
    poses = {motion.label: poses_along(problem, motion.assessment) for motion in motions}
    return embedded_scene(problem.robot, poses, part, problem.cell)
