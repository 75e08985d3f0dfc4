"""Re-solve problem and study files and compare with the values they expect."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.cycle.solve_cycle import solve_cycle
from stiffopt.errors import InputFileError
from stiffopt.files import check_file, load_toml
from stiffopt.path.load import load_problem
from stiffopt.preload.files import load_study
from stiffopt.preload.schema import ExpectedValueSection
from stiffopt.preload.solution import PreloadSolution
from stiffopt.preload.study import named_values, preload_study
from stiffopt.problem.cycle_files import is_cycle, load_cycle
from stiffopt.problem.schema import ExpectedSection
from stiffopt.result.cycle import CycleSolution
from stiffopt.result.solution import Solution
from stiffopt.result.status import ProgressCallback, SolveProgress, SolveStatus
from stiffopt.solver.monitor import Progress
from stiffopt.solver.solve import solve
from stiffopt.units import convert

KINDS = ("trajectory", "preload")

StudyCallback = Callable[[Progress | SolveProgress], object]


@dataclass(frozen=True)
class Check:
    """Comparison of one solved value of a problem or study file with its expected value."""

    path: Path
    name: str  # name of a study's value; "" is the objective of a trajectory problem
    status: SolveStatus
    # In `unit`.
    value: float | None
    expected: float | None
    unit: str
    rtol: float
    source: str  # source of the expected value
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
        """True where the result is usable and its value as expected."""
        deviation = self.deviation
        return self.status.usable and deviation is not None and deviation <= self.rtol

    @property
    def interrupted(self) -> bool:
        """True where the user interrupted the solve."""
        return self.status is SolveStatus.INTERRUPTED


def problem_files(path: Path) -> list[Path]:
    """Return the trajectory problem and preload study files at a path, sorted by name.

    Raises `InputFileError`: the folder has none.
    """
    if not path.is_dir():
        check_file(path)
        return [path]
    found = [p for p in sorted(path.glob("*.toml")) if load_toml(p).get("kind") in KINDS]
    if not found:
        raise InputFileError(
            path,
            "",
            "the folder has no trajectory problem and no preload study (*.toml with kind = "
            "'trajectory' or 'preload').",
        )
    return found


def check_problem(path: Path, changes: Sequence[str] = ()) -> None:
    """Read a problem or study file; raise `InputFileError` where it is invalid."""
    if _is_study(path):
        load_study(path, changes)
    elif is_cycle(path):
        load_cycle(path, changes)
    else:
        load_problem(path, changes)


def verify(
    path: Path, progress: StudyCallback | None = None, changes: Sequence[str] = ()
) -> tuple[Check, ...]:
    """Solve one problem or study file and return a check for each expected value.

    `changes` are overrides of entries as in `load_problem`.
    """
    if _is_study(path):
        return verify_study(path, progress, changes)
    return (verify_file(path, progress, changes),)


def _is_study(path: Path) -> bool:
    return load_toml(path).get("kind") == "preload"


def verify_study(
    path: Path, progress: StudyCallback | None = None, changes: Sequence[str] = ()
) -> tuple[Check, ...]:
    """Run a preload study and compare its values; a file without expected values never passes."""
    begin = time.perf_counter()
    loaded = load_study(path, changes)
    wants_knee = any(name.startswith("knee_") for name in loaded.expected)
    study = preload_study(
        loaded.problem,
        motion=loaded.motion,
        rounds=loaded.rounds,
        # The front takes longest; only its knee can have an expected value.
        front_points=loaded.front_points if wants_knee else 0,
        progress=progress,
    )
    values, solution = named_values(study), study.solution
    seconds = time.perf_counter() - begin
    known = {name: own if np.isfinite(own[0]) else None for name, own in values.items()}
    found = {name: known[name] for name in loaded.expected} or {"objective": values["objective"]}
    missing = "the file has no [expected.values]; add NAME with value, unit, rtol and source."
    return tuple(
        _compare(path, name, solution, own, loaded.expected.get(name), seconds, missing)
        for name, own in found.items()
    )


def verify_file(
    path: Path, progress: ProgressCallback | None = None, changes: Sequence[str] = ()
) -> Check:
    """Solve a motion or a cycle and compare its objective; without [expected] it never passes."""
    begin = time.perf_counter()
    solution: Solution | CycleSolution
    expected: ExpectedSection | None
    if is_cycle(path):
        cycle = load_cycle(path, changes)
        # Rests until the tool has settled are part of the time, and known by simulation.
        settles = any(leg.stop.until_settled for leg in cycle.cycle.legs)
        solution = solve_cycle(cycle.cycle, progress=progress, simulate=settles)
        expected = cycle.expected
    else:
        loaded = load_problem(path, changes)
        solution = solve(loaded.problem, progress=progress, throw=False)
        expected = loaded.expected
    value = solution.objective
    found = None if value is None else (value.value, value.unit)
    missing = "the file has no [expected]; add objective, unit, rtol and source."
    seconds = time.perf_counter() - begin
    return _compare(path, "", solution, found, expected, seconds, missing)


def _compare(
    path: Path,
    name: str,
    solution: Solution | CycleSolution | PreloadSolution,
    found: tuple[float, str] | None,
    expected: ExpectedSection | ExpectedValueSection | None,
    seconds: float,
    missing: str,
) -> Check:
    """Compare a value and its unit with the expected one; `missing` says that there is none."""
    value, unit = (None, "") if found is None else found
    if expected is None:
        return Check(path, name, solution.status, value, None, unit, 0.0, "", seconds, missing)
    goal = expected.value if isinstance(expected, ExpectedValueSection) else expected.objective
    return Check(
        path=path,
        name=name,
        status=solution.status,
        value=None if value is None else convert(value, unit, expected.unit),
        expected=goal,
        unit=expected.unit,
        rtol=expected.rtol,
        source=expected.source,
        seconds=seconds,
        message=solution.message,
    )
