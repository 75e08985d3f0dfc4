"""Replay of a solve: the stored recipe is solved again and compared stage by stage.

The recipe of a result is its problem file with the changes of --set, the solved state it started
from, if any, and the programmes solved in order. Numbers of iterations are not compared: solves of
the same inputs were seen to reach the same optimum in 35 and in 38 iterations.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stiffopt.errors import InputFileError
from stiffopt.recipe.stored_result import (
    check_inputs,
    read_guess,
    read_problem,
    read_state,
)
from stiffopt.result.provenance import versions
from stiffopt.result.solution import Solution
from stiffopt.result.status import ProgressCallback
from stiffopt.result.store import RESULT_FILE, read_document
from stiffopt.solver.family import ProblemFamily

# Relative difference of objectives up to which two platforms agree.
REPLAY_TOLERANCE = 1e-9
# Facts of a stage that two replays have in common.
_STAGE_FACTS = ("intervals", "smoothing", "status")


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Second solve of a stored result."""

    solution: Solution
    # Versions that differ, and the first stage or value that does; empty where all agrees.
    differences: tuple[str, ...]


def replay(folder: Path, *, progress: ProgressCallback | None = None) -> Replay:
    """Solve the recipe of a result folder again, from the same state, and compare.

    Raises `InputFileError`: a file is missing, the problem has changed, or the plan is of an
    extended model.
    """
    path = folder / RESULT_FILE
    document = read_document(path)
    if "model" in document:
        raise InputFileError(
            path, "model", "was solved with --model; run `stiffopt solve --model` again instead."
        )
    loaded = read_problem(path, document)
    stated = loaded.problem
    check_inputs(path, document, loaded.path, stated)
    guess = state = None
    if isinstance(document.get("guess"), str):
        begin = folder / str(document["guess"])
        guess, state = functools.partial(read_guess, begin, stated), read_state(begin)
    solution, _ = ProblemFamily().solve(stated, state, guess=guess, progress=progress)
    return Replay(solution=solution, differences=tuple(_find_differences(document, solution)))


def _find_differences(document: dict[str, Any], solution: Solution) -> list[str]:
    """Return what differs from the stored result: versions, then the first stage or the answer."""
    solver, own = document.get("solver") or {}, solution.solver
    before = document.get("versions") or {}
    found = [
        f"{name} is {now}, was {before.get(name, 'not there')}"
        for name, now in versions().items()
        if before.get(name) != now
    ]
    stored = solver.get("homotopy") or []
    for number, (old, new) in enumerate(zip(stored, own.homotopy, strict=False), start=1):
        facts = [
            f"{name} {new[name]}, was {old.get(name)}"
            for name in _STAGE_FACTS
            if old.get(name) != new[name]
        ]
        if not facts and _differ(old.get("objective"), new["objective"]):
            facts = [f"objective {new['objective']!r}, was {old.get('objective')!r}"]
        if facts:
            return [*found, f"stage {number}: {', '.join(facts)}"]
    if len(stored) != len(own.homotopy):
        return [*found, f"{len(own.homotopy)} stages were solved, before {len(stored)}"]
    if list(solver.get("left_out") or []) != list(own.left_out):
        left = ", ".join(own.left_out) or "nothing"
        return [*found, f"the time limit left out {left}"]
    value = document.get("objective") or {}
    now = None if solution.objective is None else solution.objective.value
    if _differ(value.get("value"), now):
        return [*found, f"certified objective {now!r}, was {value.get('value')!r}"]
    return found


def _differ(old: object, new: object) -> bool:
    """Return True where two numbers differ by more than the tolerance, or one is missing."""
    if not isinstance(old, float | int) or not isinstance(new, float | int):
        return old is not new
    return abs(old - new) > REPLAY_TOLERANCE * max(abs(old), abs(new))
