"""Minimum time of the UR10 on the fixed joint path: direct collocation against toppra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from common import Row, loaded_ur10, main, numbers, ur10_problem

from stiffopt.baseline.toppra_motion import toppra_baseline
from stiffopt.problem.objective import Objective
from stiffopt.problem.trajectory import Method
from stiffopt.result.joint_path import JointPath
from stiffopt.solver.solve import solve

TITLE = "UR10, minimum time on the fixed path"
ALLOWED = 1e-3


def run() -> list[Row]:
    """Solve with two meshes; toppra's own answer beside the published one."""
    data = numbers()["fixed_path"]
    waypoints, reference = np.array(data["waypoints"]), data["minimum_time"]
    robot = loaded_ur10()
    problem = ur10_problem(
        robot,
        Objective(name="duration"),
        acceleration=None,
        boundary_acceleration="free",
        duration=(0.5, 4.0),
        path=waypoints,
    )
    peer = toppra_baseline(
        robot, problem.active_limits, JointPath.through(waypoints), None, np.zeros(3)
    )
    assert peer.motion is not None
    rows = [_row("toppra, called as the baseline does", peer.motion.duration, reference, None)]
    for intervals in (100, 200):
        method = Method(intervals=intervals)
        solution = solve(replace(problem, method=method), throw=False)
        assert solution.objective is not None
        assert solution.assessment is not None
        rows.append(_row(f"N = {intervals}", solution.objective.value, reference, ALLOWED))
        worst = 100 * solution.assessment.worst_violation.value
        rows.append(
            Row(
                f"N = {intervals}: status, worst limit between nodes",
                f"{solution.status.value}, {worst:.2f} %",
                "",
                "below 0.5 %",
                worst < 0.5,
            )
        )
    return rows


def _row(what: str, measured: float, reference: float, allowed: float | None) -> Row:
    off = measured / reference - 1
    wanted = "" if allowed is None else f"within {100 * allowed:g} %"
    holds = None if allowed is None else bool(abs(off) <= allowed)
    return Row(
        f"{what}: duration",
        f"{measured:.5f} s ({100 * off:+.3f} %)",
        f"{reference} s",
        wanted,
        holds,
    )


if __name__ == "__main__":
    main(TITLE, run)
