"""report.html and terminal output of a preload study: tightening, active limits, assumptions."""

from __future__ import annotations

from pathlib import Path

from stiffopt.drivetrain.tables import with_own
from stiffopt.fastening.utilisation import SAFETY_FACTORS
from stiffopt.preload.bolt_sheet import bolt_sheets
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.problem import OBJECTIVES, FreeElement
from stiffopt.preload.study import PreloadStudy
from stiffopt.report.common.citations import preload_references
from stiffopt.report.common.page import Filters, PageFigures, write_page
from stiffopt.report.common.robot import joint_units
from stiffopt.report.common.terminal import print_lines, print_table
from stiffopt.report.common.text import DASH, si, significant
from stiffopt.report.preload import overview, words
from stiffopt.report.preload.curves_figure import curves_figure
from stiffopt.report.preload.figures import (
    flange_drawings,
    front_figure,
    joint_diagrams,
    loosening_figure,
    shares_figure,
)

REPORT_FILE = "report.html"
_CONNECTION_COLUMNS = (
    "connection",
    "fasteners",
    "largest preload",
    "least preload",
    "tightening torque",
    "utilisation",
    "active limits",
)


def write_preload_report(study: PreloadStudy, directory: str | Path) -> Path:
    """Write report.html and its figures as SVG and PNG into `directory`; return the page.

    Parameters
    ----------
    study : PreloadStudy
        Study of any status; parts that were not run are omitted.
    """
    with with_own(study.problem.robot.own):
        problem, solution = study.problem, study.solution
        units = joint_units(problem.robot)
        shares = overview.shares_by_joint(study.sensitivity, problem, solution)
        free = [element.name for element in problem.elements]
        figures = PageFigures("preload")
        figures.draw(
            "curves",
            curves_figure(problem, solution, study.curves, units),
            "Stiffness against preload",
        )
        if study.front is not None and len(study.front.points) > 1:
            front = front_figure(study.front, units, problem.joints)
            figures.draw("front", front, "Total preload against stiffness")
        sheets = bolt_sheets(PreloadModel(problem, solution.cases), solution.vector)
        drawn = overview.shown_sheets(sheets, solution)
        if drawn:
            figures.draw("diagram", joint_diagrams(drawn), "Joint diagram")
            figures.draw("flanges", flange_drawings(drawn), "Load of each bolt")
        figures.draw("shares", shares_figure(shares, free), "Share of the wind-up")
        loosening = study.loosening
        figures.draw(
            "loosening",
            loosening_figure(loosening.first_slip_fraction, loosening.slip_fraction),
            "Remaining preload at slip",
        )
        context = {
            "study": study,
            "problem": problem,
            "solution": solution,
            "units": units,
            "unit": OBJECTIVES[problem.objective],
            "title": problem.title or f"Preloads of {problem.robot.title or problem.robot.name}",
            "headline": words.headline(study),
            "lead": words.active_limits_sentence(problem, solution),
            "gain": words.stiffness_sentence(problem, solution, study.front),
            "weakest": words.weakest_sentence(shares, free),
            "mark": overview.EstimateMarks(problem).of,
            "changes": overview.stiffness_changes(problem, solution),
            "posed": any(case.jacobian is not None for case in solution.cases),
            "cautions": words.cautions(problem, solution),
            "most_used": overview.most_used(solution.rows),
            "matrix": overview.utilisation_matrix(solution.rows),
            "loosened": overview.loosened_connections(study.loosening),
            "worth": overview.preload_worth(study.sensitivity),
            "sheets": sheets,
            "drawn": [sheet.key for sheet in drawn],
            "steps": overview.vdi_steps(solution.rows),
            "safety_factors": SAFETY_FACTORS,
            "limit_sources": overview.limit_sources(solution.rows),
            "estimated": overview.study_estimates(problem),
            "references": preload_references(study),
            "objective_words": words.OBJECTIVE_WORDS,
            "method_words": words.METHOD_WORDS,
            "priced": problem.choose is not None and problem.choose.cost is not None,
        }
        filters: Filters = {
            "readable": words.readable,
            "prose": words.prose,
            "amount": words.amount,
            "fasteners": words.fasteners,
            "fastener_words": words.fastener_words,
            "owner": words.owner_name,
            "set_by": lambda element: words.active_limits_text(
                solution, element.key, element.joint
            ),
        }
        path = Path(directory) / REPORT_FILE
        return write_page("preload/page.html.j2", path, context, figures, filters)


def print_study(study: PreloadStudy, folder: Path) -> None:
    """Print tightening, active limits, utilisation, notes and path of the report."""
    problem, solution = study.problem, study.solution
    if solution.status.usable:
        print_lines(
            (
                f"{solution.status}: {words.headline(study)}.",
                words.active_limits_sentence(problem, solution) or None,
                words.stiffness_sentence(problem, solution) or None,
            )
        )
        print_table(
            _CONNECTION_COLUMNS, [_connection_row(study, element) for element in problem.elements]
        )
    else:
        chosen = f"{words.headline(study)}. " if study.choice is not None else ""
        print_lines([f"{solution.status}: {chosen}{solution.message}"])
    print_lines(
        (
            f"Catalogue: {study.choice.message}" if study.choice is not None else None,
            study.motion.note if study.motion is not None else None,
            *(f"Note: {note}" for note in study.notes),
            *(f"Warning: {each}" for each in words.cautions(problem, solution)),
            f"Report: {folder / 'report.html'}",
        )
    )


def _connection_row(study: PreloadStudy, element: FreeElement) -> tuple[str, ...]:

    solution, key = study.solution, element.key
    preload, torque = solution.preloads[key], solution.tightening[key]
    # Limits that do not depend on the preload, and warnings, are not listed.
    fixed = {limit.name for limit in element.limits if not limit.depends_on_preload}
    own = [r for r in solution.rows if r.element == key and r.binding and r.kind not in fixed]
    used = max(own, key=lambda r: r.utilisation)
    return (
        words.readable(key),
        words.fasteners(element),
        si(preload, "kN"),
        si(float(element.least(preload)), "kN"),
        DASH
        if torque is None
        else f"{si(torque.nominal, 'N m', 3)} ({significant(torque.lower, 3)} at least)",
        f"{100 * used.utilisation:.0f} % of {used.kind}",
        words.active_limits_text(solution, key, element.joint),
    )
