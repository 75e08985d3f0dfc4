"""report.html of a preload study: what to tighten to, what binds, and what it rests on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from stiffopt.files import atomic_write
from stiffopt.report.common.citations import preload_references
from stiffopt.report.common.motions import robot_joint_units
from stiffopt.report.common.quantities import significant
from stiffopt.report.common.rendering import PageFigure, page_figure, write_page
from stiffopt.report.common.svg import to_png, to_svg
from stiffopt.report.preload.bars import (
    bar,
    limit_sources,
    utilisation_bars,
    utilisation_matrix,
)
from stiffopt.report.preload.curves_figure import curves_figure
from stiffopt.report.preload.extras import choice_section, motion_section
from stiffopt.report.preload.figures import (
    front_figure,
    loosening_figure,
    shares_figure,
)
from stiffopt.report.preload.inputs import (
    bolts_table,
    cases_table,
    pins_table,
    robot_estimates,
    study_table,
    tightening_table,
)
from stiffopt.report.preload.names import fastener_words, prose, spoken
from stiffopt.report.preload.tables import (
    deflection_table,
    individual_table,
    loosening_table,
    recommended_table,
    shares_by_joint,
    stiffness_table,
    worth_table,
)
from stiffopt.report.preload.wording import (
    headline,
    stiffness_sentence,
    weakest_sentence,
    what_binds,
)
from stiffopt.report.solve.tables import Table

if TYPE_CHECKING:
    from stiffopt.preload.study import PreloadStudy

REPORT_FILE = "report.html"


def write_preload_report(study: PreloadStudy, directory: str | Path) -> Path:
    """Write report.html and its figures as SVG and PNG into `directory`; return the page.

    Parameters
    ----------
    study : PreloadStudy
        Of any status; parts that were not run are left out.
    directory : path

    Returns
    -------
    Path
    """
    folder = Path(directory)
    problem, solution = study.problem, study.solution
    bars, every = utilisation_bars(solution.rows), [bar(row) for row in solution.rows]
    context = {
        "title": problem.title or f"Preloads of {problem.robot.title or problem.robot.name}",
        "headline": headline(problem, solution),
        "lead": what_binds(problem, solution),
        "gain": stiffness_sentence(problem, solution, study.front),
        "status": str(solution.status).replace("_", " "),
        "usable": solution.status.usable,
        "message": prose(solution.message),
        "stoppers": [_stopper(stop) for stop in solution.stoppers],
        "notes": [prose(note) for note in solution.notes],
        "tiles": _tiles(study),
        "recommended": recommended_table(problem, solution),
        "individual": individual_table(problem, solution),
        "stiffness": stiffness_table(problem, solution),
        "deflection": deflection_table(solution),
        "bars": bars,
        "matrix": utilisation_matrix(solution.rows),
        "all_bars": every if len(every) > len(bars) else [],
        "choice": None if study.choice is None else choice_section(problem, study.choice),
        "motion": None if study.motion is None else motion_section(problem, study.motion),
        "front_note": "" if study.front is None else prose(study.front.note),
        "loosening": loosening_table(study.loosening),
        "worth": worth_table(study.sensitivity, problem),
        "inputs": study_table(problem),
        "tightening": tightening_table(problem),
        "cases": cases_table(problem, solution),
        "fasteners": [t for t in (bolts_table(problem), pins_table(problem)) if t is not None],
        "limit_sources": limit_sources(solution.rows),
        "estimated": robot_estimates(problem),
        "versions": Table(("", ""), tuple(sorted(study.versions.items()))),
        "references": preload_references(study),
        "seconds": f"{study.seconds:.1f} s",
    } | _figures(study, folder)
    return write_page("preload.html.j2", folder / REPORT_FILE, context)


def _stopper(stop: Any) -> dict[str, str]:
    required, best = stop.amounts
    return {
        "limit": spoken(stop.limit),
        "required": required,
        "best": best,
        "against": prose(stop.against),
        "remedy": prose(stop.remedy),
    }


def _tiles(study: PreloadStudy) -> list[dict[str, str]]:
    solution, problem = study.solution, study.problem
    slip = [row for row in solution.rows if row.kind == "slip safety"]
    tiles = []
    if slip:
        worst = min(slip, key=lambda row: row.value)
        tiles.append(
            {
                "name": "least slip safety",
                "value": f"{worst.value:.2f}" if np.isfinite(worst.value) else "no load",
                "note": f"{spoken(worst.element)}, {worst.case}",
            }
        )
    bolts = [row for row in solution.rows if row.kind == "bolt utilisation"]
    if bolts:
        most = max(bolts, key=lambda row: row.value)
        tiles.append(
            {
                "name": "largest bolt utilisation",
                "value": f"{100 * most.value:.0f} %",
                "note": f"{spoken(most.element)}; 100 % is 90 % of yield",
            }
        )
    tiles.append(
        {
            "name": "total preload",
            "value": f"{significant(solution.total_preload / 1e3, 3)} kN",
            "note": f"of {fastener_words(problem.elements)}",
        }
    )
    posed = solution.deflection[np.isfinite(solution.deflection)]
    if posed.size:
        tiles.append(
            {
                "name": "largest tool deflection",
                "value": f"{significant(1e3 * float(posed.max()), 3)} mm",
                "note": "over the load cases with a pose",
            }
        )
    if np.isfinite(solution.kkt_residual):
        tiles.append(
            {
                "name": "proof of the optimum",
                "value": f"{solution.kkt_residual:.0e}",
                "note": f"KKT residual, 0 is exact; {solution.iterations} iterations",
            }
        )
    return tiles


def _figures(study: PreloadStudy, folder: Path) -> dict[str, PageFigure | None]:
    problem, solution = study.problem, study.solution
    units = robot_joint_units(problem.robot)
    several = len(study.curves) > len(problem.elements)
    further = " Thin grey: the load case of least stiffness." if several else ""
    shares = shares_by_joint(study.sensitivity, problem, solution)
    free = [element.name for element in problem.elements]
    front = None
    if study.front is not None and len(study.front.points) > 1:
        front = _saved(
            front_figure(study.front, units, problem.joints),
            "preload_front",
            "Total preload against stiffness",
            prose(f"{study.front.note} {study.front.knee_reason}"),
            folder,
        )
    return {
        "curves_figure": _saved(
            curves_figure(problem, solution, study.curves, units),
            "preload_curves",
            "Stiffness against preload",
            "One connection in each panel, all others as recommended. Tightening leaves a preload "
            "somewhere in the blue band: its lower end must stay right of the orange line, its "
            "upper end left of the grey ones; the shaded sides are forbidden. Scales differ from "
            f"panel to panel.{further}",
            folder,
        ),
        "front_figure": front,
        "shares_figure": _saved(
            shares_figure(shares, free),
            "preload_shares",
            "Share of the wind-up",
            f"{weakest_sentence(shares, free)} Each joint under its largest torque; what this "
            "study tightens is in bold.",
            folder,
        ),
        "loosening_figure": _saved(
            loosening_figure(study.loosening.first_slip_fraction, study.loosening.slip_fraction),
            "preload_loosening",
            "How far each connection may loosen",
            "Under the largest torque of the joint, starting from the least preload that "
            "tightening leaves.",
            folder,
        ),
    }


def _saved(figure: Figure, name: str, title: str, caption: str, folder: Path) -> PageFigure:
    svg = to_svg(figure, name, title)
    atomic_write(folder / f"{name}.svg", svg)
    atomic_write(folder / f"{name}.png", to_png(figure))
    return page_figure(svg, caption, title)
