"""Problem statements: checks before solving, and messages of impossible ones."""

from dataclasses import replace

import numpy as np
import pytest
from small_arms import load

from stiffopt import Limits, Method, Objective, ProblemError, Target, solve
from stiffopt.certificate.assess import assess
from stiffopt.certificate.objective_value import improvement
from stiffopt.problem.formulation import formulate
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve
from stiffopt.result.status import SolveStatus
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.verdict import model_accuracy_advice, named_conflicts
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import uniform_mesh
from stiffopt.transcription.nlp import NlpEntry


def cubic(problem, duration):
    """Motion with zero end velocities and an acceleration of 6 d/T^2 at both ends."""
    way = problem.end.joints - problem.start.joints
    slope = np.stack([6.0 * way / duration**2, -12.0 * way / duration**3])
    return Trajectory.from_acceleration(
        [0.0, duration], slope[None], problem.start.joints, np.zeros(len(way))
    )


def test_rest_means_zero_acceleration_in_the_certificate_too(tmp_path):
    problem = load(tmp_path, "planar")
    motion = cubic(problem, problem.duration[0])
    assert not assess(problem, motion).feasible(5e-3)
    free = replace(problem, boundary_acceleration="free")
    assert assess(free, motion).feasible(5e-3)


def test_boundary_velocities_are_certified(tmp_path):
    problem = load(tmp_path, "planar")
    still = assess(replace(problem, boundary_acceleration="free"), cubic(problem, 1.0))
    moving = replace(
        problem,
        boundary_acceleration="free",
        boundary_velocity=(np.array([0.6, 0.0]), np.zeros(2)),
    )
    worst = assess(moving, cubic(problem, 1.0)).worst_violation
    assert still.worst_violation.value < 0.0
    assert (worst.limit, worst.joint, worst.time) == ("start_velocity", 1, 0.0)
    # 0.6 of a limit of 6 rad/s is a tenth: a hundred times the tolerance of a thousandth.
    assert worst.value == pytest.approx(99.0)


def test_constant_objectives_are_refused(tmp_path):
    problem = load(tmp_path, "planar")
    with pytest.raises(ProblemError, match=r"tool\.process_force"):
        replace(problem, objectives=(Objective(name="process_deflection", measure="rms"),))
    with pytest.raises(ProblemError, match="is fixed at"):
        replace(problem, objectives=(Objective(name="duration"),))


def test_model_accuracy_advice_names_more_intervals(tmp_path):
    problem = load(tmp_path, "planar")
    swinging = replace(problem, objectives=(Objective(name="tool_deviation", measure="peak"),))
    assert "report the robot" in model_accuracy_advice(problem)
    assert f"More than {problem.method.intervals} method.intervals" in model_accuracy_advice(
        swinging
    )


def test_python_arguments_are_checked_like_files(tmp_path):
    problem = load(tmp_path, "planar")
    with pytest.raises(ProblemError, match="no joint 7; allowed: 1 to 2"):
        replace(problem, objectives=(Objective(name="torque_squared", joints=(7,)),))
    with pytest.raises(ProblemError, match="'zero' or 'free'"):
        replace(problem, boundary_acceleration="fre")
    with pytest.raises(ProblemError, match="process_force"):
        replace(problem, process_force=np.array([0.0, np.nan, 0.0]))
    with pytest.raises(ProblemError, match=r"starts = 0 .* 1 or above"):
        Method(starts=0)
    with pytest.raises(ProblemError, match="joint_weights"):
        Objective(name="joint_stiffness", joint_weights={1: 0.0})
    assert Target(joints=[0.0, 0.1]).joints.shape == (2,)


def test_too_short_a_duration_is_said_without_a_solve(tmp_path):
    problem = load(tmp_path, "planar")
    way = float(np.max(np.abs(problem.end.joints - problem.start.joints)))
    limits = replace(Limits.of(problem.robot), acceleration=np.full(2, 60.0))
    fast = replace(problem, limits=limits, duration=(0.01, 0.01))
    solution = solve(fast, throw=False)
    assert solution.status is SolveStatus.INFEASIBLE
    assert solution.solver.iterations == 0
    # 6 rad/s is reached after 0.1 s of 60 rad/s^2: way/6 + 0.1.
    assert f"{way / 6.0 + 0.1:.4g} s" in solution.message


def entry(name, label, fraction, *, given=False, phase=0):
    return NlpEntry(name, label, "", 1.0, phase, fraction, given)


def test_conflicts_name_limits_before_poses():
    entries = [entry("state", f"position of joint {j}", 0.0, given=True) for j in range(1, 13)]
    assert named_conflicts([*entries, entry("torque", "joint 2", 0.4)]) == (
        "torque, joint 2 (at 40 %); the given start and end"
    )


def test_conflicts_are_limits_by_their_names():
    entries = [
        entry("control rate", "acceleration of joint 1", 0.967),
        entry("control", "acceleration of joint 3", 0.4),
        entry("velocity within interval", "velocity of joint 2", 0.617),
        entry("control", "acceleration of joint 1", 1.0, given=True),
    ]
    assert named_conflicts(entries) == (
        "jerk, joint 1 (at 96.7 %); acceleration, joint 3 (at 40 %); "
        "velocity, joint 2 (at 61.7 %); the given start and end"
    )


def test_limits_at_vias_and_free_ends_are_named_as_limits():
    entries = [
        entry("control", "acceleration of joint 1", 0.0),
        entry("control", "acceleration of joint 2", 0.0, phase=1),
        entry("state", "position of joint 1", 1.0),
    ]
    assert named_conflicts(entries) == (
        "acceleration, joint 1 (at 0 %); acceleration, joint 2 (at 0 % of phase 2); "
        "position, joint 1 (at 100 %)"
    )


@pytest.mark.parametrize("acceleration", ["zero", "free"])
def test_programme_marks_fixed_end_values(tmp_path, acceleration):
    via = "via = [{ joints = [0.0, 0.3] }]"
    problem = load(tmp_path, motion=f'boundary_acceleration = "{acceleration}"\n{via}')
    stated = formulate(problem, resolve(problem), Scales())
    variables = transcribe(
        stated, "piecewise_linear_acceleration", uniform_mesh(4, phases=2)
    ).nlp.variables
    entries = [variables.entry(k) for k in range(variables.size)]
    given = {(e.name, e.phase, e.fraction) for e in entries if e.given}
    ends = [(0, 0.0), (1, 1.0)]
    expected = {("state", *end) for end in ends}
    assert given == expected | (
        {("control", *e) for e in ends} if acceleration == "zero" else set()
    )


def test_a_ratio_needs_positive_values(tmp_path):
    problem = load(tmp_path, "planar")
    assert improvement(problem, 0.2, 0.4) == pytest.approx(0.5)
    assert improvement(problem, 0.2, 0.0) is None
    assert improvement(problem, -0.2, 0.4) is None


def test_prismatic_joint_is_reported_in_its_units(tmp_path):
    with pytest.raises(ProblemError, match=r"joint 1 at 3 m is outside its range -1 m to 1 m"):
        solve(load(tmp_path, "slide", end="{ joints = [3.0, 0.6] }"))
    floor = "joint_stiffness = { 1 = 2e6 }"
    with pytest.raises(ProblemError, match=r"2e\+06 N/m.* is 1e\+06 N/m"):
        solve(load(tmp_path, "slide", limits=floor))


def test_jerk_limit_on_fixed_path_names_the_remedy(tmp_path):
    problem = load(tmp_path, "planar", limits="jerk = [400.0, 400.0]")
    first, last = problem.start.joints, problem.end.joints
    path = np.linspace(first, last, 5)
    with pytest.raises(ProblemError, match=r"limits\.jerk = \"none\""):
        solve(replace(problem, path=path), simulate=False)
    without = load(tmp_path, "planar", limits='jerk = "none"')
    assert solve(replace(without, path=path), simulate=False).status is SolveStatus.OPTIMAL


def test_robot_jerk_limit_is_ignored_on_fixed_path(tmp_path):
    problem = load(tmp_path, "planar", limits='jerk = "none"')
    robot = replace(problem.robot, jerk_max=np.array([400.0, 400.0]))
    path = np.linspace(problem.start.joints, problem.end.joints, 5)
    own = replace(problem, robot=robot, limits=None, path=path)
    solution = solve(own, simulate=False)
    assert solution.status is SolveStatus.OPTIMAL
    assert any("own jerk limit is dropped" in note for note in solution.notes)
    # And is not said to be.
    assert "as far as position, velocity, acceleration, torque and" in solution.message
    kept = solve(replace(problem, robot=robot, limits=None), simulate=False)
    assert "as far as position, velocity, acceleration, jerk, torque and" in kept.message
