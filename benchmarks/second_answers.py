"""Second answers: one number changed, from the result folder of the first solve.

Whole commands as a user gives them, each a process of its own with formulas and byte code in place:
CPU seconds of one thread, and of the solves alone the wall-clock seconds that the result records.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from common import HERE, Row, table

TITLE = "Second answers: one number changed, with --guess"
VIA = """motion.via=[
{ position = ["350 mm", "-152.5 mm", "275 mm"], tolerance = "2 mm" },
{ position = ["350 mm", "152.5 mm", "295 mm"], tolerance = "2 mm" }]"""
# Problem, its changes by name, and the share of the first solve that is wanted.
CASES = (
    (
        "ur10_torque_squared",
        {"payload + 10 %": "payload.mass=5.5 kg", "duration + 3 %": "motion.duration=1.648 s"},
        0.1,
    ),
    (
        "er3a_pick_and_place",
        {
            "payload + 10 %": "payload.mass=1.1 kg",
            "duration + 3 %": "motion.duration=0.618 s",
            "via by 20 mm": VIA,
        },
        0.1,
    ),
    (
        "ur10_tool_deviation",
        {"payload + 10 %": "payload.mass=5.5 kg", "duration + 3 %": "motion.duration=1.648 s"},
        0.2,
    ),
)
WANTED_COMMAND = 1.5  # s


def seconds_of(out: Path, problem: str, *options: str) -> float:
    """CPU seconds of a whole command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "stiffopt", "solve", f"{HERE.parent}/problems/{problem}.toml"]
    subprocess.run(
        [*command, "--out", str(out), "--quiet", "--no-report", *options],
        check=True,
        stdout=subprocess.DEVNULL,
        # Byte code is written: compiling it anew takes .4 s of each command.
        env=os.environ | {"OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": ""},
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def solve_seconds(out: Path) -> float:
    """Seconds to build and solve the programmes of a result."""
    solver = json.loads((out / "result.json").read_text())["solver"]
    return float(solver["build_s"] + solver["solve_s"])


def run() -> list[Row]:
    """First and second answer of each problem and change."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for problem, changes, share in CASES:
            first = Path(folder) / problem
            seconds_of(first, problem)
            whole = seconds_of(first, problem)
            for name, change in changes.items():
                second = Path(folder) / "second"
                took = seconds_of(second, problem, "--guess", str(first), "--set", change)
                part = solve_seconds(second) / solve_seconds(first)
                found.append(
                    Row(
                        f"{problem}, {name}",
                        f"command {took:.2f} s, {took / whole:.2f} of the first's; "
                        f"programmes {part:.2f} of the first's",
                        wanted=f"below {WANTED_COMMAND} s; {share:g} of the first solve",
                        holds=took < WANTED_COMMAND and part <= share,
                    )
                )
    return found


if __name__ == "__main__":
    print(table(TITLE, run()))
