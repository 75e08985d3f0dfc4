"""Solve the UR10's problems by stiffopt and its peers in turn, and write RESULTS.md beside this.

    python -m benchmarks.peers install [NAME ...]   # each in an environment of its own
    python -m benchmarks.peers [--rounds 3] [--keep]

A peer whose environment is not there is reported absent. Every answer is driven through the same
judge. Times are CPU seconds of one thread, medians over the rounds, in each of which all run in
turn; what generates and compiles code is not counted.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.peers.formula import python_source
from benchmarks.peers.judge import Judged, judge

HERE = Path(__file__).parent
DATA = Path(
    os.environ.get("STIFFOPT_BENCHMARKS", HERE.parents[2] / "shared" / "benchmarks")
).resolve()
ENVIRONMENTS = Path(os.environ.get("STIFFOPT_PEERS", HERE / "environments"))
# Of each peer what its environment needs. None: that of stiffopt.
PEERS: dict[str, tuple[str, ...] | None] = {
    "stiffopt": None,
    "acados": ("comma-deps-acados==0.2.2.post92", "numpy==2.4.6"),
    "rockit": ("rockit-meco==0.6.7", "casadi==3.8.2", "numpy>=2.2,<2.5", "scipy", "matplotlib"),
    "crocoddyl": ("crocoddyl==3.2.1", "numpy>=2.2,<2.5"),
    "toppra": None,
}
TASKS = {
    "torque_squared": ("stiffopt", "acados", "rockit", "crocoddyl"),
    "minimum_time": ("stiffopt", "rockit", "toppra"),
}
HEAD = """`python -m benchmarks.peers --keep` wrote this; CPU seconds of one thread, medians of
rounds in which all run in turn. All start from constant speed on the straight joint line. The judge
drives pinocchio's model by each answer's control on 20 instants an interval: objective, largest
excess of velocity or torque over their limits, miss of the end pose. acados generates and compiles
its code before, stiffopt has compiled in an earlier run; neither is counted. toppra times the
straight line only: what a free path is compared with."""
INTERVALS = 100


def install(names: list[str]) -> None:
    """Make the environments."""
    for name in names or list(PEERS):
        needed = PEERS[name]
        if needed is None:
            continue
        folder = ENVIRONMENTS / name
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        done = subprocess.run([str(folder / "bin" / "pip"), "install", "-q", *needed], check=False)
        print(f"{name}: {'installed' if done.returncode == 0 else 'does not install here'}")


def python_of(name: str) -> Path | None:
    """The interpreter of a peer; None where it is absent."""
    if PEERS[name] is None:
        return Path(sys.executable)
    found = ENVIRONMENTS / name / "bin" / "python"
    return found if found.is_file() else None


def task_of(kind: str) -> dict[str, Any]:
    """The problem as a file says it, with the inverse dynamics as text."""
    import pinocchio as pin

    from stiffopt.dynamics.newton_euler import inverse_dynamics
    from stiffopt.robot.body_tree import body_tree

    numbers = json.loads((DATA / "ur10.json").read_text())
    urdf = str(DATA / numbers["urdf"])
    dynamics = inverse_dynamics(body_tree(pin.buildModelFromUrdf(urdf)))
    kept = ("start", "end", "velocity_max", "torque_max", "duration")
    return {key: numbers[key] for key in kept} | {
        "kind": kind,
        "intervals": INTERVALS,
        "urdf": urdf,
        "dynamics": python_source(dynamics, "inverse_dynamics"),
    }


def asked(name: str, task: Path) -> dict[str, Any] | None:
    """One answer of a peer, with the CPU seconds of its whole process."""
    python = python_of(name)
    assert python is not None
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [str(python), str(HERE / f"{name}_peer.py"), str(task)],
        capture_output=True,
        text=True,
        timeout=600,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        print(f"{name}: {done.stderr.strip().splitlines()[-1:]}", flush=True)
        return None
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    answer["process_s"] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return answer


def table(kind: str, runs: dict[str, list[dict[str, Any]]], judged: dict[str, Judged]) -> list[str]:
    """A task's table; ratios are of the second solve, to stiffopt's."""
    lines = [
        f"## UR10, {kind.replace('_', ' ')}, {INTERVALS} intervals",
        "",
        "| | build s | first solve s | second s | second over stiffopt's | from its end s | whole"
        " process s | iterations | objective s | over a limit | end missed by rad |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]

    def median(name: str, key: str) -> float | None:
        values = [run[key] for run in runs[name] if key in run]
        return statistics.median(values) if values else None

    for name in TASKS[kind]:
        if not runs.get(name):
            absent = "absent" if python_of(name) is None else "no answer"
            lines.append(f"| {name} | {absent} |" + " |" * 9)
            continue
        second, own = median(name, "second_s"), median("stiffopt", "second_s")
        assert second is not None
        assert own is not None
        values = [median(name, key) for key in ("build_s", "first_s")]
        cells = [f"{value:.3g}" for value in values if value is not None]
        warm, worth = median(name, "warm_s"), judged[name]
        cells += [f"{second:.3g}", f"{second / own:.2f}", "–" if warm is None else f"{warm:.2g}"]
        cells += [f"{median(name, 'process_s'):.3g}", f"{runs[name][-1]['iterations']}"]
        cells += [f"{worth.objective:.5f}", f"{worth.excess:.2%}", f"{worth.miss:.1e}"]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def measure(rounds: int) -> list[str]:
    """All tasks by all peers that are there."""
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for kind, names in TASKS.items():
            task = task_of(kind)
            path = Path(folder, f"{kind}.json")
            path.write_text(json.dumps(task))
            runs: dict[str, list[dict[str, Any]]] = {}
            for _ in range(rounds):
                for name in names:
                    answer = None if python_of(name) is None else asked(name, path)
                    if answer is not None:
                        runs.setdefault(name, []).append(answer)
            judged = {name: judge(task, found[-1]) for name, found in runs.items()}
            lines += table(kind, runs, judged)
            print("\n".join(lines), flush=True)
    return lines


def main() -> None:
    """Install peers, or run them."""
    parser = argparse.ArgumentParser(prog="benchmarks.peers", description=__doc__)
    parser.add_argument("what", nargs="*", help="install [NAME ...]")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--keep", action="store_true", help="write RESULTS.md")
    given = parser.parse_args()
    if given.what[:1] == ["install"]:
        install(given.what[1:])
        return
    lines = measure(given.rounds)
    if given.keep:
        text = "\n".join(["# Peers", "", HEAD, "", *lines])
        (HERE / "RESULTS.md").write_text(text)


if __name__ == "__main__":
    main()
