"""What parts of the tool are worth: the same cases without each of them.

python -m benchmarks.blind.ablation KEY_FOLDER [--cases N] [--jobs J]
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.blind.extras import key_folder, save
from benchmarks.blind.score import CaseScore, fits, judged
from benchmarks.blind.tally import counted, score_all
from benchmarks.blind.variants import Job, answers
from benchmarks.blind.wilson import Rate

PARTS = {
    "whole": "the whole tool",
    "without_nuisance": "without nuisance profiling",
    "without_cross_validation": "without whole-recording cross-validation",
    "without_abstention": "without the abstention tests",
}


def chosen(scores: Sequence[CaseScore], most: int) -> list[CaseScore]:
    """The first cases of every kind: half with one effect, a third with nothing, some outside."""
    picked: list[CaseScore] = []
    for kind, share in (("single", 1 / 2), ("none", 1 / 3), ("outside", 1 / 6)):
        own = [s for s in counted(scores) if s.kind == kind]
        picked += own[: max(1, round(share * most))]
    return picked


def ablate(
    folder: Path, scores: Sequence[CaseScore], most: int, workers: int, say: Callable[[str], object]
) -> Path:
    """Run every variant on some cases and leave the section for the page."""
    cases = chosen(scores, most)
    rows = []
    for variant, name in PARTS.items():
        # What the whole tool says of these cases is there.
        place = folder / "answers" if variant == "whole" else folder / "ablation" / variant
        jobs = [Job(variant, folder / "cases" / s.id, place / s.id) for s in cases]
        found = answers(jobs, workers, say)
        counts: dict[str, list[bool | None]] = {
            key: [] for key in ("exact", "detected", "false_alarm", "recognised")
        }
        false, share = [], []
        for job, score, answer in zip(jobs, cases, found, strict=True):
            truth = json.loads((folder / "truth" / f"{score.id}.json").read_text())
            told = judged(truth, answer)
            for key, values in counts.items():
                values.append(told.get(key))
            if score.kind == "single":
                false.append(told["false_components"])
                fit = fits(job.case, job.out, folder / "oracle" / score.id, ("tau", "ql"))
                share.append(fit["test"].share if "test" in fit else 0.0)
        rates = [str(Rate.of(values)) for values in counts.values()]
        mean = f"{np.mean(false):.2f}" if false else ""
        rows.append([name, *rates, mean, f"{np.nanmedian(share):.2f}" if share else ""])
    text = f"{len(cases)} cases of this run, the first of each kind."
    head = [
        "", "effect and joint first", "detected", "false alarms", "outside recognised",
        "false components a case", "share on test, median",
    ]  # fmt: skip
    return save(folder, "ablation", {"title": "Ablation", "text": text, "head": head, "rows": rows})


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.ablation")
    parser.add_argument("folder", type=key_folder, help="folder of a key")
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    say = lambda text: print(text, file=sys.stderr)  # noqa: E731
    print(
        ablate(given.folder, score_all(given.folder, residuals=False), given.cases, given.jobs, say)
    )


if __name__ == "__main__":
    main()
