"""Diagnosis of an arm that swings within its own motion: `big6` with 5 to 15 kg, seen blind.

    python -m benchmarks.large_arm --none 100 --single 150 --work out/large_arm
    python -m benchmarks.large_arm --robot arm7 --none 20 --single 30 --work out/large_arm

Cases with nothing missing count false alarms and what is left of runs never fitted to, over what
the exact signals leave; cases with one effect count names, places and intervals. A run that was
stopped goes on where it was, and the page of results tells how many cases it is of.
"""

from __future__ import annotations

import argparse
import os
import threading
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.cases import write_exact
from benchmarks.blind.key import Key
from benchmarks.blind.mix import CATALOGUE, RATE, SECONDS, SEVERITIES, SUBSTEPS, places_of
from benchmarks.blind.oracle import balances, held_out
from benchmarks.blind.score import CaseScore, score_case
from benchmarks.blind.severity import START, sized
from benchmarks.blind.store import Store, whole_folder, write_json, write_text
from benchmarks.blind.tool import TIMEOUT, answer
from benchmarks.blind.wilson import wilson
from benchmarks.simulator import CaseSpec, simulate, truth_text, write_case

# Payloads of the robots [kg].
PAYLOADS = {"big6": (5.0, 15.0), "arm7": (2.0, 8.0), "pallet4": (5.0, 40.0), "scara4": (1.0, 6.0)}
SMOOTHINGS = (0.42, 0.3, 0.2)  # of the corners of the motion, in turn [s]: the last excite swing


def base_spec(key: Key, robot: str, name: str) -> CaseSpec:
    """Motions, tolerances and payload of a case."""
    draw = key.draw(name)
    return CaseSpec(
        robot=robot,
        seed=int(draw.integers(2**62)),
        seconds=SECONDS,
        rate=RATE,
        substeps=SUBSTEPS,
        payload=round(float(draw.uniform(*PAYLOADS[robot])), 2),
        smoothing=SMOOTHINGS[int(name.partition("_")[2]) % len(SMOOTHINGS)],
        name=name,
    )


def drawn(key: Key, robot: str, name: str) -> tuple[CaseSpec, dict[str, Any]]:
    """Specification of a case, with what is said about it in its truth."""
    spec = base_spec(key, robot, name)
    kind, _, number = name.partition("_")
    known: dict[str, Any] = {"suite": "large", "kind": kind, "severity": 0.0}
    if kind == "none":
        return spec, known
    index = int(number)
    turn, place = divmod(index, len(CATALOGUE))
    order = key.shuffled(CATALOGUE, "effect", turn)
    severities = key.shuffled(SEVERITIES, "severity", index // len(SEVERITIES))
    severity = severities[index % len(SEVERITIES)]
    for effect in (order[place], *key.shuffled(CATALOGUE, name, "next")):
        for joint in places_of(key, robot, name, effect)[:2]:
            found = sized(spec, effect, joint, START[effect])
            if found is not None:
                chosen = ((effect, joint, found.size * severity),)
                return replace(spec, effects=chosen), {**known, "severity": severity}
    raise RuntimeError(f"no effect can be seen in {name}")


def make(key: Key, robot: str, name: str, store: Store) -> None:
    """Make and seal a case that is not there yet."""
    if store.made(name):
        return
    spec, known = drawn(key, robot, name)
    case = simulate(spec)
    case.truth.update(id=name, link_encoders=True, spec=asdict(spec), **known)
    write_text(store.truth(name), truth_text(case))
    with whole_folder(store.oracle_predictions(name)) as folder:
        write_exact(case, folder)
    z = balances(case).z if spec.effects else 0.0
    write_json(store.oracle(name), {"id": name, "z": z, **held_out(case)})
    with whole_folder(store.case(name)) as folder:
        write_case(case, folder)


def _share(hits: int, total: int) -> str:
    low, high = wilson(hits, total) if total else (0.0, 1.0)
    return f"{hits} of {total} ({100 * low:.1f} to {100 * high:.1f} %)"


def page(key: str, robot: str, asked: int, scores: list[CaseScore]) -> str:
    """Results of the cases that were answered."""
    none = [s for s in scores if s.kind == "none"]
    single = [s for s in scores if s.kind == "single"]
    fits = [s.fit["test"] for s in none if "test" in s.fit]
    values = [p for s in single if s.exact for p in s.parameters]
    ratios = np.array([f.after / f.oracle for f in fits])
    least, most = PAYLOADS[robot]
    lines = [
        "# A large arm that swings within its own motion",
        "",
        f"Key `{key}`: {len(scores)} of {asked} cases were run, `{robot}` with {least:g} to"
        f" {most:g} kg; motions with corners rounded over"
        f" {', '.join(f'{s:g}' for s in SMOOTHINGS)} s in turn. Intervals are Wilson's, 95 %.",
        "",
        "| | asked | measured |",
        "|---|---|---|",
        "| nothing missing: false alarms | 3 % at most |"
        f" {_share(sum(bool(s.false_alarm) for s in none), len(none))} |",
    ]
    if ratios.size:
        lines.append(
            "| held-out residual over the oracle's | 1.15 at most |"
            f" median {np.median(ratios):.3f}, largest {ratios.max():.3f} |"
        )
    lines += [
        "| one effect: effect and joint first | no worse than before |"
        f" {_share(sum(bool(s.exact) for s in single), len(single))} |",
        "| 95 % intervals that hold the truth | 88 to 98 % |"
        f" {_share(sum(p.covered for p in values), len(values))} |",
        "",
        "| case | missing | said | held-out residual over noise, the oracle's | CPU s |",
        "|---|---|---|---|---|",
        *(_line(score) for score in scores),
    ]
    return "\n".join(lines) + "\n"


def _line(score: CaseScore) -> str:
    fit = score.fit.get("test")
    ratio = "" if fit is None else f"{fit.after:.3f}, {fit.oracle:.3f}"
    truth = ", ".join(t.label for t in score.truth) or "nothing"
    said = ", ".join(s.label for s in score.said) or str(score.verdict)
    return f"| {score.id} | {truth} | {said} | {ratio} | {score.cpu:.0f} |"


def main() -> None:
    """Make, diagnose and score."""
    parser = argparse.ArgumentParser(description="Diagnosis of an arm that swings.")
    parser.add_argument("--robot", choices=PAYLOADS, default="big6")
    parser.add_argument("--none", type=int, default=100, help="cases with nothing missing")
    parser.add_argument("--single", type=int, default=150, help="cases with one effect")
    parser.add_argument("--work", type=Path, default=Path("out/large_arm"))
    parser.add_argument("--key", default="dev-large-arm")
    parser.add_argument("--score", action="store_true", help="only what is answered already")
    given = parser.parse_args()
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    folder = given.key if given.robot == "big6" else f"{given.key}_{given.robot}"
    key, store = Key(given.key, ""), Store(given.work.resolve() / folder)
    names = [f"none_{k:03d}" for k in range(given.none)]
    names += [f"single_{k:03d}" for k in range(given.single)]
    # Mixed, so that a part of a run is a fair part.
    names.sort(key=lambda name: int(name[-3:]) / (given.none if "none" in name else given.single))
    if not given.score:
        for name in names:
            make(key, given.robot, name, store)
            print(name, answer(name, store, TIMEOUT, threading.Event()), flush=True)
    answered = [name for name in names if store.answered(name)]
    scores = [score_case(store.folder, name, residuals=True) for name in sorted(answered)]
    text = page(given.key, given.robot, len(names), scores)
    write_text(store.folder / "RESULTS.md", text)
    print(text)


if __name__ == "__main__":
    main()
