"""Lower bounds of the duration from joint limits, reversals at vias and tool speed."""

import dataclasses

import numpy as np
import pytest
from small_arms import load

from stiffopt import SolveStatus, Target, solve
from stiffopt.problem.bounds import rest_to_rest, shortest_duration
from stiffopt.problem.limit import Limits
from stiffopt.problem.resolve import resolve


def by_switching(way, velocity, acceleration, jerk):
    """Seven phases, integrated: the way is that of the largest speed, found by bisection."""

    def travelled(speed):
        if speed * jerk <= acceleration**2:
            phases = [(jerk, np.sqrt(speed / jerk)), (-jerk, np.sqrt(speed / jerk))]
        else:
            ramp = acceleration / jerk
            phases = [(jerk, ramp), (0.0, speed / acceleration - ramp), (-jerk, ramp)]
        x = v = a = time = 0.0
        for j, t in phases:
            x += v * t + a * t**2 / 2 + j * t**3 / 6
            v += a * t + j * t**2 / 2
            a += j * t
            time += t
        return 2.0 * x, 2.0 * time

    full, time = travelled(velocity)
    if full <= way:
        return time + (way - full) / velocity
    low, high = 0.0, velocity
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if travelled(middle)[0] < way else (low, middle)
    return travelled(high)[1]


@pytest.mark.parametrize("way", [0.01, 0.3, 1.0, 5.0])
@pytest.mark.parametrize("limits", [(2.0, 4.0, 30.0), (1.0, 20.0, 50.0), (9.0, 2.0, 400.0)])
def test_shortest_time_of_one_joint_from_rest_to_rest(way, limits):
    assert rest_to_rest(way, *limits) == pytest.approx(by_switching(way, *limits), rel=1e-9)


def of(problem):
    return shortest_duration(problem, resolve(problem))


def limited(tmp_path, **values):
    problem = load(tmp_path, "planar", duration="0.9")
    own = Limits.of(problem.robot)
    return dataclasses.replace(problem, limits=dataclasses.replace(own, **values))


def test_jerk_counts_where_the_motion_starts_without_acceleration(tmp_path):
    without = limited(tmp_path, jerk=np.full(2, np.inf))
    with_jerk = limited(tmp_path, jerk=np.full(2, 20.0))
    needed, why = of(with_jerk)
    assert needed > 1.2 * of(without)[0]
    assert "jerk limit 20 rad/s^3" in why
    free = dataclasses.replace(with_jerk, boundary_acceleration="free")
    assert of(free)[0] == pytest.approx(of(without)[0])
    short = dataclasses.replace(with_jerk, duration=(0.95 * needed, 0.95 * needed))
    solution = solve(short, throw=False)
    assert solution.status is SolveStatus.INFEASIBLE
    assert solution.solver.iterations == 0


def test_reversal_at_a_via_lengthens_the_shortest_duration(tmp_path):
    problem = limited(tmp_path, jerk=np.full(2, np.inf))
    start, end = problem.start.joints, problem.end.joints
    beyond = end + 1.5 * np.sign(end - start)
    there = dataclasses.replace(problem, vias=(Target(joints=0.5 * (start + end)),))
    back = dataclasses.replace(problem, vias=(Target(joints=beyond),))
    assert of(there)[0] == pytest.approx(of(problem)[0], rel=1e-3)
    assert of(back)[0] > 1.5 * of(problem)[0]


def test_tool_speed_limit_bounds_the_duration(tmp_path):
    problem = limited(tmp_path, tool_speed=0.05)
    needed, why = of(problem)
    bodies = problem.robot.rigid_bodies()
    first, last = (
        bodies.pose(problem.robot.tool, target.joints)[0] for target in (problem.start, problem.end)
    )
    assert needed == pytest.approx(np.linalg.norm(last - first) / 0.05)
    assert "speed limit 0.05 m/s" in why
