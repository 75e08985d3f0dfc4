"""Cycles with many via points: time, memory and status by number of vias, arm and objective.

Each case is a process of its own: CPU seconds of one thread, formulas prepared before. Vias are
joint positions with a tolerance, random but near one another; 20 intervals and 1 s a via.
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
from common import Row, table

from stiffopt.problem.objective import Objective
from stiffopt.problem.trajectory import Method, Target, TrajectoryProblem
from stiffopt.robot.files import load_robot
from stiffopt.solver.solve import solve

TITLE = "Cycles with many via points"
INTERVALS_PER_VIA, SECONDS_PER_VIA = 20, 1.0
VIA_TOLERANCE = 0.02  # rad
MEAN_STEP = 0.3  # rad, standard deviation between two vias
# Arm, objective, vias, seed, and CPU seconds wanted; 0 where only status and certificate count.
CASES = (
    ("er3a_c60", "torque_squared", 5, 1, 3.0),
    ("er3a_c60", "torque_squared", 30, 1, 10.0),
    ("er3a_c60", "torque_squared", 100, 1, 40.0),
    ("er3a_c60", "dynamic_deflection", 30, 1, 20.0),
    ("er3a_c60", "tool_deviation", 30, 1, 40.0),
    *(
        (arm, ("torque_squared", "dynamic_deflection")[seed % 2], vias, seed, 0.0)
        for seed, (arm, vias) in enumerate(
            [
                ("er3a_c60", 8),
                ("ur10", 9),
                ("er3a_c60_contact", 11),
                ("er3a_c60", 12),
                ("ur10", 13),
                ("er3a_c60_contact", 15),
                ("er3a_c60", 16),
                ("ur10", 17),
                ("er3a_c60_contact", 19),
                ("er3a_c60", 20),
            ],
            start=11,
        )
    ),
)
GROWTH, MEMORY = 1.2, 1024  # wanted: exponent over vias, MiB


def problem_of(arm: str, objective: str, vias: int, seed: int) -> TrajectoryProblem:
    """A cycle through random joint positions that ends where it starts."""
    robot, random = load_robot(arm), np.random.default_rng(seed)
    start = np.array([0.0, -1.2, 1.2, 0.3, 0.8, 0.0]) if arm == "ur10" else np.full(robot.n, 0.1)
    room = 0.5 * np.minimum(robot.position_upper - start, start - robot.position_lower)
    reach = np.minimum(room, 2.0 * MEAN_STEP)
    joints = [
        start + np.clip(random.normal(scale=MEAN_STEP, size=robot.n), -reach, reach)
        for _ in range(vias)
    ]
    duration = SECONDS_PER_VIA * (vias + 1)
    return TrajectoryProblem(
        robot=robot,
        start=Target(joints=start),
        end=Target(joints=start),
        vias=tuple(Target(joints=q, tolerance=VIA_TOLERANCE) for q in joints),
        objectives=(Objective(name=objective),),
        duration=(duration, duration),
        method=Method(intervals=INTERVALS_PER_VIA * vias, time_limit=600.0, collisions="check"),
    )


def case(arm: str, objective: str, vias: int, seed: int) -> dict[str, Any]:
    """Solve one case in this process."""
    solve(problem_of(arm, objective, 1, seed), throw=False)
    begin = time.process_time()
    found = solve(problem_of(arm, objective, vias, seed), throw=False)
    return {
        "seconds": time.process_time() - begin,
        "status": str(found.status),
        "objective": None if found.objective is None else found.objective.value,
        "stages": found.solver.homotopy,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def run() -> list[Row]:
    """One row a case, and the growth of torque squared from 5 to 100 vias."""
    rows, seconds = [], {}
    for arm, objective, vias, seed, wanted in CASES:
        done = subprocess.run(
            [sys.executable, __file__, arm, objective, str(vias), str(seed)],
            capture_output=True,
            text=True,
            check=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )
        one = json.loads(done.stdout.splitlines()[-1])
        seconds[objective, vias] = one["seconds"]
        iterations = " + ".join(str(stage["iterations"]) for stage in one["stages"])
        holds = one["status"] == "optimal" and one["memory"] < MEMORY
        rows.append(
            Row(
                f"{arm}, {objective}, {vias} vias: {one['status']}, {one['objective']:.6g}",
                f"{one['seconds']:.1f} s, {iterations} iterations, {one['memory']:.0f} MiB",
                "",
                f"optimal, under {MEMORY} MiB" + (f", {wanted:g} s" if wanted else ""),
                holds and (not wanted or one["seconds"] <= wanted),
            )
        )
        print(rows[-1], flush=True)
    few, many = (seconds["torque_squared", vias] for vias in (5, 100))
    power = float(np.log(many / few) / np.log(100 / 5))
    rows.append(
        Row(
            "torque_squared, 5 to 100 vias",
            f"V^{power:.2f}",
            "",
            f"at most V^{GROWTH}",
            power <= GROWTH,
        )
    )
    return rows


if __name__ == "__main__":
    if len(sys.argv) == 5:
        print(json.dumps(case(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))))
    else:
        print(table(TITLE, run()))
