"""Sweeps: what a warm case costs, how two cores share them, and what five kills leave."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

from common import HERE, Row, loaded_ur10, main, torque_squared_problem

from stiffopt.problem.trajectory import Method
from stiffopt.solver.active_set import ActiveSetSolver
from stiffopt.solver.family import ProblemFamily
from stiffopt.solver.ipopt import IpoptSolver
from stiffopt.sweep.cases import Case, load_sweep
from stiffopt.sweep.run import predecessors, spread_order
from stiffopt.sweep.solve_case import solve_case

TITLE = "Sweeps"
PROBLEMS = HERE.parent / "problems"
WARM, SHARED, KILLED, KILLS, ROUNDS = 20, 200, 1000, 5, 3
# What differs between two runs of the same case.
_TIMES = ("seconds", "build_s", "solve_s")


def run() -> list[Row]:
    """Measure all of them."""
    with tempfile.TemporaryDirectory() as folder:
        shared, killed = two_cores(Path(folder)), kills(Path(folder))
        return [*heavier(), *warm_cases(Path(folder)), *shared, *killed]


def heavier() -> list[Row]:
    """What a payload of a tenth more takes, over the first solve."""
    problem = torque_squared_problem(loaded_ur10(), Method(intervals=100))
    more = replace(problem, robot=problem.robot.with_payload_times(1.1))
    family = ProblemFamily()
    family.solve(problem)
    shares: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(ROUNDS):
        for compare, found in shares.items():
            begin = time.process_time()
            _, end = family.solve(problem, compare=compare)
            middle = time.process_time()
            family.solve(more, end, compare=compare)
            found.append((time.process_time() - middle) / (middle - begin))
    whole, bare = (statistics.median(shares[compare]) for compare in (True, False))
    what = "UR10, N = 100, payload 10 % more, over the first solve: CPU time"
    return [
        Row(f"{what} without baselines", f"{bare:.2f}", "", "below 0.1", bare < 0.1),
        Row("with baselines", f"{whole:.2f}"),
    ]


def warm_cases(folder: Path) -> list[Row]:
    """CPU time of a case that starts from a solved one, in this process."""
    cases = list(load_sweep(_ur10(folder, WARM + 2)).cases)
    before = predecessors(cases)
    inside = 0.0

    def timed(solve: Any) -> Any:
        def answer(*given: Any, **named: Any) -> Any:
            nonlocal inside
            begin = time.process_time()
            try:
                return solve(*given, **named)
            finally:
                inside += time.process_time() - begin

        return answer

    with (
        mock.patch.object(IpoptSolver, "solve", timed(IpoptSolver.solve)),
        mock.patch.object(ActiveSetSolver, "solve", timed(ActiveSetSolver.solve)),
    ):
        first, second, *others = spread_order(cases)
        cold, end = _cpu(first, None)
        ends = {first.key: end, second.key: _cpu(second, end)[1]}
        inside = warm = 0.0
        for case in others:
            used, ends[case.key] = _cpu(case, ends[str(before[case.key])])
            warm += used / WARM
    outside = 1.0 - inside / WARM / warm
    return [
        Row("UR10, N = 60, other payload: CPU time of a first case", f"{cold:.2f} s"),
        Row("of a warm case", f"{warm:.3f} s", "1.18 s", "below 0.118 s", warm < 0.118),
        Row("of it outside the solver", f"{outside:.0%}", "", "at most 20 %", outside <= 0.2),
    ]


def two_cores(folder: Path) -> list[Row]:
    """Time of warm cases with one worker over that with two."""
    path = _ur10(folder, SHARED)
    serial, shared = (_timed(path, folder / f"with_{count}", count) for count in (1, 2))
    ratio = serial / shared
    return [Row(f"{SHARED} of them: one worker / two", f"{ratio:.2f}", "", "1.9", ratio >= 1.9)]


def kills(folder: Path) -> list[Row]:
    """Cases of a sweep that is killed now and then, against those of one that is not."""
    for name in ("two_link.urdf", "two_link_robot.toml"):
        shutil.copy(PROBLEMS / name, folder)
    path = _sweep(
        folder, "two_link", KILLED,
        'motion.duration = { lower = "0.8 s", upper = "2 s" }\n'
        'payload.mass = { lower = "0.1 kg", upper = "0.6 kg" }',
    )  # fmt: skip
    whole, killed = folder / "whole", folder / "killed"
    _timed(path, whole, 2)
    draw = random.Random(7)
    for k in range(KILLS):
        process = subprocess.Popen(_command(path, killed, 2), start_new_session=True)
        held = draw.randint(KILLED * k // (KILLS + 1), KILLED * (k + 1) // (KILLS + 1))
        while process.poll() is None and len(_answers(killed)) < held:
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGKILL) if draw.random() < 0.5 else process.kill()
        process.wait()
    _timed(path, killed, 2)
    one, other = ({each.name: _bare(each) for each in _answers(out)} for out in (whole, killed))
    same = sum(other.get(name) == answer for name, answer in one.items())
    what = f"two-link sweep killed {KILLS} times: cases equal to the last digit"
    return [Row(what, f"{same} of {KILLED}", "", "all", same == len(other) == KILLED)]


def _ur10(folder: Path, count: int) -> Path:
    return _sweep(
        folder, "ur10_torque_squared", count,
        'payload.mass = { lower = "3 kg", upper = "5 kg" }', ("intervals = 100", "intervals = 60"),
    )  # fmt: skip


def _sweep(
    folder: Path, base: str, count: int, ranges: str, change: tuple[str, str] = ("", "")
) -> Path:
    text = (PROBLEMS / f"{base}.toml").read_text().partition("[expected]")[0].replace(*change)
    (folder / f"{base}.toml").write_text(text)
    path = folder / f"{base}_{count}.sweep.toml"
    head = f'schema = 1\nkind = "sweep"\nbase = "{base}.toml"\n'
    path.write_text(f"{head}[latin_hypercube]\ncount = {count}\n{ranges}\n")
    return path


def _cpu(case: Case, warm: bytes | None) -> tuple[float, bytes | None]:
    begin = time.process_time()
    answer, end = solve_case(case, warm)
    if answer["status"] != "optimal":
        raise RuntimeError(answer["message"])
    return time.process_time() - begin, end


def _command(path: Path, out: Path, workers: int) -> list[str]:
    command = [sys.executable, "-m", "stiffopt", "sweep", str(path), "--quiet"]
    return [*command, "--out", str(out), "--workers", str(workers)]


def _timed(path: Path, out: Path, workers: int) -> float:
    begin = time.perf_counter()
    subprocess.run(_command(path, out, workers), check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begin


def _answers(out: Path) -> list[Path]:
    return list((out / "cases").glob("*.json"))


def _bare(path: Path) -> Any:
    def without(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: without(v) for k, v in value.items() if k not in _TIMES}
        return [without(each) for each in value] if isinstance(value, list) else value

    return without(json.loads(path.read_text()))


if __name__ == "__main__":
    main(TITLE, run)
