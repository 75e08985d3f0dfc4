"""What the commands print when they are done."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from stiffopt.report.common.quantities import engineering, significant
from stiffopt.report.preload.names import fasteners, quantity, spoken
from stiffopt.report.preload.wording import headline, sets, stiffness_sentence, what_binds
from stiffopt.report.solve.wording import comparison, objective_text
from stiffopt.result.status import SolveStatus

if TYPE_CHECKING:
    from stiffopt.preload.study import PreloadStudy
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.solution import Solution
    from stiffopt.verify import Check

# Of a table in a file or a log, where names must not be cut.
_LOG_WIDTH = 160


def print_solution(problem: TrajectoryProblem, solution: Solution, folder: Path) -> None:
    """A few lines: what came out, how it compares, what to do next, where the files are."""
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{solution.status}: {solution.message}", markup=False)
    if solution.objective is not None and solution.status is not SolveStatus.INFEASIBLE:
        console.print(objective_text(solution.objective), markup=False)
        console.print(comparison(problem, solution), markup=False)
    for note in solution.notes:
        console.print(f"Note: {note}", markup=False)
    console.print(f"Report: {folder / 'report.html'}", markup=False)


def print_study(study: PreloadStudy, folder: Path) -> None:
    """What to tighten to, what binds, how much of each limit is used, and where the files are."""
    console = Console(highlight=False, soft_wrap=True)
    problem, solution = study.problem, study.solution
    if solution.status.usable:
        console.print(f"{solution.status}: {headline(problem, solution)}.", markup=False)
        for text in (what_binds(problem, solution), stiffness_sentence(problem, solution)):
            if text:
                console.print(text, markup=False)
        _wide(Console(highlight=False)).print(_study_table(study))
    else:
        console.print(f"{solution.status}: {solution.message}", markup=False)
    if study.choice is not None:
        console.print(f"Catalogue: {study.choice.message}", markup=False)
    if study.motion is not None:
        console.print(study.motion.note, markup=False)
    for note in solution.notes:
        console.print(f"Note: {note}", markup=False)
    console.print(f"Report: {folder / 'report.html'}", markup=False)


def _study_table(study: PreloadStudy) -> Table:
    """One line a connection."""
    problem, solution = study.problem, study.solution
    table = Table()
    for column in ("connection", "fasteners", "preload", "at least", "tightening torque", "used"):
        table.add_column(column)
    table.add_column("set by")
    for element in problem.elements:
        key, preload = element.key, solution.preloads[element.key]
        torque = solution.tightening[key]
        # What no preload changes is not used up by it.
        fixed = {limit.name for limit in element.limits if not limit.depends_on_preload}
        own = [r for r in solution.rows if r.element == key and r.kind not in fixed]
        used = max(own, key=lambda r: r.utilisation)
        table.add_row(
            spoken(key),
            fasteners(element),
            quantity(preload, "N"),
            quantity(float(element.least(preload, problem.tightening.alpha)), "N"),
            "–"
            if torque is None
            else f"{significant(torque.nominal, 3)} N m ({significant(torque.lower, 3)} at least)",
            f"{100 * used.utilisation:.0f} % of {used.kind}",
            sets(solution, key, element.joint),
        )
    return table


def _wide(console: Console) -> Console:
    """Console for a table: wide enough in a file or a log."""
    return console if console.is_terminal else Console(highlight=False, width=_LOG_WIDTH)


def print_checks(checks: Sequence[Check]) -> None:
    """A table of expected and found values."""
    table = Table(title="stiffopt verify")
    for column in (
        "problem",
        "value",
        "expected",
        "found",
        "deviation",
        "allowed",
        "time",
        "verdict",
    ):
        table.add_column(column)
    for check in checks:
        deviation = check.deviation
        table.add_row(
            check.path.stem,
            check.name or "objective",
            "-" if check.expected is None else f"{check.expected:.6g} {check.unit}",
            "-" if check.value is None else f"{check.value:.6g} {check.unit}",
            "-" if deviation is None else f"{deviation:.1e}",
            f"{check.rtol:.0e}",
            engineering(check.seconds, "s", 3),
            "ok" if check.passed else f"OFF ({check.status})",
        )
    console = _wide(Console(highlight=False))
    console.print(table)
    for check in checks:
        if not check.passed:
            console.print(f"{check.path}: {check.message}", markup=False, soft_wrap=True)
