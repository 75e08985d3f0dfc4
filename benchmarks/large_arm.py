"""Diagnosis of an arm that swings within its own motion: `big6` with 5 to 15 kg, seen blind.

    python -m benchmarks.large_arm --none 100 --single 150 --work out/large_arm

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

from benchmarks.blind.cases import _write_exact
from benchmarks.blind.key import Key
from benchmarks.blind.mix import CATALOGUE, RATE, SECONDS, SEVERITIES, SUBSTEPS
from benchmarks.blind.oracle import balances, held_out
from benchmarks.blind.score import CaseScore, score_case
from benchmarks.blind.severity import START, sized
from benchmarks.blind.store import Store, whole_folder, write_json, write_text
from benchmarks.blind.tool import TIMEOUT, answer
from benchmarks.simulator import EFFECTS, ROBOTS, CaseSpec, simulate, truth_text, write_case

ROBOT = "big6"
PAYLOADS = (5.0, 15.0)  # [kg]
SMOOTHINGS = (0.42, 0.3, 0.2)  # of the corners of the motion, in turn [s]: the last excite swing


def base_spec(key: Key, name: str) -> CaseSpec:
    """Motions, tolerances and payload of a case."""
    draw = key.draw(name)
    return CaseSpec(
        robot=ROBOT,
        seed=int(draw.integers(2**62)),
        seconds=SECONDS,
        rate=RATE,
        substeps=SUBSTEPS,
        payload=round(float(draw.uniform(*PAYLOADS)), 2),
        smoothing=SMOOTHINGS[int(name.partition("_")[2]) % len(SMOOTHINGS)],
        name=name,
    )


def drawn(key: Key, name: str) -> tuple[CaseSpec, dict[str, Any]]:
    """Specification of a case, with what is said about it in its truth."""
    spec = base_spec(key, name)
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
        for joint in _joints(key, name, effect):
            found = sized(spec, effect, joint, START[effect])
            if found is not None:
                chosen = ((effect, joint, found.size * severity),)
                return replace(spec, effects=chosen), {**known, "severity": severity}
    raise RuntimeError(f"no effect can be seen in {name}")


def _joints(key: Key, name: str, effect: str) -> list[int | None]:
    robot = ROBOTS[ROBOT]
    if EFFECTS[effect].where == "robot":
        return [None]
    places: list[int | None] = list(range(1, robot.joints + 1))
    if effect == "wrist_coupling":
        places = places[1:]
    if effect == "inertial_error":
        places = places[:-1]
    if effect == "belt_creep":
        places = [j for j in range(1, robot.joints + 1) if "belt" in robot.connections[j - 1]]
    return key.shuffled(places, name, "joint", effect)[:2]


def make(key: Key, name: str, store: Store) -> None:
    """Make and seal a case that is not there yet."""
    if store.made(name):
        return
    spec, known = drawn(key, name)
    case = simulate(spec)
    case.truth.update(id=name, link_encoders=True, spec=asdict(spec), **known)
    write_text(store.truth(name), truth_text(case))
    with whole_folder(store.oracle_predictions(name)) as folder:
        _write_exact(case, folder)
    z = balances(case).z if spec.effects else 0.0
    write_json(store.oracle(name), {"id": name, "z": z, **held_out(case)})
    with whole_folder(store.case(name)) as folder:
        write_case(case, folder)


def _line(score: CaseScore) -> str:
    fit = score.fit.get("test")
    ratio = "" if fit is None else f"{fit.after:.3f} / {fit.oracle:.3f}"
    truth = ", ".join(t.label for t in score.truth) or "nothing"
    said = ", ".join(s.label for s in score.said) or str(score.verdict)
    return f"| {score.id} | {truth} | {said} | {ratio} | {score.cpu:.0f} |"


def main() -> None:
    """Make, diagnose and score."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--none", type=int, default=100)
    parser.add_argument("--single", type=int, default=150)
    parser.add_argument("--work", type=Path, default=Path("out/large_arm"))
    parser.add_argument("--key", default="dev-large-arm")
    parser.add_argument("--score", action="store_true", help="only what is answered already")
    given = parser.parse_args()
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    key, store = Key(given.key, ""), Store(given.work.resolve() / given.key)
    names = [f"none_{k:03d}" for k in range(given.none)]
    names += [f"single_{k:03d}" for k in range(given.single)]
    if not given.score:
        for name in names:
            make(key, name, store)
            print(name, answer(name, store, TIMEOUT, threading.Event()), flush=True)
    answered = [name for name in names if store.answered(name)]
    scores = [score_case(store.folder, name, residuals=True) for name in answered]
    for score in scores:
        print(_line(score))


if __name__ == "__main__":
    main()
