"""Hide, diagnose the difference, write the page; what was answered before is not run again.

    python -m benchmarks.real_concealed [--cases 60] [--controls 12] [--seconds S] [--key dev-...]

The tool starts from the model that it found for the set without the concealment, so that what it
names is the difference, and once more from the nominal model, as a first user would. Recordings are
in the folder of STIFFOPT_RECORDINGS.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.key import key_under_test
from benchmarks.blind.real import RECORDINGS
from benchmarks.blind.sets import Columns, write_set
from benchmarks.blind.variants import Job, answers

from .draw import WEIGHTS, Plan, plans
from .hide import Kind, hidden, size, softer
from .motion import PublicSet
from .page import page

HERE = Path(__file__).parent


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.real_concealed")
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--controls", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--key", help="for development; begins with dev-")
    parser.add_argument("--commit", default="HEAD", help="whose run is gone on with")
    parser.add_argument("--work", type=Path, default=HERE / "work")
    given = parser.parse_args()
    key = key_under_test(given.key, given.commit)
    sets = {
        name: PublicSet(RECORDINGS / name)
        for name in WEIGHTS
        if (RECORDINGS / name / "recordings.toml").exists()
    }
    if not sets:
        print(f"No recordings in {RECORDINGS}; name their folder in STIFFOPT_RECORDINGS.")
        return
    folder = given.work / key.text[:16]
    begin = time.monotonic()
    made = plans(key, sets, given.cases, given.controls)
    rows: list[tuple[Plan, dict[str, Any]]] = []
    repeats = 0
    for ways in made:
        done = folder / ways[0].name / "case.json"
        if not done.exists() and time.monotonic() - begin < given.seconds:
            _run(ways, sets, folder, [identity(*row) for row in rows])
        if done.exists():
            found = json.loads(done.read_text())
            if found["drawn"] is None:
                repeats += 1
            else:
                rows.append((ways[found["drawn"]], found))
    text = page(key, rows, len(made) - repeats)
    (HERE / "RESULTS.md").write_text(text, encoding="utf-8")
    print(text)


def identity(plan: Plan, found: dict[str, Any]) -> tuple[Any, ...]:
    """What makes a case another: set, kind, joint and amount; of controls what they lose."""
    if plan.kind is None:
        return plan.source, None, plan.size
    return plan.source, plan.kind.name, found["joint"], float(f"{found['amount']:.3g}")


def _run(
    ways: Sequence[Plan],
    sets: dict[str, PublicSet],
    folder: Path,
    known: Sequence[tuple[Any, ...]],
) -> None:
    """Make the first of some cases that is no repeat, diagnose it, and leave what is to count."""
    for drawn, plan in enumerate(ways):
        first = Job("whole", sets[plan.source].folder, folder / "first" / plan.source)
        (model,) = answers([first], 1, _say)
        if model is None:
            return
        amount, reached, joint = 0.0, 0.0, 0
        if plan.kind is not None:
            amount, reached, joint = _amount(plan, sets[plan.source], model)
        case = {"drawn": drawn, "joint": joint, "amount": amount, "size": reached}
        if identity(plan, case) not in known:
            _diagnose(plan, sets[plan.source], folder, first, case)
            return
    _keep(folder, ways[0], {"drawn": None})


def _diagnose(plan: Plan, s: PublicSet, folder: Path, first: Job, made: dict[str, Any]) -> None:
    """Hide what was drawn, and diagnose the difference."""
    begin, case = time.monotonic(), folder / plan.name / "set"
    joint, amount = int(made["joint"]), float(made["amount"])
    shutil.rmtree(case, ignore_errors=True)
    if plan.kind is None:
        _shorter(plan, s, case)
    else:
        hidden(s, plan.kind, joint, amount, case)
    stopped = plan.kind is not None and plan.kind.where == "sign" and _doubted(case)
    answer, fresh = None, None
    if not stopped:
        model = first.out / "extended.toml"
        out = folder / plan.name / "answer"
        if plan.kind is not None and plan.kind.where == "stiffness":
            # The model brings the nominal values that it was made with.
            out.mkdir(parents=True, exist_ok=True)
            model = softer(model, joint, amount, out / "softer.toml")
        else:
            (fresh,) = answers([Job("whole", case, folder / plan.name / "from_nominal")], 1, _say)
        (answer,) = answers([Job("whole", case, out, model=model)], 1, _say)
    (without,) = answers([first], 1, _say)
    shutil.rmtree(case, ignore_errors=True)
    kept = {
        **made,
        "truth": [] if plan.kind is None else [vars(t) for t in plan.kind.truth(s, joint)],
        "stopped": stopped,
        "verdict": None if answer is None else answer["verdict"],
        "findings": [] if answer is None else answer["findings"],
        "from_nominal": None if fresh is None else fresh["findings"],
        "without": [] if without is None else without["findings"],
        "seconds": time.monotonic() - begin,
    }
    _keep(folder, plan, kept)
    _say(f"{plan.name} {plan.source}: {kept['seconds']:.0f} s")


def _keep(folder: Path, plan: Plan, kept: dict[str, Any]) -> None:
    (folder / plan.name).mkdir(parents=True, exist_ok=True)
    (folder / plan.name / "case.json").write_text(json.dumps(kept, indent=1))


def _amount(plan: Plan, s: PublicSet, known: dict[str, Any]) -> tuple[float, float, int]:
    """Units that make the size, the size in multiples of what is left, and the joint."""
    kind = plan.kind
    assert kind is not None
    if kind.where == "sign":
        return 1.0, 0.0, plan.joints[0]
    channel = "torque" if kind.where == "torque" else "link_position"
    left = {c["channel"]: c["rms_after"] for c in known["fit"]["channels"]}

    def reached(joint: int, amount: float) -> float:
        rms = size(s, kind, joint, amount)
        return float(max(v / left.get(f"{channel}_{j + 1}", np.inf) for j, v in enumerate(rms)))

    if kind.where == "stiffness":
        first = plan.joints[0]
        return plan.size, reached(first, 1.0 / plan.size - 1.0), first
    best = (0.0, 0.0, plan.joints[0])
    for joint in plan.joints:
        unit = reached(joint, 1.0)
        if unit <= 0.0:
            continue
        wanted, amount = plan.size, _enough(plan.size, unit, kind, partial(reached, joint))
        while amount > kind.most:
            wanted /= 2.0
            amount = _enough(wanted, unit, kind, partial(reached, joint))
        if wanted > best[1]:
            best = plan.sign * amount, wanted, joint
        if wanted == plan.size:
            break
    return best


def _enough(wanted: float, unit: float, kind: Kind, reached: Callable[[float], float]) -> float:
    """Units that make a size; a delay does less and less beyond half a period of what is late."""
    if kind.name != "delay":
        return wanted / unit
    tried = np.geomspace(0.1, kind.most, 40)
    enough = [x for x in tried if reached(float(x)) >= wanted]
    return float(enough[0]) if enough else float("inf")


def _shorter(plan: Plan, s: PublicSet, target: Path) -> None:
    """The set with less of the beginning of its training runs."""
    train = {Path(file).stem for file in s.runs("train")}

    def change(name: str, columns: Columns) -> Columns:
        if name not in train:
            return columns
        time_ = columns[s.told["signals"]["time"]]
        kept = time_ >= time_[0] + plan.size * (time_[-1] - time_[0])
        return {key: values[kept] for key, values in columns.items()}

    write_set(s.folder, target, s.told, change)


def _doubted(case: Path) -> bool:
    """Whether the tool stops before any diagnosis: the files cannot be what they say."""
    from stiffopt.discovery.sanity.gate import SanityGate
    from stiffopt.discovery.training import open_training_runs
    from stiffopt.recording.recording_set import load_recordings

    recordings = load_recordings(case)
    return bool(SanityGate(recordings, open_training_runs(recordings)).doubts)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
