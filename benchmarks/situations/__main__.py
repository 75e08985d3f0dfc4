"""Draw situations, write them as a user has them, diagnose them by the commands, score them.

    python -m benchmarks.situations --key dev-... [--cases 24] [--controls 8] [--work FOLDER]
        [--only KIND ...]

What was answered before is not run again. `--only` names kinds, or pairs as `gain+tilt3`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.key import ROOT, Key, key_under_test

from .arms import Masses, draw_arm
from .causes import CAUSES, Programme, conceal, go_together
from .score import scored, table
from .world import World, program

PAIR_SHARE = 0.35  # of the situations that conceal two things
MASSES: tuple[Masses, ...] = ("stated", "alike", "none")
MASS_SHARES = (0.6, 0.2, 0.2)
PAUSE = 20.0  # between runs of a session [s]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.situations")
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--controls", type=int, default=8)
    parser.add_argument("--only", nargs="*", default=[], help="kinds of causes in place of a draw")
    parser.add_argument("--masses", choices=MASSES)
    parser.add_argument("--key", help="for development; begins with dev-")
    parser.add_argument("--work", type=Path, default=Path(__file__).parent / "work")
    given = parser.parse_args()
    key = key_under_test(given.key)
    order = key.shuffled(list(CAUSES), "order")
    rows = []
    for number in range(given.cases + given.controls):
        rng = key.draw("case", number)
        kinds: list[str] = []
        if number < given.cases:
            kinds = [order[number % len(order)]]
            if rng.random() < PAIR_SHARE:
                kinds += [rng.choice([each for each in CAUSES if go_together(each, kinds[0])])]
            if given.only:
                kinds = given.only[number % len(given.only)].split("+")
        name = f"{number:03d}_{'+'.join(kinds) or 'nothing'}"
        folder = given.work / key.text[:16] / name
        if not (folder / "case.json").exists():
            make(folder, kinds, key, number, given.masses)
        answer(folder)
        rows.append(scored(name, folder))
        print(table(rows[-1:]), flush=True)
    print("\n" + table(rows))


def make(folder: Path, kinds: list[str], key: Key, number: int, masses: Masses | None) -> None:
    """Write robot.urdf, one log a run, and what is concealed in them."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = key.draw("situation", number)
    arm = draw_arm(rng)
    world = World(arm)
    runs, every = int(rng.integers(6, 9)), int(rng.choice([2, 4]))
    repeats, timed = bool(rng.random() < 0.4), bool(rng.random() < 0.5)
    drawn: Masses = MASSES[int(rng.choice(3, p=MASS_SHARES))]
    masses = masses or drawn
    ways, stations = [], np.zeros((0, 0))
    for k in range(runs):
        if k == 0 or not repeats:
            stations = rng.uniform(-1.1, 1.1, (int(rng.integers(4, 8)), len(arm.masses)))
        seconds = float(rng.uniform(15.0, 28.0))
        ways.append(program(rng, arm, seconds, stations, float(rng.uniform(0.3, 0.9))))
    lengths = [len(way) * 0.002 + PAUSE for way in ways]
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    asked = world.run(0, 0.0, ways[0], rng, 1)[:, 1 + len(arm.masses) :]
    plan = Programme(asked, runs, float(starts[-1]))
    truths = [conceal(kind, world, rng, plan) for kind in kinds]
    (folder / "robot.urdf").write_text(arm.urdf(masses), encoding="utf-8")
    n = len(arm.masses)
    columns = ["time", *(f"q{j}" for j in range(1, n + 1)), *(f"tau{j}" for j in range(1, n + 1))]
    for k, way in enumerate(ways):
        rows = world.run(k, float(starts[k]), way, rng, every)
        rows[:, 0] -= 0.0 if timed else starts[k]
        np.savetxt(
            folder / f"run{k + 1}.csv",
            rows,
            fmt="%.7g",
            delimiter=",",
            header=",".join(columns),
            comments="",
        )
    case = {
        "truths": [vars(truth) for truth in truths],
        "masses": masses,
        "weight": float(arm.masses.sum()),
        "axes": n,
        "timed": timed,
        "runs": runs,
    }
    (folder / "case.json").write_text(json.dumps(case, indent=1), encoding="utf-8")


def answer(folder: Path) -> None:
    """Run `init recording` and `diagnose` where the case has no answer yet."""
    if (folder / "answer.json").exists():
        return
    logs = sorted(str(path) for path in folder.glob("run*.csv"))
    made, out = folder / "set", folder / "out"
    begin = _processor_time()
    commands: list[list[str]] = [
        ["init", "recording", "--urdf", str(folder / "robot.urdf"), "--out", str(made), *logs],
        ["diagnose", str(made / "recordings.toml"), "--out", str(out), "--no-report"],
    ]
    said = []
    for command in commands:
        done = subprocess.run(
            [sys.executable, "-m", "stiffopt", *command],
            cwd=ROOT,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        said.append({"code": done.returncode, "said": done.stdout + done.stderr})
        if done.returncode:
            break
    found: dict[str, Any] = {"commands": said, "seconds": _processor_time() - begin}
    if (out / "diagnosis.json").exists():
        found["diagnosis"] = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    (folder / "answer.json").write_text(json.dumps(found, indent=1), encoding="utf-8")


def _processor_time() -> float:
    """Return the processor time of all commands that have ended [s]."""
    spent = os.times()
    return spent.children_user + spent.children_system


if __name__ == "__main__":
    main()
