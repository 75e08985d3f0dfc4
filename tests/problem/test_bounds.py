"""Bounds of objectives, reported before a solve."""

import re
from dataclasses import replace

import numpy as np
import pytest
from small_arms import load, problem_text, write_problem
from synthetic_solution import solution

from stiffopt import Limits, SolveStatus, Target, solve
from stiffopt.baseline.baselines import baselines
from stiffopt.cli import run
from stiffopt.command.simulated_solution import with_simulation
from stiffopt.errors import NotSimulatedError, ProblemError
from stiffopt.problem.bounds import check_bounds
from stiffopt.problem.resolve import resolve

# Slopes and steps of the reducer that the small arms have.
K1 = 8e3


def refusal(problem):
    with pytest.raises(ProblemError) as error:
        solve(problem)
    return str(error.value)


def number(message, before):
    """The number that follows a piece of text."""
    return float(re.search(re.escape(before) + r"\s*([0-9.e+-]+[0-9])", message)[1])


def test_stiffness_of_a_vertical_axis(tmp_path):
    problem = load(tmp_path, "spatial", minimise='objective = "joint_stiffness"\njoints = [1]')
    message = refusal(problem)
    assert "joint 1 must change sign" in message
    assert "it is zero at rest in the start pose" in message
    # At zero torque a reducer has its first slope.
    assert number(message, "zero torque,") == pytest.approx(K1, rel=1e-3)
    for choice in ("minimise.joints", "mean_compliance", "accept_bound = true"):
        assert choice in message


def test_stiffness_with_gravity_on_opposite_sides(tmp_path):
    """From below the horizontal to beyond the vertical: the torque passes zero on the way."""
    problem = load(
        tmp_path,
        "pendulum",
        start="{ joints = [-1.0] }",
        end="{ joints = [-2.2] }",
        duration="0.8",
        minimise='objective = "joint_stiffness"',
    )
    message = refusal(problem)
    assert "joint 1 must change sign" in message
    # 2 kg at 0.2 m, at -1.0 and -2.2 rad from the horizontal; y is the axis.
    for angle, where in ((-1.0, "at the end"), (-2.2, "at the end")):
        torque = -2.0 * 9.81 * 0.2 * np.cos(angle)
        assert f"{torque:.3g} N m" in message, where
    assert number(message, "zero torque,") == pytest.approx(K1, rel=1e-3)


def test_stiffness_bound_of_a_vertical_axis_without_rest_at_the_ends(tmp_path):
    goal = 'objective = "joint_stiffness"\njoints = [1]'
    free = 'boundary_acceleration = "free"'
    message = refusal(load(tmp_path, "spatial", minimise=goal, motion=free))
    assert "gravity does not load it" in message
    assert number(message, "zero torque,") == pytest.approx(K1, rel=1e-3)


def test_stiffness_of_joints_that_keep_their_torque_sign_has_no_bound(tmp_path):
    goal = 'objective = "joint_stiffness"\njoints = [1, 2]'
    solution = solve(load(tmp_path, "planar", duration="1.5", minimise=goal))
    assert solution.status.usable
    # What the rest poses allow is told as a note, and kept.
    rest = [number(note, "cannot exceed") for note in solution.notes if "cannot exceed" in note]
    assert len(rest) == 4
    assert solution.objective.value <= min(rest) * (1 + 1e-6)
    assert solution.objective.value > 1e3


def test_stiffness_of_a_motion_too_fast_to_keep_the_torque_sign(tmp_path):
    """The rest poses allow more, but stopping in time reverses the torque of both joints."""
    goal = 'objective = "joint_stiffness"\njoints = [1]'
    solution = solve(load(tmp_path, "planar", duration="0.4", minimise=goal))
    assert solution.status.usable
    assert solution.objective.value == pytest.approx(K1, rel=1e-2)


def test_accepted_stiffness_bound_is_reached(tmp_path):
    goal = 'objective = "joint_stiffness"\njoints = [1]\naccept_bound = true'
    solution = solve(load(tmp_path, "spatial", minimise=goal))
    assert solution.status.usable
    assert solution.objective.value == pytest.approx(K1, rel=1e-3)
    assert any("must change sign" in note for note in solution.notes)


def test_process_deflection_between_given_poses(tmp_path):
    force = "[tool]\nprocess_force = [0, 0, -4.0]"
    goal = 'objective = "process_deflection"'
    message = refusal(load(tmp_path, "pendulum", minimise=goal, extra=force))
    # By hand: 4 N at 0.4 m, all of it within the first slope.
    torque = 4.0 * 0.4 * np.cos(0.6)
    assert number(message, "pose,") == pytest.approx(1e3 * 0.4 * torque / K1, rel=1e-3)
    assert "accept_bound = true" in message


def test_total_deflection_between_given_poses(tmp_path):
    problem = load(tmp_path, "pendulum", minimise='objective = "total_deflection"')
    message = refusal(problem)
    # By hand: 2 kg at 0.2 m under a first slope of 8e3 up to 7 N m, tool at 0.4 m.
    torque = 2.0 * 9.81 * 0.2 * np.cos(0.6)
    assert number(message, "pose,") == pytest.approx(1e3 * 0.4 * torque / K1, rel=1e-3)
    for choice in ("dynamic_deflection", "rms", "accept_bound = true"):
        assert choice in message


def test_accepted_sag_is_reached(tmp_path):
    goal = 'objective = "total_deflection"\naccept_bound = true'
    problem = load(tmp_path, "pendulum", end="{ joints = [1.0] }", duration="1.2", minimise=goal)
    solution = solve(problem)
    assert solution.status.usable
    torque = 2.0 * 9.81 * 0.2 * np.cos(0.0)
    # The arm passes the horizontal, where the sag is largest.
    assert solution.objective.value >= 0.4 * 2.0 * 9.81 * 0.2 * np.cos(0.6) / K1 * (1 - 1e-9)
    assert solution.objective.value <= 0.4 * 1.3 * torque / K1


def test_rms_of_the_total_deflection_is_no_bound(tmp_path):
    goal = 'objective = "total_deflection"\nmeasure = "rms"'
    assert solve(load(tmp_path, "pendulum", minimise=goal)).status.usable


@pytest.mark.parametrize(
    "objective",
    [
        "dynamic_deflection",
        "process_deflection",
        "mean_compliance",
        "torque_squared",
        "acceleration_squared",
    ],
)
def test_free_duration_without_an_upper_bound(objective, tmp_path):
    problem = load(
        tmp_path,
        "pendulum",
        duration="{ lower = 0.3 }",
        minimise=f'objective = "{objective}"',
        extra="[tool]\nprocess_force = [0, 0, -10.0]",
    )
    message = refusal(problem)
    assert objective in message
    assert "no upper bound" in message
    assert "'duration'" in message


@pytest.mark.parametrize("objective", ["duration", "torque_squared"])
def test_no_duration_is_needed_where_it_is_minimised(objective, tmp_path):
    goal = f'objective = "{objective}"'
    text = problem_text("swivel", minimise=goal).replace("duration = 0.5\n", "")
    stated = load(tmp_path, "swivel", duration="{ lower = 0.01 }", minimise=goal)
    problem = load(tmp_path, "swivel", text=text)
    assert problem.duration == stated.duration == (0.01, np.inf)
    if objective == "duration":
        assert solve(problem).duration == pytest.approx(solve(stated).duration)
    else:
        assert "Give motion.duration an upper bound or a fixed value" in refusal(problem)


def test_weighted_free_duration_has_an_optimum(tmp_path):
    goal = 'objective = "acceleration_squared"\nweight = 0.01\n---\nobjective = "duration"'
    solution = solve(load(tmp_path, "swivel", duration="{ lower = 0.2 }", minimise=goal))
    assert solution.status is SolveStatus.OPTIMAL
    assert 0.21 < solution.duration < 10.0


def test_degenerate_objective_is_refused_on_the_command_line(tmp_path, capsys):
    path = write_problem(tmp_path, "pendulum", minimise='objective = "total_deflection"')
    out = tmp_path / "out"
    assert run(["solve", str(path), "--out", str(out), "--quiet"]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"stiffopt: {path}")
    assert "mm" in message
    assert not out.exists()


@pytest.mark.parametrize("torque", [3.0, 12.0, -30.0])
def test_bounds_equal_the_exact_law(torque, tmp_path):
    """The stiffness that a bound names is the slope of the three-line reducer."""
    from stiffopt.problem.rest_poses import stiffness_at

    slope = K1 if abs(torque) < 7 else 1.2e4 if abs(torque) < 25 else 1.6e4
    assert stiffness_at(load(tmp_path, "pendulum"), 1, torque) == pytest.approx(slope, rel=1e-12)


def test_stiffness_bound_by_a_given_pose_is_reported_before_the_solve(tmp_path):
    """At rest both poses are on the reducer's first slope, and so is the whole slow motion."""
    goal = 'objective = "joint_stiffness"'
    start, end = "{ joints = [-1.0] }", "{ joints = [-0.9] }"
    problem = load(tmp_path, "pendulum", start=start, end=end, duration="2.0", minimise=goal)
    solution = solve(problem)
    assert solution.status is SolveStatus.OPTIMAL
    assert solution.solver.iterations == 0
    assert "more than 0.1%" in solution.message
    assert f"cannot exceed {K1:.4g} N m/rad" in solution.message
    assert solution.objective.value == pytest.approx(K1, rel=1e-3)
    assert solution.ratio_to_better_baseline == 1.0


@pytest.mark.parametrize("objective", ["dynamic_deflection", "tool_deviation", "shaped_deviation"])
def test_tool_on_the_axis_of_all_elastic_joints_is_refused(tmp_path, objective):
    minimise = f'objective = "{objective}"'
    problem = load(tmp_path, "swivel", minimise=minimise)
    robot = replace(problem.robot, tool=replace(problem.robot.tool, offset=np.zeros(3)))
    message = refusal(replace(problem, robot=robot))
    assert message.startswith(f"{objective} is zero whatever the motion")
    assert "tool.offset" in message


@pytest.fixture
def aside_between(tmp_path):
    """Only the waist yields; the tool is on its axis at both ends, straight up and folded."""
    problem = load(tmp_path, "spatial", minimise='objective = "dynamic_deflection"')
    chains, upper = (problem.robot.chains[0], None, None), np.full(3, 3.2)
    robot = replace(problem.robot, chains=chains, position_upper=upper)
    start, end = Target(joints=[0.0, -np.pi / 2, 0.0]), Target(joints=[1.0, 0.0, np.pi])
    return replace(problem, robot=robot, limits=Limits.of(robot), start=start, end=end)


def test_tool_on_the_elastic_axis_only_at_both_ends_is_accepted(aside_between):
    motion = resolve(aside_between)
    assert not aside_between.robot.tool_yields(motion.points)
    assert check_bounds(aside_between, motion) == ()


def test_path_without_tool_deflection_is_refused(aside_between):
    """Whatever other poses there are: the waist alone turns, with the arm straight up."""
    path = np.array([[turn, -np.pi / 2, 0.0] for turn in (0.0, 0.3, 0.6, 1.0)])
    start, end = Target(joints=path[0]), Target(joints=path[-1])
    message = refusal(replace(aside_between, path=path, start=start, end=end))
    assert message.startswith("dynamic_deflection is zero")


def test_motion_with_deflection_between_the_ends_is_simulated(aside_between, monkeypatch):
    def met(*given):
        raise NotSimulatedError("as far as the arm.")

    monkeypatch.setattr("stiffopt.command.simulated_solution.elastic_arm", met)
    quintic = baselines(aside_between, resolve(aside_between))["quintic"].assessment
    noted = with_simulation(aside_between, solution(3, assessment=quintic)).notes[-1]
    assert noted == "Not simulated on the elastic arm: as far as the arm."
