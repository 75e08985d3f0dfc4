"""How time and memory grow with the intervals: three problems of the UR10, 30 to 1000 intervals.

Each case is a process of its own. "Solver" is what IPOPT and the derivatives take, "rest" all else
of a solve: baselines, building, certificate. CPU seconds of one thread, formulas prepared before.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from typing import Any

import numpy as np
from common import Row, loaded_ur10, main, numbers, torque_squared_problem, ur10_problem

from stiffopt.problem.objective import Objective
from stiffopt.problem.trajectory import Method, TrajectoryProblem
from stiffopt.solver.ipopt import IpoptSolver
from stiffopt.solver.solve import solve

TITLE = "Growth with the number of intervals, UR10"
KINDS = ("torque squared", "minimum time", "peak deflection")
INTERVALS = (30, 100, 300, 1000)
# Wanted of the growth from 100 to 1000 intervals, and of memory [MiB].
EXPONENT, MEMORY = 1.15, 1024


def problem_of(kind: str, intervals: int) -> TrajectoryProblem:
    """One of the three problems."""
    robot, method = loaded_ur10(), Method(intervals=intervals, time_limit=3600.0)
    if kind == "torque squared":
        return torque_squared_problem(robot, method)
    acceleration = np.array(numbers()["dynamic_deflection"]["acceleration_max"])
    if kind == "minimum time":
        objective = Objective(name="duration")
        return ur10_problem(robot, objective, acceleration, duration=(0.3, 3.0), method=method)
    return ur10_problem(robot, Objective(name="dynamic_deflection"), acceleration, method=method)


def case(kind: str, intervals: int) -> dict[str, Any]:
    """Solve one case in this process."""
    spent = 0.0
    inner = IpoptSolver.solve

    def timed(self: IpoptSolver, *given: Any, **named: Any) -> Any:
        nonlocal spent
        begin = time.process_time()
        try:
            return inner(self, *given, **named)
        finally:
            spent += time.process_time() - begin

    # Formulas are prepared once.
    solve(problem_of(kind, 16), throw=False)
    IpoptSolver.solve = timed  # type: ignore[method-assign]
    begin = time.process_time()
    found = solve(problem_of(kind, intervals), throw=False)
    whole = time.process_time() - begin
    assert found.objective is not None
    return {
        "solver": spent,
        "rest": whole - spent,
        "iterations": [stage["iterations"] for stage in found.solver.homotopy],
        "objective": found.objective.value,
        "status": str(found.status),
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def run() -> list[Row]:
    """One row a case, and the growth of each kind."""
    rows = []
    for kind in KINDS:
        found = {}
        for intervals in INTERVALS:
            done = subprocess.run(
                [sys.executable, __file__, kind, str(intervals)],
                capture_output=True,
                text=True,
                check=True,
                env=os.environ | {"OMP_NUM_THREADS": "1"},
            )
            one = found[intervals] = json.loads(done.stdout.splitlines()[-1])
            stages = " + ".join(str(n) for n in one["iterations"])
            rows.append(
                Row(
                    f"{kind}, {intervals}: {one['status']}, {one['objective']:.6g}",
                    f"solver {one['solver']:.2f} s, rest {one['rest']:.2f} s, {stages} iterations,"
                    f" {one['memory']:.0f} MiB",
                    "",
                    f"under {MEMORY} MiB" if intervals == INTERVALS[-1] else "",
                    one["memory"] < MEMORY if intervals == INTERVALS[-1] else None,
                )
            )
            print(rows[-1], flush=True)
        power = float(np.log10(found[1000]["solver"] / found[100]["solver"]))
        whole = [found[n]["solver"] + found[n]["rest"] for n in (100, 1000)]
        rows.append(
            Row(
                f"{kind}: solver's time from 100 to 1000 (the whole solve's)",
                f"N^{power:.2f} (N^{np.log10(whole[1] / whole[0]):.2f})",
                "",
                f"at most N^{EXPONENT}",
                power <= EXPONENT,
            )
        )
    return rows


if __name__ == "__main__":
    if len(sys.argv) == 3:
        print(json.dumps(case(sys.argv[1], int(sys.argv[2]))))
    else:
        main(TITLE, run)
