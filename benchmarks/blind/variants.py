"""The tool with a part taken out, in a process of its own: VARIANT CASE OUT [EFFECT] [--model].

Parts are taken out here, from outside, so that the tool itself has no switch for them.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).parents[2]


@contextmanager
def whole(_: str) -> Iterator[None]:
    """The tool as it is."""
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
