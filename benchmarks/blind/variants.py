"""The tool with a part taken out, in a process of its own: VARIANT CASE OUT [EFFECT] [--model].

Parts are taken out here, from outside, so that the tool itself has no switch for them.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).parents[2]


@contextmanager
def whole(_: str) -> Iterator[None]:
    """The tool as it is."""
    yield


@contextmanager
def without_nuisance(_: str) -> Iterator[None]:
    """Nominal values are taken for exact: nothing is profiled out."""
    from stiffopt.discovery import training
    from stiffopt.discovery.comparison import nuisance
    from stiffopt.recording.nominal import Tolerance

    names = vars(nuisance.merge_tolerances(Tolerance(), Tolerance()))
    exact = Tolerance(**dict.fromkeys(names, 0.0))
    with mock.patch.object(training, "merge_tolerances", return_value=exact):
        yield


@contextmanager
def without_cross_validation(_: str) -> Iterator[None]:
    """A candidate need not predict recordings left out."""
    from stiffopt.discovery.search.candidates import Scorer

    judge = Scorer.score

    def score(self: Any, located: Any, price: float = 0.0) -> Any:
        found = judge(self, located, price)
        return None if found is None else replace(found, gain=math.inf)

    with mock.patch.object(Scorer, "score", score):
        yield


@contextmanager
def without_abstention(_: str) -> Iterator[None]:
    """Whatever fits best is named, however little it is worth; nothing is outside."""
    from stiffopt.discovery import diagnose
    from stiffopt.discovery.search import search

    with ExitStack() as stack:
        for bar in ("NAMED_EVIDENCE", "NAMED_DEVIATIONS", "NAMED_SHARE"):
            stack.enter_context(mock.patch.object(search, bar, 0.0))
        keep = mock.patch.object(
            diagnose, "assess_findings", lambda result: (result.selected, None)
        )
        stack.enter_context(keep)
        stack.enter_context(mock.patch.object(diagnose, "find_bursts", return_value=None))
        yield


@contextmanager
def without_effect(name: str) -> Iterator[None]:
    """The catalogue lacks an effect."""
    from stiffopt.discovery import diagnose

    kept = tuple(effect for effect in diagnose.CATALOGUE if effect.name != name)
    if len(kept) == len(diagnose.CATALOGUE):
        raise SystemExit(f"The catalogue has no effect {name!r} to take out.")
    with mock.patch.object(diagnose, "CATALOGUE", kept):
        yield


VARIANTS: dict[str, Callable[[str], Any]] = {
    entry.__name__: entry
    for entry in (
        whole,
        without_nuisance,
        without_cross_validation,
        without_abstention,
        without_effect,
    )
}


@dataclass(frozen=True)
class Job:
    """One diagnosis: a variant of the tool on a recording set, its answer in a folder.

    `effect` is the one that a variant takes out, `model` the extended model to start from.
    """

    variant: str
    case: Path
    out: Path
    effect: str = ""
    model: Path | None = None


def answers(
    jobs: Sequence[Job], workers: int, say: Callable[[str], object], timeout: float = 900.0
) -> list[dict[str, Any] | None]:
    """Content of diagnosis.json of every job; None where there was no answer.

    Jobs answered before are not run again.
    """

    def answer(job: Job) -> dict[str, Any] | None:
        path = job.out / "diagnosis.json"
        if not path.exists():
            begin = time.perf_counter()
            command = [sys.executable, "-m", "benchmarks.blind.variants"]
            command += [job.variant, str(job.case), str(job.out), job.effect]
            command += [] if job.model is None else ["--model", str(job.model)]
            single = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
            try:
                done = subprocess.run(
                    command, cwd=ROOT, env=single, capture_output=True, text=True,
                    timeout=timeout, check=False,
                )  # fmt: skip
            except subprocess.TimeoutExpired:
                say(f"{job.out.name}: no answer within {timeout:.0f} s")
                return None
            if done.returncode:
                say(f"{job.out.name}: {done.stderr.strip().splitlines()[-1:]}")
                return None
            say(f"{job.variant} {job.out.name}: {time.perf_counter() - begin:.0f} s")
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return found

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(answer, jobs))


def main() -> None:
    """Run one variant."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.variants")
    parser.add_argument("variant", choices=sorted(VARIANTS))
    parser.add_argument("case", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("effect", nargs="?", default="")
    parser.add_argument("--model", type=Path)
    given = parser.parse_args()
    from stiffopt.discovery.diagnose import diagnose
    from stiffopt.discovery.store import write_diagnosis

    with VARIANTS[given.variant](given.effect):
        found = diagnose(given.case, model=given.model, experiment=False)
    given.out.mkdir(parents=True, exist_ok=True)
    write_diagnosis(found, given.out)


if __name__ == "__main__":
    main()
