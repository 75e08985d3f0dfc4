"""Motions on a fixed path: as fast as toppra's, and from starts that differ."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from small_arms import load

from stiffopt.baseline.baselines import baselines
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.problem.limit import Limits
from stiffopt.problem.objective import Objective
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import Method
from stiffopt.result.status import SolveStatus
from stiffopt.solver.initial_guess import initial_guess, perturb_guess
from stiffopt.solver.solve import solve
from stiffopt.solver.verdict import describe_optimality

NOISE = 2e-4  # rad


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    """Minimum time along a smooth path whose waypoints are noisy, on fewer intervals than those."""
    problem = load(tmp_path_factory.mktemp("path"), duration="1.0")
    s = np.linspace(0.0, 1.0, 25)
    smooth = np.column_stack([np.sin(2.0 * s), 0.5 * np.cos(3.0 * s) - 0.3])
    path = smooth + np.random.default_rng(3).normal(scale=NOISE, size=smooth.shape)
    limits = Limits.of(problem.robot)
    limits = replace(limits, jerk=np.full(2, np.inf), acceleration=np.full(2, 20.0))
    return replace(
        problem,
        path=path,
        start=replace(problem.start, joints=path[0]),
        end=replace(problem.end, joints=path[-1]),
        limits=limits,
        duration=(0.1, 20.0),
        objectives=(Objective(name="duration"),),
        method=Method(intervals=8),
    )


def test_toppras_motion_keeps_a_rest_without_acceleration(noisy):
    toppra = baselines(noisy, resolve(noisy))["toppra"]
    assert toppra.assessment.feasible(CERTIFICATE_TOLERANCE)
    assert np.allclose(toppra.assessment.acceleration[[0, -1]], 0.0, atol=1e-9)
    free = replace(noisy, boundary_acceleration="free")
    fastest = baselines(free, resolve(free))["toppra"].objective
    assert fastest <= toppra.objective <= 1.002 * fastest


def test_no_optimum_on_a_path_is_slower_than_toppras_motion(noisy):
    found = solve(noisy)
    assert found.status is SolveStatus.OPTIMAL
    assert found.assessment.feasible(CERTIFICATE_TOLERANCE)
    assert found.objective.value <= 1.005 * found.baselines["toppra"].objective


def test_a_guess_on_a_path_has_the_time_law_of_its_motion(noisy):
    motion = resolve(noisy)
    beside = baselines(noisy, motion)
    guess = initial_guess(noisy, motion, beside)
    at = np.linspace(0.0, 1.0, 301)
    states, path = guess.states(at), noisy.path
    toppra = beside["toppra"].trajectory
    times = at * toppra.duration
    assert np.allclose(path(states[:, 0]), toppra(times), atol=1e-5)
    assert np.allclose(path(states[:, 0], 1) * states[:, 1:], toppra(times, 1), atol=0.02)


def test_starts_on_a_path_differ_in_their_timing(noisy):
    motion = resolve(noisy)
    guess = initial_guess(noisy, motion, baselines(noisy, motion))
    random, at = np.random.default_rng(1), np.linspace(0.0, 1.0, 2001)
    starts = [perturb_guess(guess, noisy, random).states(at) for _ in range(2)]
    for states in (*starts, guess.states(at)):
        rate = np.gradient(states[:, 0], at * guess.duration)
        assert np.allclose(states[:, 1], rate, atol=0.03)
        assert np.all(np.diff(states[:, 0]) >= 0.0)
    for one, other in combinations((*starts, guess.states(at)), 2):
        assert np.abs(one[:, 0] - other[:, 0]).max() > 0.01


def test_other_objectives_on_a_path_have_local_optima(noisy):
    beside = baselines(noisy, resolve(noisy))
    other = replace(noisy, objectives=(Objective(name="torque_squared"),))
    said = describe_optimality(other, beside, 3)
    assert "local optimum" in said
    assert "3 starts" in said
    assert "toppra" in said
