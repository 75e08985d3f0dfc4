"""What every gate of the tool is worth: the same cases without each of them.

python -m benchmarks.blind.ablation KEY_FOLDER... [--cases N] [--jobs J]

Cases are those of the keys, and some of them again with [tolerance] and nominal friction left out,
as first users have it. A gate is taken out of the cases in which it acted; in all others the answer
without it is that of the whole tool.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.extras import key_folder, save
from benchmarks.blind.gates import GATES, noticing, without_gate
from benchmarks.blind.score import judged
from benchmarks.blind.wilson import Rate

WHOLE = "whole"
# Every so many cases are diagnosed without tolerances and nominal friction as well.
SILENT_SHARE = 2
_SILENT = re.compile(
    r"^\[tolerance\]\n(?:[^\[\n].*\n|\n)*|^(?:coulomb|viscous) = .*\n", re.MULTILINE
)
COLUMNS = {
    "exact": "first",
    "false_alarm": "false alarms",
    "recognised": "outside recognised",
    "covered": "intervals that hold the truth",
}


def silent_copy(case: Path, folder: Path) -> Path:
    """A copy of a case that states neither tolerances nor friction."""
    out = folder / f"{case.name}_silent"
    if not out.exists():
        shutil.copytree(case, out)
        file = out / "recordings.toml"
        file.write_text(_SILENT.sub("", file.read_text()))
    return out


def answer(case: Path, truth: dict[str, Any], gate: str) -> tuple[dict[str, Any], list[str]]:
    """Scores of a diagnosis without a gate; of the whole tool with the gates that acted."""
    from stiffopt.discovery.diagnose import diagnose
    from stiffopt.discovery.store import answer_document

    taken = next((each for each in GATES if each.name == gate), None)
    notice = noticing(GATES) if taken is None else nullcontext(set())
    with notice as acted, nullcontext() if taken is None else without_gate(taken):
        found = diagnose(case, experiment=False)
    # Values that every arm has are no findings.
    own = tuple(each for each in found.findings if not each.located.calibrated)
    verdict = found.verdict
    if not own:
        verdict = "nothing_missing" if found.unexplained is None else "outside_catalogue"
    told = judged(truth, answer_document(replace(found, findings=own, verdict=verdict)))
    scores = {key: told[key] for key in COLUMNS if key in told}
    scores["covered"] = [each.covered for each in told.get("parameters", ())]
    scores["false"] = told.get("false_components", 0) if truth["kind"] == "single" else None
    scores["said"] = [f"{f.located.label} {f.probability:.2f}" for f in own] + [verdict]
    return scores, sorted(acted)


def ask(case: Path, truth: dict[str, Any], known: Path) -> dict[str, dict[str, Any]]:
    """Scores of a case by gate, as far as they are not in a file."""
    scores: dict[str, dict[str, Any]] = json.loads(known.read_text()) if known.exists() else {}
    if not scores:
        scores[WHOLE], acted = answer(case, truth, WHOLE)
        scores |= {gate: {} for gate in acted}
        known.parent.mkdir(parents=True, exist_ok=True)
    for gate in [each for each, found in scores.items() if not found]:
        known.write_text(json.dumps(scores))
        try:
            scores[gate], _ = answer(case, truth, gate)
        except Exception as error:
            scores[gate] = {"said": [repr(error)]}
    known.write_text(json.dumps(scores))
    return scores


def ablate(folders: Sequence[Path], most: int, workers: int, say: Callable[[str], object]) -> Path:
    """Ask all cases of the keys without each gate and leave the section for the page."""
    jobs: list[tuple[Path, dict[str, Any], Path]] = []
    for folder in folders:
        out = folder / "ablation"
        names = sorted(each.stem for each in (folder / "truth").glob("*.json"))
        names = names[:: -(-len(names) // most)]  # of every suite
        for number, name in enumerate(names):
            truth = json.loads((folder / "truth" / f"{name}.json").read_text())
            cases = [folder / "cases" / name]
            if number % SILENT_SHARE == 0:
                out.mkdir(exist_ok=True)
                cases.append(silent_copy(cases[0], out))
            jobs += [(case, truth, out / f"{case.name}.json") for case in cases]
    found = []
    with ProcessPoolExecutor(workers) as pool:
        asked = {pool.submit(ask, *job): job[0].name for job in jobs}
        for each in as_completed(asked):
            try:
                found.append(each.result())
            except Exception as error:
                say(f"{asked[each]}: {error!r}"[:200])
                continue
            say(asked[each])
    rows = [_row("the whole tool", WHOLE, found)]
    rows += [_row(f"without {gate.name}: {gate.words}", gate.name, found) for gate in GATES]
    text = f"{len(found)} diagnoses; a third states neither tolerances nor friction."
    head = ["", "acted in", *COLUMNS.values(), "false components a case", "answers changed"]
    return save(
        folders[0], "ablation", {"title": "Ablation", "text": text, "head": head, "rows": rows}
    )


def _row(words: str, gate: str, found: Sequence[dict[str, dict[str, Any]]]) -> list[str]:
    own = [each.get(gate, each[WHOLE]) for each in found]
    rates = [str(Rate.of([each.get(key) for each in own])) for key in COLUMNS if key != "covered"]
    covered = [value for each in own for value in each.get("covered", ())]
    false = [each["false"] for each in own if each.get("false") is not None]
    changed = sum(
        each[WHOLE]["said"] != mine["said"] for each, mine in zip(found, own, strict=True)
    )
    acted = sum(gate in each for each in found)
    return [words, str(acted), *rates, str(Rate.of(covered)), f"{np.mean(false):.2f}", str(changed)]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.ablation")
    parser.add_argument("folders", nargs="+", type=key_folder, help="folders of keys")
    parser.add_argument("--cases", type=int, default=24, help="of each key")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    say = lambda text: print(text, file=sys.stderr, flush=True)  # noqa: E731
    print(ablate(given.folders, given.cases, given.jobs, say))


if __name__ == "__main__":
    main()
