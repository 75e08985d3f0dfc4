"""The UR10's minimum of squared torque: every transcription in one run; for peers `peers/`.

All start from the straight joint line at constant speed and run with N = 100 intervals. "Build" is
everything from the problem to a ready solver, "solve" is IPOPT. Rounds are interleaved and the
median counts, so that other load on the computer meets all alike.
"""

from __future__ import annotations

import statistics

import numpy as np
from common import (
    Row,
    Stopwatch,
    main,
    numbers,
    torque_squared_problem,
)
from standin import standin_robot

from stiffopt.certificate.assess import assess
from stiffopt.problem.formulation import formulate
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import Method, TrajectoryProblem
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.ipopt import IpoptSolver
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import uniform_mesh
from stiffopt.transcription.ocp import Guess

TITLE = "UR10, minimum squared torque, N = 100"
TRANSCRIPTIONS = ("piecewise_linear_acceleration", "hermite_simpson", "radau")
INTERVALS = 100
ROUNDS = 3


def straight_line(problem: TrajectoryProblem) -> Guess:
    """Constant speed along the joint line, as the peer starts."""
    start, end = np.asarray(problem.start.joints), np.asarray(problem.end.joints)
    duration = problem.duration[0]
    speed = (end - start) / duration

    def states(s: np.ndarray) -> np.ndarray:
        position = start + np.asarray(s)[:, None] * (end - start)
        return np.hstack([position, np.broadcast_to(speed, position.shape)])

    return Guess(
        states=states,
        controls=lambda s: np.zeros((len(s), len(start))),
        duration=duration,
    )


def ours(transcription: str) -> dict[str, float]:
    """One solve with one transcription."""
    clock = Stopwatch()
    problem = torque_squared_problem(standin_robot(), Method(transcription=transcription))
    with clock("build"):
        ocp = formulate(problem, resolve(problem), Scales())
        made = transcribe(ocp, transcription, uniform_mesh(INTERVALS))
        solver = IpoptSolver(made.nlp)
    with clock("solve"):
        raw = solver.solve(made.pack(straight_line(problem)), made.ocp.parameters)
    motion = assess(problem, Trajectory.from_acceleration(*made.acceleration_polynomials(raw.x)))
    return {
        "objective": raw.objective,
        "certified": sum(motion.integrals[f"torque_squared_{j}"] for j in range(1, 7)),
        "violation": motion.worst_violation.value,
        "build": clock.seconds["build"],
        "solve": clock.seconds["solve"],
        "iterations": raw.iterations,
    }


def run() -> list[Row]:
    """Solve by all, several times in turn."""
    runs: dict[str, list[dict[str, float]]] = {name: [] for name in TRANSCRIPTIONS}
    for _ in range(ROUNDS):
        for name in TRANSCRIPTIONS:
            runs[name].append(ours(name))
    reference, tolerance = numbers()["converged_objective"], numbers()["tolerance"]
    rows = []
    for name, values in runs.items():
        last = values[-1]
        rows.append(
            Row(
                f"{name}: objective at the nodes / certified",
                f"{last['objective']:.5f} / {last['certified']:.5f}",
                f"{reference}",
                f"within {tolerance:g} with at least one transcription",
                abs(last["certified"] - reference) <= tolerance,
            )
        )
        rows.append(Row(f"{name}: worst limit between nodes", f"{100 * last['violation']:.2f} %"))
        rows.append(_timing(name, values))
    return rows


def _timing(name: str, values: list[dict[str, float]]) -> Row:
    build, solve = _median(values, "build"), _median(values, "solve")
    effort = f"{build:.2f} s + {solve:.2f} s, {values[-1]['iterations']} iterations"
    return Row(f"{name}: build + solve", effort)


def _median(values: list[dict[str, float]], key: str) -> float:
    return statistics.median(value[key] for value in values)


if __name__ == "__main__":
    main(TITLE, run)
