"""Terminal output of `stiffopt solve`, `simulate` and `verify`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from stiffopt.report.common.terminal import print_lines, print_section, print_table
from stiffopt.report.common.text import si
from stiffopt.report.solve import wording
from stiffopt.report.solve.compensation import compensation_section, compensation_text
from stiffopt.result.archive import ARCHIVE_FILE
from stiffopt.result.status import SolveStatus

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.compensation import Compensation
    from stiffopt.result.simulation import Simulation
    from stiffopt.result.solution import Solution
    from stiffopt.verify import Check


def print_solution(problem: TrajectoryProblem, solution: Solution, folder: Path) -> None:
    """Print status, objective, comparison with the baselines, notes and path of the report."""
    lines = [f"{solution.status}: {solution.message}"]
    if solution.objective is not None and solution.status is not SolveStatus.INFEASIBLE:
        lines += [wording.headline_text(solution), wording.comparison(problem, solution)]
        lines += [text for text in (wording.difference_text(problem, solution),) if text]
    lines += [f"Note: {note}" for note in solution.notes]
    print_lines(lines)
    if solution.simulation is not None:
        print_simulation(solution.simulation)
    if solution.compensation is not None:
        print_compensation(solution.compensation)
    report = folder / "report.html"
    if report.is_file():
        print_lines([f"Report: {report}"])
    elif (folder / ARCHIVE_FILE).is_file():
        alone = solution.simulation is not None and len(solution.simulation.motions) == 1
        others = " compares it with baselines and rivals and" if alone else ""
        print_lines([f"`stiffopt report {folder}`{others} draws the report."])


def print_simulation(simulation: Simulation) -> None:
    """Print the table of simulated motions with its notes."""
    print_section(wording.simulation_section(simulation))


def print_compensation(compensation: Compensation) -> None:
    """Print the table of planned and compensated motions with its notes."""
    section = compensation_section(compensation)
    print_section(replace(section, lines=[compensation_text(compensation), *section.lines]))


def print_check_begins(path: Path, number: int, count: int) -> None:
    """Print the file that is being solved, on standard error."""
    _error_console().print(Text(f"{path} ({number} of {count}) ..."), soft_wrap=True)


def print_check_ends(checks: Sequence[Check]) -> None:
    """Print the verdict on a solved file, on standard error."""
    for check in checks:
        found, name = _check_verdict(check), check.name or "objective"
        took = si(check.seconds, "s", 3)
        value, expected = (
            _format_checked_value(each, check.unit) for each in (check.value, check.expected)
        )
        line = f"  {found}: {name} {value}, expected {expected} ({took})"
        _error_console().print(Text(line), soft_wrap=True)


def _error_console() -> Console:
    return Console(stderr=True)


def _check_verdict(check: Check) -> str:
    return "ok" if check.passed else f"OFF ({check.status})"


def print_checks(checks: Sequence[Check]) -> None:
    """Print the table of expected and found values."""
    head = (
        "problem",
        "value",
        "expected",
        "found",
        "deviation",
        "allowed",
        "time",
        "verdict",
    )
    rows = [
        (
            check.path.stem,
            check.name or "objective",
            _format_checked_value(check.expected, check.unit),
            _format_checked_value(check.value, check.unit),
            "–" if check.deviation is None else f"{check.deviation:.1e}",
            f"{check.rtol:.0e}",
            si(check.seconds, "s", 3),
            _check_verdict(check),
        )
        for check in checks
    ]
    print_table(head, rows, title="stiffopt verify")
    print_lines(f"{check.path}: {check.message}" for check in checks if not check.passed)


def _format_checked_value(value: float | None, unit: str) -> str:
    """Return a value with the six digits that are compared, and its unit."""
    return "–" if value is None else f"{value:.6g} {unit}"
