"""`stiffopt replay` and `report`: a stored solve solved again, compared or drawn."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stiffopt.cli.base import Open, app, show_report
from stiffopt.folders import output_folder
from stiffopt.interrupts import defer_while_writing

if TYPE_CHECKING:
    from stiffopt.recipe.replay import Replay


@app.command
def replay(folder: Path, *, quiet: bool = False) -> int:
    """Solve a stored result again by its recipe, and say whether the answer is the same.

    Every stage has to end in the same objective to 1e-9, else the first one that differs is named,
    with versions that do. Exit code 1 where the answer differs.

    Parameters
    ----------
    folder
        Folder of `stiffopt solve`.
    quiet
        No progress display.
    """
    found = _solve_again(folder, quiet, simulate=False)
    changed = found.differences
    print("the same answer, stage by stage" if not changed else "; ".join(changed))
    return 1 if changed else 0


@app.command
def report(folder: Path, *, open_report: Open = False, quiet: bool = False) -> int:
    """Draw report.html of a solve that was made with --no-report.

    The motion is solved again by the recipe of the folder, from the same state; a page is drawn
    only where the answer is the stored one.

    Parameters
    ----------
    folder
        Folder of `stiffopt solve`.
    quiet
        No progress display.
    """
    from stiffopt.errors import InputFileError
    from stiffopt.report.solve.page import REPORT_FILE, write_solve_report
    from stiffopt.result.store import RESULT_FILE

    found = _solve_again(folder, quiet, simulate=True)
    if found.differences:
        raise InputFileError(
            folder / RESULT_FILE,
            "",
            f"cannot be drawn: {'; '.join(found.differences)}. Solve again.",
        )
    with output_folder(folder, "report", of="solve") as stage, defer_while_writing():
        write_solve_report(found.problem, found.solution, stage)
    print(f"Report: {folder / REPORT_FILE}")
    show_report(folder, open_report)
    return 0


def _solve_again(folder: Path, quiet: bool, *, simulate: bool) -> Replay:
    from contextlib import nullcontext

    from stiffopt.recipe.replay import replay as solve_again
    from stiffopt.report.common.progress import ProgressDisplay

    with nullcontext() if quiet else ProgressDisplay(str(folder), "") as progress:
        return solve_again(folder, progress=progress, simulate=simulate)
