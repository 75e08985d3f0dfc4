"""Run of a sweep: cases to workers in warm-start order, one result file each, resumable."""

from __future__ import annotations

import shutil
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.files import atomic_write, load_json, write_json
from stiffopt.folders import is_regular
from stiffopt.sweep.cases import Case, Sweep
from stiffopt.sweep.solve_case import CaseResult, case_document, solve_case
from stiffopt.sweep.workers import Workers
from stiffopt.units import number_and_unit

CASES_FOLDER = "cases"
# Folder of warm starts; removed when the sweep is complete.
_WARM_FOLDER = "warm"


@dataclass(frozen=True)
class SweepProgress:
    """Progress of a sweep."""

    # Cases, earlier runs included.
    done: int
    total: int
    unusable: int  # cases done without a usable result
    # Elapsed and estimated remaining time of this run [s].
    elapsed: float
    left: float | None


ProgressCallback = Callable[[SweepProgress], object]


def run_sweep(
    sweep: Sweep, folder: Path, pool: Workers, progress: ProgressCallback | None = None
) -> tuple[list[dict[str, Any] | None], bool]:
    """Solve the cases without a result file.

    `folder`: its subfolder `cases` holds the result files. `progress`: called with a
    `SweepProgress` at the start and after each case. Returns the content of each case's file, None
    for cases not reached before Ctrl-C, and True if it was interrupted.
    """
    for place in (folder / CASES_FOLDER, folder / CASES_FOLDER / _WARM_FOLDER):
        if place.is_symlink() or (place.exists() and not place.is_dir()):
            raise InputFileError(
                place, "", "is a link or a file, where the sweep needs a folder for its cases. "
                "Remove or rename it."
            )  # fmt: skip
    own = {case.key: case for case in sweep.cases}
    results = {key: found for key in own if (found := _read_case(folder, key)) is not None}
    watch = _ProgressWatch(len(own), results, progress)
    queue = _CaseQueue(list(own.values()), set(results), folder)
    try:
        for found, end in _solve_cases(queue, pool):
            # The warm start first: successors of a finished case need it.
            if end is not None:
                atomic_write(queue.file(found["key"]), end)
            write_json(_case_file(folder, found["key"]), found)
            results[found["key"]] = found
            queue.done.add(found["key"])
            watch.report()
    except KeyboardInterrupt:
        pool.close(now=True)
        return [results.get(case.key) for case in sweep.cases], True
    except BaseException:
        pool.close(now=True)
        raise
    pool.close(now=False)
    shutil.rmtree(folder / CASES_FOLDER / _WARM_FOLDER, ignore_errors=True)
    return [results.get(case.key) for case in sweep.cases], False


class _CaseQueue:
    """Queue of open cases, each after its predecessor.

    `done`: keys of cases with a result.
    """

    def __init__(self, cases: list[Case], done: set[str], folder: Path) -> None:
        self.done, self._folder = done, folder
        self._before = predecessors(cases)
        self._waiting = deque(case for case in spread_order(cases) if case.key not in done)

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def take(self) -> Case | None:
        """Remove and return the next case whose predecessor is done; None without one."""
        for case in self._waiting:
            before = self._before[case.key]
            if before is None or before in self.done:
                self._waiting.remove(case)
                return case
        return None

    def warm(self, case: Case) -> bytes | None:
        """Warm start of a case: final state of its nearest predecessor that has one."""
        before = self._before[case.key]
        while before is not None:
            path = self.file(before)
            # Largest warm-start file [bytes]: 16 million variables and multipliers.
            if is_regular(path.parent, path.name) and path.stat().st_size <= 2**27:
                return path.read_bytes()
            before = self._before[before]
        return None

    def file(self, key: str) -> Path:
        """File of a case's warm start."""
        return self._folder / CASES_FOLDER / _WARM_FOLDER / key


_SolvedCase = tuple[dict[str, Any], bytes | None]


def _solve_cases(queue: _CaseQueue, pool: Workers) -> Iterator[_SolvedCase]:
    """Yield results as they come; retry cases whose worker died."""
    alone = deque[Case]()
    deaths: dict[str, int] = {}
    busy: dict[Future[_SolvedCase], Case] = {}
    lonely = False
    while queue or alone or busy:
        if alone and not busy:
            # A retry runs alone, to attribute the death to its case.
            case = alone.popleft()
            busy[pool.submit(solve_case, case, queue.warm(case))] = case
            lonely = True
        while not (alone or lonely) and len(busy) < pool.slots:
            following = queue.take()
            if following is None:
                break
            busy[pool.submit(solve_case, following, queue.warm(following))] = following
        done, _ = wait(busy, return_when=FIRST_COMPLETED)
        for future in done:
            case = busy.pop(future)
            try:
                yield future.result()
            except pool.lost:
                deaths[case.key] = deaths.get(case.key, 0) + lonely
                # Deaths of a worker that ran a case alone, after which the case counts as failed.
                if deaths[case.key] < 2:
                    alone.append(case)
                else:
                    text = "Its worker process died at each attempt, for example out of memory."
                    yield case_document(case, CaseResult("failed", text, {}, {}), 0.0), None
        lonely = lonely and bool(busy)


class _ProgressWatch:
    """Count cases and estimate the remaining time."""

    def __init__(
        self, total: int, results: dict[str, dict[str, Any]], progress: ProgressCallback | None
    ) -> None:
        self._total, self._results, self._progress = total, results, progress
        self._begin, self._before = time.monotonic(), len(results)
        self.report()

    def report(self) -> None:
        if self._progress is None:
            return
        done, elapsed = len(self._results), time.monotonic() - self._begin
        own = done - self._before
        left = elapsed / own * (self._total - done) if own else None
        bad = sum(is_unusable(each) for each in self._results.values())
        self._progress(SweepProgress(done, self._total, bad, elapsed, left))


def is_unusable(found: dict[str, Any]) -> bool:
    """Return True if a case has no usable result."""
    usable = (
        "optimal", "acceptable", "named", "law_found", "nothing_missing", "outside_catalogue",
    )  # fmt: skip
    return found["status"] not in usable


def _case_file(folder: Path, key: str) -> Path:
    return folder / CASES_FOLDER / f"{key}.json"


def _read_case(folder: Path, key: str) -> dict[str, Any] | None:
    """Read a case's file; None if it is absent or of another case."""
    path = _case_file(folder, key)
    with suppress(InputFileError):
        found = load_json(path) if is_regular(path.parent, path.name) else None
        # Failed cases are tried again.
        if _is_document(found) and found["key"] == key and found["status"] != "failed":
            return found
    return None


def _is_document(found: Any) -> TypeGuard[dict[str, Any]]:
    """Return True if a file has the fields that tables and reports need."""
    kinds = {"key": str, "status": str, "message": str, "values": dict, "maximised": bool}
    return (
        isinstance(found, dict)
        and all(isinstance(found.get(name), kind) for name, kind in kinds.items())
        and all(
            isinstance(entry, dict)
            and isinstance(entry.get("unit"), str)
            and isinstance(entry.get("value"), float | int | str | None)
            for entry in found["values"].values()
        )
    )


def spread_order(cases: list[Case]) -> list[Case]:
    """Order cases so that early ones are far apart.

    The first case starts cold. Each following round doubles the number of cases; every case
    starts from the nearest of earlier rounds. So nearly all starts are near, few cases wait, and
    the start of a case depends neither on workers nor on interruptions.
    """
    count = max(len(cases) - 1, 1).bit_length()
    # Bit-reversed numbers spread evenly over a grid.
    keys = [int(f"{number:0{count}b}"[::-1], 2) for number in range(len(cases))]
    return [cases[k] for k in np.argsort(keys, kind="stable")]


def predecessors(cases: list[Case]) -> dict[str, str | None]:
    """Key of each case's warm-start case, by its own key; None for cold starts."""
    found: dict[str, str | None] = {}
    groups: dict[object, list[Case]] = {}
    for case in spread_order(cases):
        found[case.key] = None
        # Other kinds than trajectories, and further initial guesses, start cold.
        if case.kind == "trajectory" and case.start == 0:
            groups.setdefault(case.base, []).append(case)
    for own in groups.values():
        places = _normalised_values(own)
        for k in range(1, len(own)):
            rounds = 1 << (k.bit_length() - 1)
            distance = np.abs(places[:rounds] - places[k]).sum(axis=1)
            found[own[k].key] = own[int(np.argmin(distance))].key
    return found


def _normalised_values(cases: list[Case]) -> np.ndarray:
    """Varied values (cases, values) scaled to 0 to 1; texts count by their rank."""
    columns = []
    for k in range(len(cases[0].changes)):
        values = [case.changes[k][1] for case in cases]
        numbers = [number_and_unit(value)[0] for value in values]
        if not np.all(np.isfinite(numbers)):
            texts = sorted({str(value) for value in values})
            numbers = [float(texts.index(str(value))) for value in values]
        column = np.array(numbers)
        columns.append((column - column.min()) / (np.ptp(column) or 1.0))
    return np.stack(columns, axis=1) if columns else np.zeros((len(cases), 0))
