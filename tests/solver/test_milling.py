"""Command against a process force: the tool's error on arms of uncertain stiffness."""

import pytest
from small_arms import ROOT

from stiffopt.command.compensation import commands_on_arms
from stiffopt.command.simulation import PlannedMotion, elastic_arm
from stiffopt.path.timed_path import timed_motion
from stiffopt.problem.files import load_problem


@pytest.mark.slow
@pytest.mark.parametrize("name", ["er3a_milling", "ur10_milling"])
def test_command_leaves_a_quarter_of_the_error_under_the_force_at_most(name):
    problem = load_problem(ROOT / "problems" / f"{name}.toml").problem
    found = timed_motion(problem)
    arm = elastic_arm(problem, found.assessment.position[0]).under(found.trajectory.force)
    plan = PlannedMotion.of("optimised", found.assessment, True)
    (led,) = commands_on_arms(problem, arm, [plan])
    assert not led.excess
    before, after = led.planned.flight, led.compensated.flight
    assert after.worst < 0.25 * before.worst
    assert after.parts["across"].worst < 0.25 * before.parts["across"].worst
