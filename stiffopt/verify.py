"""Re-solve problem files and compare with the objective values they expect."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from stiffopt.errors import InputFileError
from stiffopt.files import check_file, load_toml
from stiffopt.problem.files import load_problem
from stiffopt.result.status import SolveStatus
from stiffopt.study.optimise import solve
from stiffopt.study.staging import ProgressCallback
from stiffopt.units import convert


@dataclass(frozen=True)
class Check:
    """One problem file, solved anew.

    Parameters
    ----------
    path : Path
    status : SolveStatus
    value, expected : float or None
        Of the objective, in `unit`.
    unit : str
    rtol : float
    source : str
        Where the expected value comes from.
    seconds : float
    message : str
    """

    path: Path
    status: SolveStatus
    value: float | None
    expected: float | None
    unit: str
    rtol: float
    source: str
    seconds: float
    message: str

    @property
    def deviation(self) -> float | None:
        """Relative deviation from the expected value."""
        if self.value is None or self.expected is None:
            return None
        return abs(self.value - self.expected) / max(abs(self.expected), 1e-300)

    @property
    def passed(self) -> bool:
        """Whether the motion is usable and its objective as expected."""
        deviation = self.deviation
        return self.status.usable and deviation is not None and deviation <= self.rtol

    @property
    def interrupted(self) -> bool:
        """Whether the user stopped it."""
        return self.status is SolveStatus.INTERRUPTED


def problem_files(path: Path) -> list[Path]:
    """The trajectory problem files at a path, in order of name.

    Raises
    ------
    InputFileError
        There is none.
    """
    if not path.is_dir():
        check_file(path)
        return [path]
    found = [p for p in sorted(path.glob("*.toml")) if load_toml(p).get("kind") == "trajectory"]
    if not found:
        raise InputFileError(
            path, "", "the folder holds no trajectory problem (*.toml with kind = 'trajectory')."
        )
    return found


def verify_file(path: Path, progress: ProgressCallback | None = None) -> Check:
    """Solve one problem file and compare; a file without [expected] never passes."""
    begin = time.perf_counter()
    loaded = load_problem(path)
    solution = solve(loaded.problem, progress=progress, throw=False)
    expected, value = loaded.expected, solution.objective
    if expected is None:
        return Check(
            path=path,
            status=solution.status,
            value=None if value is None else value.value,
            expected=None,
            unit="" if value is None else value.unit,
            rtol=0.0,
            source="",
            seconds=time.perf_counter() - begin,
            message="the file has no [expected]; add objective, unit, rtol and source.",
        )
    got = None if value is None else convert(value.value, value.unit, expected.unit)
    return Check(
        path=path,
        status=solution.status,
        value=got,
        expected=expected.objective,
        unit=expected.unit,
        rtol=expected.rtol,
        source=expected.source,
        seconds=time.perf_counter() - begin,
        message=solution.message,
    )
