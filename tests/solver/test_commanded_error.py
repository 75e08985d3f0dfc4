"""Least tool error of the commanded arm, with bounded travel."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from small_arms import load

from stiffopt.baseline.rivals import quintic_law
from stiffopt.budget.floor import geometry_floor
from stiffopt.certificate import assess as certificate
from stiffopt.command.simulated_solution import _judge_beside_rivals, with_simulation
from stiffopt.connection import Constant
from stiffopt.drivetrain.bearing import OutputBearing
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.led_error import _ideal_command, _ServoChange, led_error
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import AssumedUncertainty, ParameterBox, Uncertainty
from stiffopt.errors import ProblemError
from stiffopt.problem.limits.travel import with_bounded_travel
from stiffopt.problem.motor_model import MotorModel
from stiffopt.problem.objective import Objective, Scales, TermInputs
from stiffopt.problem.resolve import resolve
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.result.joint_path import JointPath
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.solution import Baseline
from stiffopt.result.status import SolveStatus
from stiffopt.result.tool_error import LedError
from stiffopt.result.trajectory import Trajectory
from stiffopt.robot.tolerances import Tolerances
from stiffopt.solver import between_rivals, verdict
from stiffopt.solver.between_rivals import BetweenRivals, RivalErrors, search_rivals
from stiffopt.solver.ipopt import RawSolution
from stiffopt.solver.programme import solve_stage
from stiffopt.solver.solve import solve
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import SolveStage


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    """A planar arm of linear springs with a payload; its objective is the default."""
    found = load(tmp_path_factory.mktemp("arm"))
    spring = Constant(name="spring", torque_max=60.0, stiffness=1.5e4)
    robot = replace(found.robot, chains=(Chain((Stage(spring),)), Chain((Stage(spring),))))
    robot = robot.with_payload(0.5, (0.0, 0.0, 0.0), (1e-3, 1e-3, 1e-3))
    return replace(found, robot=robot, objectives=())


@pytest.fixture(scope="module")
def solution(problem):
    return solve(problem)


def led(problem, motion):
    arm = ElasticArm(problem.robot, motion(np.zeros(1))[0])
    return led_error(arm, motion, problem.uncertainty, problem.servo)


def test_value_is_the_worst_error_in_flight_plus_after_arrival(problem, solution):
    assert solution.status is SolveStatus.OPTIMAL
    assert solution.objective.name == "tool_error"
    found = led(problem, solution.trajectory.link)
    assert solution.objective.value == pytest.approx(found.whole)


def test_floor_of_the_geometry_is_told_with_the_tolerances_of_the_problem(problem, solution):
    fine = Tolerances(frame_position=1e-6, tool_position=1e-6, joint_zero=1e-7)
    told = {}
    for tolerances in (Tolerances(), fine):
        own = replace(problem, tolerances=tolerances)
        assert inputs_hash(own) == inputs_hash(problem)
        simulated = with_simulation(own, solution, compare=False)
        (note,) = [each for each in simulated.notes if "Tolerances of the geometry" in each]
        chosen = solution.assessment.position[[0, -1]]
        floor = 1e3 * geometry_floor(problem.robot, tolerances, chosen)
        told[tolerances] = float(note.partition("add up to ")[2].split()[0])
        assert told[tolerances] >= 0.99 * floor
    assert told[fine] < 0.9 * told[Tolerances()]


def test_least_tool_error_is_below_that_of_other_motions(problem, solution):
    deviation = solve(replace(problem, objectives=(Objective(name="tool_deviation"),)))
    other = led(problem, deviation.trajectory.link)
    assert solution.objective.value < other.whole
    assert solution.ratio_to_strict_baseline < 1.0


@pytest.mark.parametrize("moment_stiffness", [None, 1e5])
def test_quasi_static_error_is_that_of_simulated_arms_in_a_slow_motion(problem, moment_stiffness):
    duration, unsure = 2.0, problem.uncertainty
    if moment_stiffness is not None:
        # The payload lies beside the plane in which the joints move: their bearings tilt.
        bearing = OutputBearing(moment_stiffness=moment_stiffness)
        tilting = replace(problem.robot, bearings=(bearing, bearing))
        beside = tilting.with_payload(1.0, (0.0, 0.3, 0.0), (1e-3, 1e-3, 1e-3))
        problem = replace(problem, robot=beside)
    motion = resolve(problem)
    path = JointPath.through(np.stack([motion.start, motion.end])).follow(quintic_law(duration))
    rates = [ca.SX.sym(f"d{k}", 2) for k in range(6)]
    model = MotorModel(
        problem.robot, rates, 0.01, np.zeros(2), rest_poses=(motion.start, motion.end)
    )
    error = model.commanded_error(unsure, problem.servo)
    square = ca.Function("square", [ca.vertcat(*rates)], [error.quasi_static + error.lateness])
    times = np.linspace(0.0, duration, 201)
    states = np.hstack([*(path(times, k) for k in range(3)), np.zeros((201, 6))])
    found = np.sqrt(np.array(square(states.T))[0])
    arm = ElasticArm(problem.robot, motion.start)
    worst = _ServoChange(problem.servo, unsure.worst_servo(problem.servo))
    many = UncertainArms(arm, path, worst=worst)
    box = ParameterBox(unsure, problem.robot)
    # The smallest changes about the nominal arm, which miss by what their parameter does.
    levels = np.tile(box.nominal, (1 + len(box.free), 1))
    levels[np.arange(1, len(levels)), box.free] += 1e-2
    command = _ideal_command(arm, path, Uncertainty(stiffness=0.0))
    members = [Member(command=command, departure=box.departure(each)) for each in levels]
    simulated = many.simulate(members)
    away = simulated.position[1:] - simulated.position[0]
    # From the nominal servo to the worst one the level rises by 2.
    steps = 1e-2 * np.where(box.free == len(box.nominal) - 1, 0.5, 1.0)
    true = np.sqrt(np.sum((away / steps[:, None, None]) ** 2, axis=(0, 2)))
    at = np.interp(times, simulated.time, true)
    assert found == pytest.approx(at, abs=0.05 * at.max())


def test_worst_error_is_the_lateness_of_the_servo_plus_the_errors_of_the_other_parameters(problem):
    """Default servo and one with a delay, far above where small errors are smoothed."""
    motion = resolve(problem)
    rates = [ca.SX.sym(f"d{k}", 2) for k in range(6)]
    model = MotorModel(
        problem.robot, rates, 0.01, np.zeros(2), rest_poses=(motion.start, motion.end)
    )
    (objective,), bound, scale, ratio = problem.objectives, 3e-4, 2e-5, 40.0
    state = np.concatenate([motion.start, [1.0, 0.5], [2.0, 1.0], np.zeros(6)])
    scales = Scales({"tool_error": scale, "tool_error in flight over across": ratio})

    for servo in (Servo(), Servo(bandwidth=20.0, feed_forward=0.9, delay=4e-3)):
        own = replace(problem, servo=servo)
        given = TermInputs(objective, own, model, (bound, 0.1), scales)
        error = model.commanded_error(own.uncertainty, servo)
        parts = [
            *objective.kind.terms(given).path_rows[0].expressions,
            *(error.lateness, error.quasi_static),
            *(error.lateness_across, error.quasi_static_across),
        ]
        row = ca.Function("row", [ca.vertcat(*rates)], [ca.vertcat(*parts)])
        found, across, *squares = np.array(row(state))[:, 0]
        late, others, late_across, others_across = np.sqrt(squares)
        for own_row, worst in (
            (found, late + 1.5 * others),
            (across, ratio * (late_across + 1.5 * others_across)),
        ):
            assert (own_row + (bound / scale) ** 2) * scale**2 == pytest.approx(worst**2, rel=1e-2)


def test_least_value_over_its_variable_is_the_error_in_flight_plus_the_ringing(problem):
    rates = [ca.SX.sym(f"d{k}", 2) for k in range(6)]
    model = MotorModel(problem.robot, rates, 0.01, np.zeros(2), rest_poses=(np.zeros(2),))
    (objective,), bound, scale, largest = problem.objectives, 3e-4, 2e-4, 4e-5
    scales = Scales({"tool_error": scale, "tool_error in flight over across": 1.0})
    rate = model.commanded_error(problem.uncertainty, problem.servo).ringing_rate
    values = []
    for variable in largest / scale * np.array([0.5, 0.9, 1.0, 1.1, 2.0]):
        given = TermInputs(objective, problem, model, (bound, variable), scales)
        terms = objective.kind.terms(given)
        ratio = ca.Function("ratio", rates, [terms.integrands[0] / rate])
        # An integral of the rate that makes the largest ringing, 1.5 times its root, the given one.
        integral = float(ratio(*np.ones((6, 2)))) * (largest / 1.5) ** 2
        values.append(terms.value([integral], 1.0))
    assert np.argmin(values) == 2
    assert min(values) == pytest.approx(bound + largest)


def test_error_across_is_that_perpendicular_to_the_speed_of_the_tool(problem):
    """Lateness by time alone lies along the path; by acceleration it is late in the curve."""
    motion, servo = resolve(problem), Servo(bandwidth=20.0, feed_forward=0.9, delay=4e-3)
    rates = [ca.SX.sym(f"d{k}", 2) for k in range(6)]
    model = MotorModel(
        problem.robot, rates, 0.01, np.zeros(2), rest_poses=(motion.start, motion.end)
    )
    error = model.commanded_error(problem.uncertainty, servo)
    given = [*error._quasi_static_errors, ca.mtimes(model.jacobian, rates[1])[:3]]
    given += [ca.vertcat(error.quasi_static_across, error.lateness_across)]
    state = np.concatenate([motion.start, [1.0, 0.5], [2.0, 1.0], np.zeros(6)])
    *away, speed, across = (
        np.array(each)[:, 0] for each in ca.Function("parts", [ca.vertcat(*rates)], given)(state)
    )
    direction = speed / np.linalg.norm(speed)
    sides = [each - (each @ direction) * direction for each in away]
    assert across[0] == pytest.approx(
        sum(side @ side for side in sides), rel=0.1**2 / (speed @ speed) + 1e-3
    )
    # Joints whose acceleration is a multiple of their speed move along the path.
    straight = np.concatenate([motion.start, [1.0, 0.5], [4.0, 2.0], np.zeros(6)])
    bent, along = (
        float(ca.Function("late", [ca.vertcat(*rates)], [error.lateness_across])(each))
        for each in (state, straight)
    )
    assert along < 1e-12 * bent


def test_known_error_of_the_links_is_not_searched_again(problem, solution, monkeypatch):
    def refused(*_):
        raise AssertionError("searched again")

    monkeypatch.setattr(certificate, "led_error", refused)
    known = solution.assessment.led
    assert certificate.assess(problem, solution.trajectory, led=known).led is known


def test_certain_stiffness_and_a_start_in_motion_have_no_tool_error(problem):
    sure = replace(problem, objectives=(), uncertainty=Uncertainty(stiffness=0.0))
    assert sure.objectives[0].name == "tool_deviation"
    with pytest.raises(ProblemError, match=r"uncertainty\.stiffness is 0"):
        replace(sure, objectives=(Objective(name="tool_error"),))
    moving = (np.array([0.1, 0.0]), np.zeros(2))
    with pytest.raises(ProblemError, match=r"boundary_velocity\.start"):
        replace(problem, boundary_velocity=moving)


def test_axes_travel_no_more_than_allowed(problem, solution):
    motion = resolve(problem)
    need = np.ptp(motion.points, axis=0)
    allowed = 1.5 * np.maximum(need, need.max() / 3.0)
    times = np.linspace(0.0, solution.trajectory.duration, 501)
    assert np.all(np.ptp(solution.trajectory(times), axis=0) <= 1.001 * allowed)
    stated = replace(problem, limits=replace(problem.active_limits, travel=1.2))
    narrow = with_bounded_travel(stated, motion).active_limits
    width = narrow.position_upper - narrow.position_lower
    assert width == pytest.approx(1.2 * np.maximum(need, need.max() / 3.0))
    free = replace(problem, limits=replace(problem.active_limits, travel=np.inf))
    assert with_bounded_travel(free, motion) is free
    other = replace(problem, objectives=(Objective(name="tool_deviation"),))
    assert with_bounded_travel(other, motion) is other


@pytest.mark.parametrize(("objective", "status"), [(1.0, "acceptable"), (1.2, "stalled")])
def test_correction_that_stalls_near_its_start_is_acceptable(objective, status):
    raw = RawSolution(
        status="stalled",
        reason="Error_In_Step_Computation",
        x=np.zeros(1),
        g=np.zeros(0),
        objective=objective,
        violation=0.0,
        worst_rows=[],
        conflicts=[],
        iteration=3,
        iterations=3,
        multipliers_x=np.zeros(1),
        multipliers_g=np.zeros(0),
        history=[],
        build_s=0.0,
        solve_s=0.0,
    )
    made = SimpleNamespace(solver=SimpleNamespace(solve=lambda *a, **k: raw))
    run = SimpleNamespace(
        progress=None, remaining=1.0, max_iterations=100, record=lambda stage, raw: None
    )
    stage = SolveStage(4, Smoothing(1.0))
    found = solve_stage(run, made, stage, raw.x, None, "correction", enough=1.1)
    assert found.status == status


@pytest.mark.parametrize(("converged", "sought"), [(True, 1), (False, 0)])
def test_rivals_are_sought_for_an_optimum_only(problem, solution, monkeypatch, converged, sought):
    calls = []
    monkeypatch.setattr(between_rivals, "rival_motions", lambda *_: calls.append(1) or [])
    outcome = SimpleNamespace(
        assessment=solution.assessment, raw=SimpleNamespace(converged=converged)
    )
    run = SolveRun(problem, resolve(problem), Scales(), None)
    search_rivals(run, outcome)
    assert len(calls) == sought


def straight(slope):
    return Trajectory.from_acceleration([0.0, 1.0], np.zeros((1, 1, 1)), [0.0], [slope])


@pytest.mark.parametrize(
    ("best", "strongest", "share"),
    [
        (None, 1.0, 60),
        (LedError(in_flight=0.31, after_arrival=9.0, across=1.0, shares={}), 1.0, 80),
        (None, 0.5, 40),
    ],
)
def test_motion_between_is_the_best_one_whose_motors_keep_their_limits(
    monkeypatch, best, strongest, share
):
    """The error in flight falls toward the rival, that after arrival is least at half of it."""
    oracle = BetweenRivals.__new__(BetweenRivals)
    errors = RivalErrors(None, [] if best is None else [(1.0, best)])
    oracle._rivals, oracle._errors, oracle.run = (
        {"quintic": straight(1.0)},
        errors,
        SimpleNamespace(problem=SimpleNamespace(vias=())),
    )

    def led_of(plan, below=np.inf):
        x = float(plan(1.0)[0])
        after = 1.0 + 2.0 * abs(x - 0.5)
        return LedError(in_flight=1.1 - x, after_arrival=after, across=0.5, shares={})

    monkeypatch.setattr(errors, "of_plan", led_of)
    monkeypatch.setattr(between_rivals, "follow_plan", lambda run, plan, law: plan)
    monkeypatch.setattr(
        between_rivals, "drive_violations", lambda *_: [SimpleNamespace(value=-1.0)]
    )
    monkeypatch.setattr(between_rivals, "assess", lambda problem, motors: motors)
    # A limit that the drives do not show excludes the motion of least error.
    monkeypatch.setattr(
        between_rivals, "worst_flight_violation", lambda motion: float(motion(1.0)[0]) - strongest
    )
    monkeypatch.setattr(between_rivals, "replace", lambda last, **new: SimpleNamespace(**new))
    last = SimpleNamespace(
        planned=straight(0.0),
        assessment=SimpleNamespace(led=led_of(straight(0.0))),
        raw=SimpleNamespace(converged=True),
        smoothing=SimpleNamespace(law=1.0),
    )
    proposal = oracle.propose(last, 0)
    assert proposal.reason.startswith(f"with {share} % of the quintic motion")
    # Beside a rival the ratio to it falls, whatever the sum of both phases does.
    assert ("times a rival's error in place of" in proposal.reason) == (best is not None)
    oracle._rivals = {}
    assert oracle.propose(last, 0) is None


def test_motion_between_that_misses_a_via_is_not_simulated(monkeypatch):
    oracle = BetweenRivals.__new__(BetweenRivals)
    oracle._rivals, oracle.run = {"quintic": straight(1.0)}, SimpleNamespace(problem=None)
    simulated = []

    def worse(plan, led=None, below=None):
        simulated.append(float(plan(1.0)[0]))
        return 1.0, 1.0

    oracle._worse = worse
    monkeypatch.setattr(
        between_rivals, "largest_via_miss", lambda _, plan: 0.9 - float(plan(1.0)[0])
    )
    last = SimpleNamespace(
        planned=straight(0.0),
        assessment=SimpleNamespace(led=True),
        raw=SimpleNamespace(converged=True),
    )
    assert oracle.propose(last, 0) is None
    # The motion itself, and the rival.
    assert simulated == pytest.approx([0.0, 1.0])


def test_slower_rival_is_compared_with_the_motion_slowed_to_its_duration(monkeypatch):
    """The error falls with the square of the duration; the slow rival's does too, from more."""

    def error(flight, after):
        return LedError(in_flight=flight, after_arrival=after, across=0.1 * flight, shares={})

    slow, equal, beaten = error(0.5, 0.5), error(1.2, 0.9), error(3.0, 2.0)
    errors = RivalErrors(None, [(2.0, slow), (1.0, equal), (2.0, beaten)])
    monkeypatch.setattr(
        errors, "of_plan", lambda plan: error(1.0 / plan.duration**2, 1.0 / plan.duration**2)
    )
    found = errors.ratios(straight(1.0), error(1.0, 1.0))
    assert found == pytest.approx((1.0 / 1.2, 1.0 / 0.9, 1.0 / 1.2))


@pytest.mark.slow
def test_soft_arm_is_no_worse_than_its_best_rival_in_either_phase(problem):
    spring = Constant(name="spring", torque_max=60.0, stiffness=1e4)
    robot = replace(problem.robot, chains=(Chain((Stage(spring),)), Chain((Stage(spring),))))
    robot = robot.with_payload(1.0, (0.0, 0.0, 0.0), (1e-3, 1e-3, 1e-3))
    found = solve(replace(problem, robot=robot), simulate=True)
    assert found.status is SolveStatus.OPTIMAL
    assert max(found.compensation.ratios) < 1.02
    assert any("of the quintic motion the worst arm has" in each for each in found.notes)


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "payload", "duration"), [(2e4, 0.8, 0.45), (3e4, 0.3, 0.5)])
def test_arm_behind_a_late_servo_is_no_worse_across_the_path_than_its_best_rival(
    problem, stiffness, payload, duration
):
    """With 4 ms of delay and 90 % of feed-forward most of the error in flight is lateness."""
    spring = Constant(name="spring", torque_max=60.0, stiffness=stiffness)
    robot = replace(problem.robot, chains=(Chain((Stage(spring),)), Chain((Stage(spring),))))
    robot = robot.with_payload(payload, (0.0, 0.0, 0.0), (1e-3, 1e-3, 1e-3))
    servo = Servo(bandwidth=20.0, feed_forward=0.9, delay=4e-3)
    asked = replace(problem, robot=robot, servo=servo, duration=(duration, duration))
    beside = solve(asked, simulate=True).compensation.beside_best
    assert set(beside.ratios) == {"in flight", "after arrival", "across the path"}
    assert max(beside.ratios.values()) < 1.02
    assert beside.ratios["in flight"] < 0.95


@pytest.mark.parametrize(
    ("goal", "solved", "status", "told"),
    [
        ("tool_error", "optimal", "optimal", ""),
        ("tool_error", "iteration_limit", "iteration_limit", ""),
        (
            "tool_deviation",
            "optimal",
            "acceptable",
            "a better objective and keeps all limits as well: raise method",
        ),
        (
            "torque_squared",
            "time_limit",
            "time_limit",
            "a better objective and keeps all limits as well: run that one, or raise method",
        ),
    ],
)
def test_a_baseline_is_judged_with_its_command_where_there_is_one(
    problem, solution, monkeypatch, goal, solved, status, told
):
    """The motion was chosen phase by phase: its sum may exceed that of a baseline."""
    own = verdict.Verdict(SolveStatus(solved), "")
    monkeypatch.setattr(verdict, "_solve_status", lambda _: own.status)
    monkeypatch.setattr(verdict, "_status_message", lambda *_: own.message)
    monkeypatch.setattr(verdict, "_judge_model_agreement", lambda *_: own)
    baseline = SimpleNamespace(name="quintic")
    monkeypatch.setattr(verdict, "find_better_baseline", lambda *_: baseline)
    stated = replace(problem, objectives=(Objective(name=goal),), uncertainty=AssumedUncertainty())
    outcome = SimpleNamespace(assessment=solution.assessment)
    found = verdict.judge_outcome(stated, outcome, solution.assessment, {})
    assert found.status.value == status
    assert told in found.message
    assert bool(told) == bool(found.message)


def test_a_faster_baseline_without_motors_that_lead_is_no_better_fastest_motion(
    problem, solution, monkeypatch
):
    own = verdict.Verdict(SolveStatus.OPTIMAL, "Solved.")
    monkeypatch.setattr(verdict, "_solve_status", lambda _: own.status)
    monkeypatch.setattr(verdict, "_status_message", lambda *_: own.message)
    monkeypatch.setattr(verdict, "_judge_model_agreement", lambda *_: own)
    baseline = SimpleNamespace(name="S-curve")
    monkeypatch.setattr(verdict, "find_better_baseline", lambda *_: baseline)
    goal = {"objectives": (Objective(name="duration"),), "duration": (0.1, 2.0)}
    outcome, found = SimpleNamespace(assessment=solution.assessment), {}
    for uncertainty in (AssumedUncertainty(), Uncertainty(stiffness=0.2)):
        stated = replace(problem, **goal, uncertainty=uncertainty)
        judged = verdict.judge_outcome(stated, outcome, solution.assessment, {})
        found[stated.leads_when_fastest] = judged
    assert found[False].status is SolveStatus.ACCEPTABLE
    assert found[True].status is SolveStatus.OPTIMAL
    assert found[True].message == (
        "Solved. The S-curve motion is faster, but its motors do not lead the links."
    )


def test_the_remedy_of_a_limit_that_is_exceeded_follows_from_how_its_corrections_ended():
    correction = {"step": "constraint back-off", "reason": "jerk by 9.00%", "iterations": 150}
    solved, limited = (correction | {"ended": each} for each in ("optimal", "iteration_limit"))
    assert verdict._describe_remedy([solved]).startswith("Raise method.intervals")
    told = verdict._describe_remedy([limited, solved])
    assert "jerk by 9.00%) ended without an optimum after 150 iterations" in told
    assert "more method.intervals need not change" in told


@pytest.mark.parametrize(("own", "name"), [(2.0, "S-curve"), (0.5, None), (1.0, None)])
def test_the_better_baseline_is_the_best_one(problem, solution, monkeypatch, own, name):
    monkeypatch.setattr(verdict, "objective_value", lambda *_: SimpleNamespace(value=own))
    compared = {
        each: Baseline(
            name=each,
            assessment=solution.assessment,
            objective=value,
            feasible=feasible,
            reason="",
        )
        for each, value, feasible in (
            ("quintic", 1.5, True),
            ("S-curve", 0.999, True),
            ("toppra", 0.1, False),
        )
    }
    found = verdict.find_better_baseline(problem, solution, compared)
    assert (None if found is None else found.name) == name


def test_optimum_of_the_tool_error_claims_nothing_of_the_objectives_of_baselines(problem, solution):
    rival = Baseline(
        name="quintic",
        assessment=solution.assessment,
        objective=0.0,
        feasible=True,
        reason="",
    )
    said = verdict.describe_optimality(problem, {"quintic": rival}, 1)
    assert said == "It is a local optimum, from one start. More method.starts look further."


@pytest.mark.parametrize(("wins", "status"), [(True, "acceptable"), (False, "optimal")])
def test_motion_is_not_optimal_where_the_command_of_a_rival_wins(problem, solution, wins, status):
    judged = SimpleNamespace(rival_wins=wins, best_rival=SimpleNamespace(name="quintic"))
    found = _judge_beside_rivals(problem, replace(solution, compensation=judged))
    assert found.status.value == status
    assert found.message.endswith("the command of the quintic motion is better.") == wins
    other = replace(problem, objectives=(Objective(name="tool_deviation"),))
    plain = replace(solution, compensation=judged)
    assert _judge_beside_rivals(other, plain).status is SolveStatus.OPTIMAL
