"""What the commands print when they are done."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from stiffopt.report.quantities import engineering
from stiffopt.report.wording import comparison, objective_text
from stiffopt.result.status import SolveStatus

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.solution import Solution
    from stiffopt.verify import Check

# Of a table in a file or a log, where names must not be cut.
_LOG_WIDTH = 140


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


def print_checks(checks: Sequence[Check]) -> None:
    """A table of expected and found objective values."""
    table = Table(title="stiffopt verify")
    for column in ("problem", "expected", "found", "deviation", "allowed", "time", "verdict"):
        table.add_column(column)
    for check in checks:
        deviation = check.deviation
        table.add_row(
            check.path.stem,
            "-" if check.expected is None else f"{check.expected:.6g} {check.unit}",
            "-" if check.value is None else f"{check.value:.6g} {check.unit}",
            "-" if deviation is None else f"{deviation:.1e}",
            f"{check.rtol:.0e}",
            engineering(check.seconds, "s", 3),
            "ok" if check.passed else f"OFF ({check.status})",
        )
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_LOG_WIDTH)
    console.print(table)
    for check in checks:
        if not check.passed:
            console.print(f"{check.path}: {check.message}", markup=False, soft_wrap=True)
