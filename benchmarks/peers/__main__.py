"""Solve problems of two arms by stiffopt and its peers in turn.

    python -m benchmarks.peers install [NAME ...]       # each in an environment of its own
    python -m benchmarks.peers [TASK ...] [--rounds 3]  # tables into work/
    python -m benchmarks.peers page                     # RESULTS.md of all in work/

A peer whose environment is not there is reported absent. Every answer is driven through the same
judge. Times are CPU seconds of one thread, medians over the rounds, in each of which all run in
turn; what generates and compiles code is not counted.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import statistics
import subprocess
import tempfile
import time
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.environments import Environments
from benchmarks.peers.formula import python_source
from benchmarks.peers.judge import Judged, judge

HERE = Path(__file__).parent
DATA = Path(
    os.environ.get("STIFFOPT_BENCHMARKS", HERE.parents[2] / "shared" / "benchmarks")
).resolve()
# None: what stiffopt itself runs in.
PEERS = Environments(
    Path(os.environ.get("STIFFOPT_PEERS", HERE / "environments")),
    {
        "stiffopt": None,
        "acados": ("comma-deps-acados==0.2.2.post92", "numpy==2.4.6"),
        "rockit": ("rockit-meco==0.6.7", "casadi==3.8.2", "numpy>=2.2,<2.5", "scipy", "matplotlib"),
        "crocoddyl": ("crocoddyl==3.2.1", "numpy>=2.2,<2.5"),
        "drake": ("drake==1.51.1", "numpy==2.4.6"),
        "toppra": None,
    },
)


@dataclass(frozen=True)
class Task:
    """A problem.

    Attributes
    ----------
    title : str
    numbers : Path
    kind : {"torque_squared", "minimum_time"}
    unfit : dict of str to str
        Peers that it is no problem for, with the reason.
    """

    title: str
    numbers: Path
    kind: str
    unfit: dict[str, str]


UNFIT = {"crocoddyl": "does not apply: its steps are fixed"}
TASKS = {
    "torque_squared": Task(
        "UR10, torque squared",
        DATA / "ur10.json",
        "torque_squared",
        {"toppra": "does not apply: minimum time on a given path"},
    ),
    "minimum_time": Task("UR10, minimum time", DATA / "ur10.json", "minimum_time", UNFIT),
    "two_link": Task("Two links, minimum time", HERE / "two_link.json", "minimum_time", UNFIT),
}
HEAD = """`python -m benchmarks.peers` fills this (after `install`; `page` writes it). CPU seconds
of one thread on a computer that others use too: medians of two or three rounds in which
all run in turn, and ratios within them; a peer whose process takes more than 40 s runs
in the first round alone. All start from constant speed on the straight joint line. The
judge drives pinocchio's model by each answer's control on 20 instants an interval:
objective, largest excess of velocity or torque over their limits, miss of the end pose.
acados generates and compiles its code before, which is not counted, and weighs a little
jerk beside the square of a free duration, without which it does not end. toppra times the
straight line only: what a free path is compared with. The two links are those of Weinreb
and Bryson, whose shortest time is 2.9823 s."""
INTERVALS = 100
# Of the processor, for one process; by the clock, for one that waits for something.
SECONDS, SLOW = 180, 40
CLOCK = 1200
# How often a process is looked at [s].
POLL = 0.2


def task_of(task: Task) -> dict[str, Any]:
    """The problem as a file says it, with the inverse dynamics as text."""
    import pinocchio as pin

    from stiffopt.dynamics.newton_euler import inverse_dynamics
    from stiffopt.robot.body_tree import body_tree

    numbers = json.loads(task.numbers.read_text())
    urdf = task.numbers.with_name(numbers["urdf"])
    model = pin.buildModelFromUrdf(str(urdf))
    tree = ET.parse(urdf).getroot()
    children = {child.get("link") for child in tree.iterfind("joint/child")}
    links = [link.get("name") for link in tree.iterfind("link")]
    kept = ("start", "end", "velocity_max", "torque_max", "duration")
    return {key: numbers[key] for key in kept} | {
        "kind": task.kind,
        "intervals": INTERVALS,
        "urdf": str(urdf),
        "root": next(name for name in links if name not in children),
        "joints": list(model.names)[1:],
        "dynamics": python_source(inverse_dynamics(body_tree(model)), "inverse_dynamics"),
    }


@dataclass(frozen=True)
class NoAnswer:
    """Why a peer gave none."""

    why: str


def cpu_seconds(pid: int) -> float:
    """Of a process until now. A limit by the system would make its own clock tick in 4 ms."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def finished(command: list[str], seconds: float = SECONDS, clock: float = CLOCK) -> str | NoAnswer:
    """What a command printed, within CPU seconds and seconds by the clock."""
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        start_new_session=True,
    )
    begin = time.monotonic()
    while True:
        try:
            printed, errors = process.communicate(timeout=POLL)
            break
        except subprocess.TimeoutExpired:
            within = cpu_seconds(process.pid) < seconds
            if within and time.monotonic() - begin < clock:
                continue
        # With all that it started, which would hold its pipes open.
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        why = f"{clock:g} s by the clock" if within else f"{seconds:g} CPU s"
        return NoAnswer(f"no answer in {why}")
    code = process.returncode
    if code < 0:
        return NoAnswer(f"no answer: ended by {signal.Signals(-code).name}")
    if code:
        told = (errors.strip().splitlines() or [f"code {code}"])[-1]
        return NoAnswer(f"no answer: {told}")
    return printed


def asked(name: str, task: Path) -> dict[str, Any] | NoAnswer:
    """One answer of a peer, with the CPU seconds of its whole process; else why there is none."""
    python = PEERS.python(name)
    assert python is not None
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = finished([str(python), str(HERE / f"{name}_peer.py"), str(task)])
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if isinstance(done, NoAnswer):
        return done
    answer: dict[str, Any] = json.loads(done.splitlines()[-1])
    answer["process_s"] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return answer


def table(
    task: Task,
    runs: dict[str, list[dict[str, Any]]],
    judged: dict[str, Judged],
    failed: dict[str, str],
) -> list[str]:
    """A task's table; ratios are of the second solve, to stiffopt's."""
    lines = [
        f"## {task.title}, {INTERVALS} intervals",
        "",
        "| | build s | first solve s | second s | second over stiffopt's | from its end s | whole"
        " process s | iterations | objective s | over a limit | end missed by rad |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]

    def median(name: str, key: str) -> float | None:
        values = [run[key] for run in runs.get(name, ()) if key in run]
        return statistics.median(values) if values else None

    for name in PEERS.packages:
        if name not in judged:
            if name in task.unfit:
                why = task.unfit[name]
            elif PEERS.python(name) is None:
                why = f"absent: {PEERS.absence(name)}"
            else:
                why = failed[name]
            lines.append(f"| {name} | {why} |" + " |" * 9)
            continue
        second, own = median(name, "second_s"), median("stiffopt", "second_s")
        assert second is not None
        # Where stiffopt gave no answer, there is nothing to divide by.
        ratio = "–" if own is None else f"{second / own:.2f}"
        values = [median(name, key) for key in ("build_s", "first_s")]
        cells = [f"{value:.3g}" for value in values if value is not None]
        warm, worth = median(name, "warm_s"), judged[name]
        cells += [f"{second:.3g}", ratio, "–" if warm is None else f"{warm:.2g}"]
        cells += [f"{median(name, 'process_s'):.3g}", f"{runs[name][-1].get('iterations', '–')}"]
        cells += [f"{worth.objective:.5f}", f"{worth.excess:.2%}", f"{worth.miss:.1e}"]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def measure(task: Task, rounds: int) -> list[str]:
    """A task's table, by all peers that are there."""
    runs: dict[str, list[dict[str, Any]]] = {}
    failed: dict[str, str] = {}
    numbers = task_of(task)
    names = [n for n in PEERS.packages if n not in task.unfit and PEERS.python(n)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "task.json")
        path.write_text(json.dumps(numbers))
        for number in range(1, rounds + 1):
            for name in list(names):
                answer = asked(name, path)
                if isinstance(answer, NoAnswer):
                    failed[name] = f"round {number} of {rounds}: {answer.why}"
                    names.remove(name)
                    # Medians are of peers that answer each time they are asked.
                    runs.pop(name, None)
                    continue
                runs.setdefault(name, []).append(answer)
                if answer["process_s"] > SLOW:
                    names.remove(name)
    judged = {n: judge(numbers, found[-1]) for n, found in runs.items()}
    return table(task, runs, judged, failed)


def main() -> None:
    """Install peers, run them, or write the page."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.peers",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("what", nargs="*", help="tasks (all), or install [NAME ...], or page")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    work = HERE / "work"
    if given.what[:1] == ["install"]:
        PEERS.install(given.what[1:])
    elif given.what == ["page"]:
        parts = [path.read_text() for key in TASKS if (path := work / f"{key}.md").is_file()]
        (HERE / "RESULTS.md").write_text("\n".join(["# Peers", "", HEAD, "", *parts]))
    else:
        work.mkdir(exist_ok=True)
        for key in given.what or TASKS:
            lines = measure(TASKS[key], given.rounds)
            (work / f"{key}.md").write_text("\n".join(lines))
            print("\n".join(lines), flush=True)


if __name__ == "__main__":
    main()
