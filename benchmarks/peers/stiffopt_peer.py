"""The problems by stiffopt, as a process like those of its peers; see peers/__main__.py."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.problem.formulation import formulate
from stiffopt.problem.limit import Limits
from stiffopt.problem.objective import Objective, Scales
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import Target, TrajectoryProblem
from stiffopt.robot.files import load_robot
from stiffopt.solver.ipopt import IpoptSolver
from stiffopt.solver.stage_plan import solver_options
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import uniform_mesh
from stiffopt.transcription.ocp import Guess

SCHEME = "piecewise_linear_acceleration"


def problem_of(task: dict[str, Any]) -> TrajectoryProblem:
    """The task as a problem."""
    robot = load_robot(task["urdf"])
    unlimited = np.full(robot.n, np.inf)
    own = Limits.of(robot)
    limits = Limits(
        dict(own.values)
        | {
            "velocity": np.array(task["velocity_max"]),
            "torque": np.array(task["torque_max"]),
            "acceleration": unlimited,
            "jerk": unlimited,
        }
    )
    free = task["kind"] == "minimum_time"
    return TrajectoryProblem(
        robot=robot,
        start=Target(joints=np.array(task["start"])),
        end=Target(joints=np.array(task["end"])),
        duration=tuple(f * task["duration"] for f in ((0.2, 3.0) if free else (1.0, 1.0))),
        objectives=(Objective(name="duration" if free else "torque_squared"),),
        limits=limits,
        boundary_acceleration="free",
    )


def guess_of(task: dict[str, Any]) -> Guess:
    """Constant speed along the joint line."""
    start, end = np.array(task["start"]), np.array(task["end"])
    speed = (end - start) / task["duration"]

    def states(s: np.ndarray) -> np.ndarray:
        position = start + np.asarray(s)[:, None] * (end - start)
        return np.hstack([position, np.broadcast_to(speed, position.shape)])

    zero = np.zeros(len(start))
    return Guess(
        states=states,
        controls=lambda s: np.broadcast_to(zero, (len(s), len(start))),
        duration=task["duration"],
    )


def main() -> None:
    """Read the task, solve it twice and once more from its end, print the answer."""
    task = json.loads(Path(sys.argv[1]).read_text())
    problem = problem_of(task)
    ocp = formulate(problem, resolve(problem), Scales())
    begin = time.process_time()
    ocp = formulate(problem, resolve(problem), Scales())
    made = transcribe(ocp, SCHEME, uniform_mesh(task["intervals"]))
    solver = IpoptSolver(made.nlp, solver_options(problem))
    build = time.process_time() - begin
    x0, one = made.pack(guess_of(task)), made.ocp.parameters
    times = []
    for _ in range(2):
        begin = time.process_time()
        raw = solver.solve(x0, one)
        times.append(time.process_time() - begin)
    begin = time.process_time()
    solver.solve(raw.x, one, warm=raw)
    warm = time.process_time() - begin
    unpacked = made.unpack(raw.x)
    print(
        json.dumps(
            {
                "times": unpacked.times.tolist(),
                "acceleration": unpacked.controls.tolist(),
                "first_s": times[0],
                "second_s": times[1],
                "warm_s": warm,
                "build_s": build,
                "iterations": raw.iterations,
                "status": raw.status,
            }
        )
    )


if __name__ == "__main__":
    main()
