"""Certified solutions of problem files, for arms whose optima can be checked by hand."""

from dataclasses import replace

import numpy as np
import pytest
from small_arms import load

import stiffopt.solver.solve as solve_module
from stiffopt import SolveStatus, solve
from stiffopt.baseline.baselines import baselines
from stiffopt.errors import NoSolutionFound
from stiffopt.result.assessment import Violation
from stiffopt.solver import starts
from stiffopt.solver.ipopt import IpoptSolver

EXCESS = 5e-3


def solved(folder, robot="planar", **pieces):
    problem = load(folder, robot, **pieces)
    solution = solve(problem)
    assert solution.status.usable
    assert solution.assessment.worst_violation.value <= EXCESS
    return problem, solution


def violation(solution, limit):
    """The worst excess over a limit on the certificate's grid."""
    return max(v.value for v in solution.assessment.violations if v.limit == limit)


def test_least_acceleration_is_a_known_polynomial(tmp_path):
    """The least squared acceleration from rest to rest is 12 d^2 / T^3."""
    _, solution = solved(
        tmp_path,
        "swivel",
        duration="0.8",
        motion='boundary_acceleration = "free"',
        minimise='objective = "acceleration_squared"',
    )
    assert solution.objective.value == pytest.approx(12.0 / 0.8**3, rel=1e-4)
    t = np.linspace(0, 0.8, 9)
    s = t / 0.8
    assert solution.trajectory(t)[:, 0] == pytest.approx(s**2 * (3 - 2 * s), abs=1e-4)


def test_minimum_time_is_bang_bang(tmp_path):
    """Without friction and gravity a swivel needs 2 sqrt(d / a)."""
    _, solution = solved(
        tmp_path,
        "swivel",
        duration="{ lower = 0.1, upper = 2.0 }",
        motion='boundary_acceleration = "free"',
        minimise='objective = "duration"',
        limits="acceleration = [10.0]",
        method="intervals = 40",
    )
    assert solution.duration == pytest.approx(2 * np.sqrt(1.0 / 10.0), rel=2e-3)
    assert solution.objective.value == solution.duration


def test_least_dynamic_deflection_of_a_swivel(tmp_path):
    """A constant spring deflects with the acceleration: the best peak is bang-bang's 4 d / T^2."""
    _, solution = solved(
        tmp_path,
        "swivel",
        duration="0.6",
        motion='boundary_acceleration = "free"',
        minimise='objective = "dynamic_deflection"',
        method="intervals = 40",
    )
    # 2 kg at 0.2 m and the link's own inertia about the axis, tool at 0.4 m, spring of 1e4.
    inertia = 2.0 * 0.2**2 + 1e-2
    peak = 0.4 * inertia * (4 * 1.0 / 0.6**2) / 1e4
    assert solution.objective.value == pytest.approx(peak, rel=0.03)
    assert solution.objective.value >= peak * (1 - 1e-6)


def test_least_work_of_a_slow_swivel(tmp_path):
    """Without friction and gravity the work is the kinetic energy of the shortest coasting."""
    duration, acceleration = 4.0, 10.0
    _, solution = solved(
        tmp_path,
        "swivel",
        duration=f"{duration}",
        motion='boundary_acceleration = "free"',
        minimise='objective = "drive_work"',
        limits=f"acceleration = [{acceleration}]",
        method="intervals = 40",
    )
    speed = 0.5 * acceleration * (duration - np.sqrt(duration**2 - 4.0 / acceleration))
    work = 0.5 * (2.0 * 0.2**2 + 1e-2) * speed**2
    assert solution.status is SolveStatus.OPTIMAL
    assert solution.objective.value == pytest.approx(work, rel=0.03)
    assert solution.objective.value >= work * (1 - 1e-6)


OBJECTIVES = {
    "dynamic peak": 'objective = "dynamic_deflection"',
    "dynamic rms": 'objective = "dynamic_deflection"\nmeasure = "rms"',
    "total rms": 'objective = "total_deflection"\nmeasure = "rms"',
    "process peak": 'objective = "process_deflection"\naccept_bound = true',
    "process rms": 'objective = "process_deflection"\nmeasure = "rms"',
    "stiffness": 'objective = "joint_stiffness"\njoints = [1]\njoint_weights = { 1 = 2.0 }',
    "compliance": 'objective = "mean_compliance"\njoints = [1, 2]',
    "torque": 'objective = "torque_squared"',
    "acceleration": 'objective = "acceleration_squared"\njoints = [2]',
    "reducers": 'objective = "reducer_load"\njoints = [1]',
    "work": 'objective = "drive_work"',
    "sum": 'objective = "torque_squared"\nweight = 2.0\n---\nobjective = "dynamic_deflection"',
}


@pytest.mark.parametrize("case", OBJECTIVES)
def test_every_objective_beats_the_baselines(case, tmp_path):
    problem, solution = solved(
        tmp_path,
        duration="0.9",
        minimise=OBJECTIVES[case],
        extra="[tool]\nprocess_force = [0, 0, -20.0]",
        method=f"intervals = {40 if case == 'process peak' else 24}",
    )
    first = problem.objectives[0]
    assert np.isfinite(solution.objective.value)
    assert solution.objective.value > 0
    assert solution.ratio_to_better_baseline <= 1.0 + 1e-3
    assert len(solution.objective.terms) == (2 if case == "sum" else 0)
    assert solution.objective.name == ("weighted_sum" if case == "sum" else first.name)


def test_via_points_are_met(tmp_path):
    _, solution = solved(
        tmp_path,
        duration="1.2",
        motion="""via = [
  { joints = [-0.3, 0.9], tolerance = "2 deg" },
  { position = [0.75, 0.0, 0.05], tolerance = "3 mm" },
  { position = [0.694182604558574, 0, -0.3792336852765964], rpy = [0, 0.65, 0], tolerance = 2e-3 },
]""",
    )
    motion = solution.assessment
    found = []
    far = np.max(np.abs(motion.position - [-0.3, 0.9]), axis=1)
    found.append(int(np.argmin(far)))
    assert far[found[0]] <= np.radians(2.0) * (1 + EXCESS)
    for point, tolerance in (
        ([0.75, 0, 0.05], 3e-3),
        ([0.694182604558574, 0, -0.3792336852765964], 2e-3),
    ):
        far = np.linalg.norm(motion.tool - point, axis=1)
        far[: found[-1]] = np.inf
        found.append(int(np.argmin(far)))
        assert far[found[-1]] <= tolerance * (1 + EXCESS)
    # Pitch of the planar arm is the sum of its angles: within its tolerance where the place is.
    turned = np.abs(np.sum(motion.position, axis=1) - 0.65)[far <= 2e-3 * (1 + EXCESS)]
    assert np.min(turned) <= 0.01 * (1 + EXCESS)
    assert 0 < found[0] < found[1] < found[2] < len(motion.time) - 1
    assert np.count_nonzero([v.limit.startswith("via_") for v in motion.violations]) == 3


def test_boundary_velocities_are_kept(tmp_path):
    _, solution = solved(
        tmp_path, motion="boundary_velocity = { start = [0.5, -0.3], end = [0.2, 0.1] }"
    )
    assert solution.trajectory(0.0, 1) == pytest.approx([0.5, -0.3], abs=1e-6)
    assert solution.trajectory(solution.duration, 1) == pytest.approx([0.2, 0.1], abs=1e-6)


def test_rest_means_no_acceleration_unless_freed(tmp_path):
    _, still = solved(tmp_path)
    _, free = solved(tmp_path, motion='boundary_acceleration = "free"')
    for t in (0.0, 0.5):
        assert still.trajectory(t, 1) == pytest.approx([0, 0], abs=1e-6)
        assert still.trajectory(t, 2) == pytest.approx([0, 0], abs=1e-5)
    assert np.max(np.abs(free.trajectory(0.0, 2))) > 1.0
    assert free.objective.value < still.objective.value


def test_poses_are_met(tmp_path):
    _, solution = solved(
        tmp_path,
        start="{ position = [0.6, 0.0, 0.2], near = [-0.6, 0.4] }",
        end="{ position = [0.694182604558574, 0.0, -0.3792336852765964], rpy = [0.0, 0.65, 0.0] }",
        motion="boundary_velocity = { start = [0, 0], end = [0, 0] }",
    )
    assert solution.assessment.tool[0] == pytest.approx([0.6, 0, 0.2], abs=1e-4)
    assert solution.assessment.tool[-1] == pytest.approx(
        [0.694182604558574, 0, -0.3792336852765964], abs=1e-4
    )


LIMITS = {
    "velocity": "velocity = [2.6, 6.0]",
    "acceleration": "acceleration = [22.0, 30.0]",
    "jerk": "jerk = [400.0, 400.0]",
    "torque": "torque = [19.0, 9.0]",
    "tool_speed": "tool_speed = 2.0",
    "dynamic_deflection": "dynamic_deflection = '0.7 mm'",
    "total_deflection": "total_deflection = '2.2 mm'",
    "joint_stiffness": "joint_stiffness = { 1 = 8.5e3 }",
    "velocity_by_position": "velocity_by_position = 'map.csv'",
}
SLOW = {"total_deflection": "1.5", "joint_stiffness": "1.5", "dynamic_deflection": "0.6"}


@pytest.mark.parametrize("limit", LIMITS)
def test_every_limit_holds_on_the_fine_grid(limit, tmp_path):
    rows = ["q1,v1,q2,v2", "-0.6,2.0,-3,5", "0.0,3.0,0,5", "0.5,4.0,3,5"]
    (tmp_path / "map.csv").write_text("\n".join(rows))
    duration = f"{{ lower = 0.2, upper = {SLOW.get(limit, 1.0)} }}"
    _, solution = solved(
        tmp_path,
        duration=duration,
        minimise='objective = "duration"',
        limits=LIMITS[limit],
        method="intervals = 24",
    )
    # The shortest motion runs into the limit, and stays within it.
    assert violation(solution, limit) <= EXCESS
    if limit == "joint_stiffness":
        # The stiffness jumps past the limit where the reducer's second slope begins.
        assert np.min(np.abs(solution.assessment.spring_torque[:, 0])) == pytest.approx(7, rel=0.01)
    else:
        assert violation(solution, limit) >= -0.02


def test_a_speed_map_is_kept_at_every_instant(tmp_path):
    rows = ["q1,v1,q2,v2", "-0.6,2.0,-3,5", "0.0,3.0,0,5", "0.5,4.0,3,5"]
    (tmp_path / "map.csv").write_text("\n".join(rows))
    _, solution = solved(
        tmp_path,
        duration="{ lower = 0.2, upper = 1.0 }",
        minimise='objective = "duration"',
        limits="velocity_by_position = 'map.csv'",
    )
    motion = solution.assessment
    allowed = np.interp(motion.position[:, 0], [-0.6, 0.0, 0.5], [2.0, 3.0, 4.0])
    assert np.max(motion.velocity[:, 0] / allowed) <= 1 + EXCESS


def test_torque_falls_with_speed_as_the_motors_curve(tmp_path):
    """From 25 N m at rest to 10 N m at 3 rad/s in the first joint: the motion runs along it."""
    rows = ["v1,t1,v2,t2", "0.0,25.0,0.0,60.0", "3.0,10.0,6.0,60.0"]
    (tmp_path / "curve.csv").write_text("\n".join(rows))
    _, solution = solved(
        tmp_path,
        duration="{ lower = 0.2, upper = 2.0 }",
        minimise='objective = "duration"',
        limits="torque_by_speed = 'curve.csv'",
        method="intervals = 48",
    )
    motion = solution.assessment
    speed, torque = np.abs(motion.velocity[:, 0]), np.abs(motion.torque[:, 0])
    used = torque / np.interp(speed, [0.0, 3.0], [25.0, 10.0])
    assert 0.98 < np.max(used) <= 1 + EXCESS
    assert np.max(used[speed > 1.0]) > 0.98


def test_a_process_force_loads_the_springs(tmp_path):
    problem, solution = solved(
        tmp_path,
        minimise=OBJECTIVES["process rms"],
        duration="0.9",
        extra="[tool]\nprocess_force = [0, 0, -50.0]",
    )
    motion = solution.assessment
    unloaded = motion.spring_torque + np.einsum(
        "kij,i->kj", _jacobians(problem, motion.position), problem.process_force
    )
    gravity_free = motion.torque - motion.spring_torque
    assert np.max(np.abs(gravity_free)) < 1e-9  # no rotors, no friction
    assert np.max(np.abs(unloaded - motion.spring_torque)) > 5.0
    squares = np.sum(motion.deflection["process"] ** 2, axis=1)
    mean = np.trapezoid(squares, motion.time) / motion.duration
    assert solution.objective.value == pytest.approx(np.sqrt(mean), rel=1e-6)


def _jacobians(problem, positions):
    from stiffopt.problem.rest_poses import tool_jacobian

    return np.stack([tool_jacobian(problem, q) for q in positions])


def test_a_slide(tmp_path):
    _, solution = solved(tmp_path, "slide", duration="0.8", minimise=OBJECTIVES["dynamic peak"])
    assert solution.trajectory(0.8) == pytest.approx([0.4, 0.6], abs=1e-6)
    # The slide's spring is loaded by the mass that it moves.
    force = solution.assessment.spring_torque[:, 0]
    assert 1.0 < np.max(np.abs(force)) < 200.0
    assert solution.assessment.windup[:, 0] == pytest.approx(force / 1e6, rel=1e-9)


@pytest.mark.parametrize("method", ["hermite_simpson", "radau"])
def test_other_transcriptions_agree(method, tmp_path):
    _, linear = solved(tmp_path, minimise=OBJECTIVES["torque"], method="intervals = 40")
    _, other = solved(
        tmp_path,
        minimise=OBJECTIVES["torque"],
        method=f'intervals = 24\ntranscription = "{method}"',
    )
    assert other.objective.value == pytest.approx(linear.objective.value, rel=0.02)


def test_too_short_a_duration_ends_with_the_limits_that_conflict(tmp_path):
    problem = load(
        tmp_path,
        duration="0.32",
        limits="torque = [14.0, 60.0]",
        method="intervals = 20\ntime_limit = 20",
    )
    with pytest.raises(NoSolutionFound) as error:
        solve(problem)
    solution = error.value.solution
    assert solution.status is SolveStatus.INFEASIBLE
    assert solution.solver.solve_s < 20
    assert "joint 1" in solution.message
    assert "longer duration" in solution.message
    # Conflicts are named by the limit, not only by number.
    assert "acceleration" in solution.message or "torque" in solution.message
    assert solution.status.exit_code == 3


def test_a_time_limit_keeps_the_best_motion(tmp_path):
    problem = load(
        tmp_path,
        "spatial",
        minimise=OBJECTIVES["dynamic peak"],
        method="intervals = 200\ntime_limit = 0.01",
    )
    solution = solve(problem, throw=False)
    assert solution.status is SolveStatus.TIME_LIMIT
    assert solution.trajectory is not None
    assert "method.time_limit" in solution.message


def test_conflict_is_named_at_the_time_limit(tmp_path):
    problem = load(
        tmp_path,
        duration="0.32",
        limits="torque = [14.0, 60.0]\ndynamic_deflection = 1e-7",
        minimise=OBJECTIVES["torque"],
        method="intervals = 200\ntime_limit = 0.01",
    )
    solution = solve(problem, throw=False)
    # A deflection limit far below every baseline is out of reach however long the solve takes.
    assert solution.status is SolveStatus.INFEASIBLE
    assert "limits.dynamic_deflection = 0.0001 mm is out of reach" in solution.message
    named = solution.message.partition("These conflict: ")[2]
    assert named.startswith("dynamic_deflection, tool")


def test_a_deflection_that_no_motion_of_the_duration_meets_names_a_longer_one(tmp_path):
    pieces = {
        "limits": "dynamic_deflection = '0.05 mm'",
        "minimise": OBJECTIVES["torque"],
        "method": "intervals = 10",
    }
    solution = solve(load(tmp_path, duration="0.5", **pieces), throw=False)
    assert solution.status is SolveStatus.INFEASIBLE
    assert "limits.dynamic_deflection = 0.05 mm is out of reach" in solution.message
    assert "by 0.996 mm in the toppra motion of 0.5 s" in solution.message
    assert "allow about 2.2 s" in solution.message
    longer = load(tmp_path, duration="2.3", **pieces | {"method": "intervals = 20"})
    assert solve(longer, throw=False).status.usable


def test_an_iteration_limit_keeps_the_best_motion(tmp_path):
    problem = load(tmp_path, minimise=OBJECTIVES["dynamic peak"], method="max_iterations = 2")
    solution = solve(problem, throw=False)
    assert solution.status is SolveStatus.ITERATION_LIMIT
    assert "method.max_iterations" in solution.message
    assert solution.trajectory is not None


@pytest.mark.slow
def test_several_starts_are_no_worse(tmp_path):
    one = solve(load(tmp_path, minimise=OBJECTIVES["dynamic peak"], method="intervals = 16"))
    three = solve(
        load(tmp_path, minimise=OBJECTIVES["dynamic peak"], method="intervals = 16\nstarts = 3")
    )
    assert three.objective.value <= one.objective.value * (1 + 1e-6)


@pytest.mark.parametrize("why", ["worse", "exceeds a limit"])
def test_solve_restarts_from_a_better_baseline(tmp_path, monkeypatch, why):
    problem = load(tmp_path, minimise='objective = "torque_squared"')
    begun = []
    best_of_starts, certified_solve = starts.best_of_starts, starts._solve_and_refine

    def behind(run, guess):
        found = best_of_starts(run, guess)
        quintic = baselines(problem, run.motion)["quintic"].assessment
        assert quintic.feasible(EXCESS)
        if why == "exceeds a limit":
            exceeded = (Violation(0.1, "velocity", 1, 0.2),)
            return replace(found, assessment=replace(found.assessment, violations=exceeded))
        poor = {name: 1.1 * value for name, value in quintic.integrals.items()}
        return replace(found, assessment=replace(quintic, integrals=poor))

    def counted(run, guess):
        begun.append(guess)
        return certified_solve(run, guess)

    expected = solve(problem).objective.value
    monkeypatch.setattr(solve_module, "best_of_starts", behind)
    monkeypatch.setattr(starts, "_solve_and_refine", counted)
    solution = solve(problem)
    assert len(begun) == 2
    assert solution.status is SolveStatus.OPTIMAL
    assert solution.objective.value == pytest.approx(expected, rel=1e-6)


def test_spread_of_several_starts_is_noted(tmp_path):
    told = solve(load(tmp_path, "swivel", method="intervals = 16\nstarts = 3")).notes
    assert any(
        "Of 3 starts 3 ended in a certified optimum: 3 within 1 % of" in note for note in told
    )
    assert not any("starts" in note for note in solve(load(tmp_path, "swivel")).notes)


def test_equal_inputs_give_equal_results(tmp_path):
    first, again = (solve(load(tmp_path, "swivel")) for _ in range(2))
    assert first.inputs_hash == again.inputs_hash
    assert first.objective.value == again.objective.value
    other = solve(load(tmp_path, "swivel", duration="0.51"))
    assert other.inputs_hash != first.inputs_hash


def test_a_stalled_stage_is_tried_once_more_from_its_best_point(monkeypatch, tmp_path):
    starts = []
    solve = IpoptSolver.solve

    def stalls_first(self, x0, *given, **options):
        starts.append(np.array(x0))
        found = solve(self, x0, *given, **options)
        return replace(found, status="stalled") if len(starts) == 1 else found

    monkeypatch.setattr(IpoptSolver, "solve", stalls_first)
    _, solution = solved(tmp_path, "swivel", duration="0.8", minimise=OBJECTIVES["torque"])
    assert solution.status.value == "optimal"
    assert [stage["status"] for stage in solution.solver.homotopy][:2] == ["stalled", "optimal"]
    assert np.abs(starts[1] - starts[0]).max() > 1e-3
