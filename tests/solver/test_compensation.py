"""Wind-up compensation: tool deviation on uncertain arms, exceeded limits, messages."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest
from small_arms import load

from stiffopt.baseline.baselines import baselines
from stiffopt.baseline.rivals import FairRival, quintic_law, s_curve_law
from stiffopt.certificate.assess import assess
from stiffopt.command import command_search
from stiffopt.command.command_lead import ExistingCommand
from stiffopt.command.compensation import (
    commands_on_arms,
    compensate,
    judge_existing_command,
    rival_commands,
)
from stiffopt.command.simulation import PlannedMotion, elastic_arm, simulate_motions
from stiffopt.drivetrain.bearing import OutputBearing
from stiffopt.elastic.servo import MAX_LEAD_AT_END, Servo
from stiffopt.elastic.simulate import simulate
from stiffopt.elastic.uncertainty import Uncertainty
from stiffopt.errors import RobotError
from stiffopt.problem.motor_model import MotorLaw
from stiffopt.problem.resolve import resolve
from stiffopt.report.solve.compensation import (
    compensation_section,
    compensation_text,
)
from stiffopt.report.solve.wording import rival_text
from stiffopt.result.compensation import compensation_document, write_command
from stiffopt.result.joint_path import JointPath
from stiffopt.result.store import write_rival


def planned(problem, duration, name="optimised"):
    """The quintic motion of a problem in some time."""
    path = JointPath.through(resolve(problem).points)
    return PlannedMotion.of(name, assess(problem, path.follow(quintic_law(duration))), True)


@pytest.fixture(scope="module")
def smooth(tmp_path_factory):
    problem = load(tmp_path_factory.mktemp("arm"), extra="[payload]\nmass = 1.0")
    problem = replace(problem, uncertainty=Uncertainty(servo_feed_forward=0.999, draws=50))
    motion = planned(problem, 0.5)
    arm = elastic_arm(problem, motion.position[0])
    toppra = PlannedMotion.of(
        "toppra", baselines(problem, resolve(problem))["toppra"].assessment, True
    )
    return problem, motion, compensate(problem, arm, [motion, toppra])


def test_tool_follows_the_plan(smooth):
    _, _, found = smooth
    own = found.optimised
    assert own.excess == ()
    assert found.refusal == ""
    assert own.simulated.peak < 0.1 * own.planned.flight.nominal
    assert own.simulated.peak_after < 0.2 * own.planned.after.nominal
    # Linearised and in full, nominal and worst.
    assert own.compensated.flight.nominal == pytest.approx(own.simulated.peak, rel=0.02)
    assert own.worst.peak <= own.compensated.flight.worst * 1.02


def test_the_worst_arm_is_worse_than_all_that_are_drawn(smooth):
    _, _, found = smooth
    for motion in found.motions:
        for spreads in (motion.planned, motion.compensated):
            for spread in (spreads.flight, spreads.after):
                assert len(spread.draws) == 50
                assert spread.worst >= max(spread.nominal, spread.draws.max())
    own = found.optimised
    assert own.compensated.flight.worst < 0.6 * own.planned.flight.worst
    assert "stiffness" in own.compensated.flight.worst_case


def test_the_command_is_written_and_an_old_one_of_another_motion_removed(smooth, tmp_path):
    problem, motion, found = smooth
    path = write_command(found, tmp_path)
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == [
        "t",
        *(f"{q}{j}" for q in ("q", "qd", "qdd", "tau", "link") for j in (1, 2)),
    ]
    # The lead of the servo's known lag decays after the plan's arrival.
    assert 0.5 <= float(rows[-1]["t"]) < 0.6
    for j in (1, 2):
        q = np.array([float(row[f"q{j}"]) for row in rows])
        assert q[[0, -1]] == pytest.approx(motion.position[[0, -1], j - 1], abs=MAX_LEAD_AT_END[0])
        v = np.array([float(row[f"qd{j}"]) for row in rows])
        assert v[[0, -1]] == pytest.approx([0.0, 0.0], abs=MAX_LEAD_AT_END[1])
        a = np.array([float(row[f"qdd{j}"]) for row in rows])
        step = np.diff([float(row["t"]) for row in rows])
        # Hermite's rule: the mean of the velocities alone is off by the jerk over each step.
        moved = 0.5 * (v[1:] + v[:-1]) - step / 12.0 * np.diff(a)
        assert np.diff(q) / step == pytest.approx(moved, abs=1e-2)
    limits = problem.active_limits
    assert np.all(np.abs(found.command.torque) <= limits.torque)
    assert write_command(replace(found, command=None), tmp_path) is None
    assert not path.exists()
    assert write_command(None, tmp_path) is None


def test_table_text_and_document_have_every_motion(smooth):
    _, _, found = smooth
    section = compensation_section(found)
    head, rows = section.head, section.rows
    assert [[row[0], row[2]] for row in rows] == [
        [name, how] for name in ("optimised", "toppra") for how in ("as planned", "compensated")
    ]
    assert all(len(row) == len(head) for row in rows)
    worst = 1e3 * found.optimised.compensated.flight.worst
    assert section.title.startswith("Deviations [mm]")
    assert float(rows[1][head.index("worst")]) == pytest.approx(worst, rel=5e-3)
    text = compensation_text(found)
    assert "in the worst case" in text
    assert "toppra's motion" in rival_text(found)
    assert "toppra's motion" not in text
    flight, after, across = map(float, rows[3][-2].split(" / "))
    assert (flight, after) == pytest.approx(found.ratios, rel=5e-3)
    assert across == pytest.approx(found.beside_best.ratios["across the path"], rel=5e-3)
    assert "50 arms" in section.lines[0]
    document = compensation_document(found)
    assert document["command"] == "command.csv"
    own = document["motions"]["optimised"]
    assert own["within_motor_limits"]
    assert len(own["compensated"]["in_flight"]["draws"]) == 50
    assert own["simulated_worst"]["in_flight"]["peak"] > 0.0


def test_a_command_beyond_the_motors_is_refused_with_joint_time_and_remedy(smooth, tmp_path):
    problem, _, _ = smooth
    fast = planned(problem, 0.5)
    peak = np.max(np.abs(fast.velocity), axis=0)
    tight = replace(
        problem, limits=replace(problem.active_limits, velocity=np.array([0.95, 2.0]) * peak)
    )
    found = compensate(tight, elastic_arm(tight, fast.position[0]), [fast])
    assert found.command is None
    excess = found.optimised.excess[0]
    assert (excess.limit, excess.joint) == ("velocity", 1)
    assert excess.value == pytest.approx(1 / 0.95 - 1, abs=0.05)
    for part in ("velocity of joint 1 at 0.", "s by", "limits.scale.velocity", "longer duration"):
        assert part in found.refusal
    assert "exceeds velocity of joint 1" in compensation_section(found).rows[1][-1]
    assert write_command(found, tmp_path) is None


def test_command_is_feasible_on_the_fine_grid(smooth, monkeypatch):
    problem, motion, _ = smooth
    # At the ends and in the middle an acceleration that is too large does not show.
    monkeypatch.setattr(command_search, "_TRIAL_SAMPLES", 3)
    arm = elastic_arm(problem, motion.position[0])
    (first,) = commands_on_arms(problem, arm, [motion])
    best = first.motors
    most = np.max(np.abs(best(np.linspace(0.0, best.duration, 6001), 2)), axis=0)
    tight = replace(problem, limits=replace(problem.active_limits, acceleration=0.99 * most))
    (found,) = commands_on_arms(tight, arm, [motion])
    assert found.excess == ()
    times = np.linspace(0.0, motion.time[-1], 501)
    assert np.max(np.abs(found.motors(times) - best(times))) > 1e-7


def test_a_damping_that_may_be_above_critical_is_refused(smooth):
    problem, motion, _ = smooth
    arm = elastic_arm(problem, motion.position[0])
    critical = arm.damping / 0.02
    damped = replace(problem, robot=replace(problem.robot, damping=0.8 * critical))
    with pytest.raises(
        RobotError, match=r"uncertainty.damping lets the damping of shoulder.* from 0 to 0.2"
    ):
        compensate(damped, elastic_arm(damped, motion.position[0]), [motion])


def test_a_constant_force_on_the_tool_is_compensated_too(smooth):
    problem, motion, _ = smooth
    pushed = replace(problem, process_force=np.array([3.0, -5.0, 0.0]))
    found = compensate(pushed, elastic_arm(pushed, motion.position[0]), [motion]).optimised
    assert found.simulated.peak < 0.1 * found.planned.flight.nominal


def test_command_leads_the_tool_against_elastic_bearings(tmp_path):
    problem = load(tmp_path, "spatial", extra="[payload]\nmass = 2.0\ncom = [0.0, 0.1, 0.0]")
    bearings = tuple(OutputBearing(moment_stiffness=each) for each in (2e5, 1e5, 5e4))
    problem = replace(
        problem,
        robot=replace(problem.robot, bearings=bearings),
        # Little, so that no command leads by more than the nominal wind-up.
        uncertainty=Uncertainty(stiffness=0.01, draws=50),
    )
    motion = planned(problem, 0.8)
    arm = elastic_arm(problem, motion.position[0])
    (found,) = commands_on_arms(problem, arm, [motion])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command_search.CommandSearch, "_bearing_lead", None)
        (by_windup,) = commands_on_arms(problem, arm, [motion])
    assert found.compensated.flight.nominal < 0.4 * by_windup.compensated.flight.nominal
    assert found.compensated.flight.worst < by_windup.compensated.flight.worst


def test_a_made_command_is_sent_as_early_whatever_uncertainty_it_is_judged_by(tmp_path):
    problem = load(tmp_path, extra="[servo]\nbandwidth = 20.0\ndelay = '2 ms'")
    problem = replace(problem, uncertainty=Uncertainty(draws=50))
    motion = planned(problem, 0.8)
    arm = elastic_arm(problem, motion.position[0])
    (own,) = commands_on_arms(problem, arm, [motion])
    made = ExistingCommand(own.motors, own.spacing, own.share, own.servo_share)
    late = Uncertainty(servo_delay=4e-3, draws=50)
    same, other = (
        judge_existing_command(problem, arm, [motion], made, uncertainty=each)
        for each in (None, late)
    )
    # The middle of both delays would be 3 ms.
    assert other.ahead == same.ahead == pytest.approx(2e-3)
    for phase in ("flight", "after"):
        before, anew = (getattr(each.optimised.compensated, phase) for each in (same, other))
        assert anew.nominal == pytest.approx(before.nominal, rel=1e-9)
    assert other.optimised.compensated.flight.worst > same.optimised.compensated.flight.worst


def test_motions_and_commands_are_sent_as_early_whatever_loop_follows_them(tmp_path):
    """By the dead time of the problem's servo, as those of a cycle are."""
    problem = load(tmp_path, extra="[servo]\nbandwidth = 20.0\ndelay = '2 ms'")
    problem = replace(problem, uncertainty=Uncertainty(draws=50))
    motion, later = planned(problem, 0.8), Servo(20.0, 1.0, 4e-3)
    arm = elastic_arm(problem, motion.position[0])
    (found,) = simulate_motions(problem, arm, [motion], servo=later).motions
    alone = simulate(arm, motion.followed, servo=later, ahead=2e-3, plan=motion.planned_path)
    np.testing.assert_allclose(found.simulated.position, alone.position, rtol=0, atol=1e-12)
    (own,) = commands_on_arms(problem, arm, [motion])
    made = ExistingCommand(own.motors, own.spacing, own.share, own.servo_share)
    known, unknown = (
        judge_existing_command(problem, arm, [motion], made, servo=each).optimised
        for each in (problem.servo, later)
    )
    tool_speed = np.linalg.norm(np.diff(arm.tool(motion.position), axis=0), axis=1) / np.diff(
        motion.time
    )
    # Sent by the loop's own dead time it would be 2 ms early.
    early = unknown.compensated.flight.nominal - known.compensated.flight.nominal
    assert early < 0.05 * 2e-3 * tool_speed.max()


def test_rival_is_slowed_before_its_command_is_judged_on_drawn_arms(tmp_path, monkeypatch):
    problem = replace(load(tmp_path), uncertainty=Uncertainty(draws=50))
    path = JointPath.through(resolve(problem).points)
    rival = FairRival(problem, path, "quintic", quintic_law(1.0))
    fastest = assess(problem, rival.at(0.33))
    motion = PlannedMotion.of_rival(rival, fastest, True)
    judged, judge = [], command_search.CommandSearch.judge_existing

    def noted(search, made):
        judged.append(made)
        return judge(search, made)

    monkeypatch.setattr(command_search.CommandSearch, "judge_existing", noted)
    (found,) = rival_commands(problem, elastic_arm(problem, fastest.position[0]), [motion])
    assert found.motion.time[-1] > 1.01 * fastest.duration
    assert found.excess == ()
    assert len(judged) == 1


def test_slower_rival_is_compared_with_the_motion_slowed_to_its_duration(tmp_path):
    """The same motion in more time has less error, and at equal duration the same."""
    problem = replace(load(tmp_path), uncertainty=Uncertainty(draws=50))
    path = JointPath.through(resolve(problem).points)
    rival = FairRival(problem, path, "quintic", quintic_law(1.0))
    quick = PlannedMotion.of_solution(assess(problem, rival.at(0.4)), rival.at(0.4))
    calm = PlannedMotion.of_rival(rival, assess(problem, rival.at(0.6)), True)
    found = compensate(problem, elastic_arm(problem, quick.position[0]), [quick, calm])
    own, slow = (each.compensated.worst_case for each in found.motions)
    assert slow < 0.6 * own
    assert found.ratios == pytest.approx((1.0, 1.0), rel=1e-6)
    assert found.beside_best.ratios["across the path"] == pytest.approx(1.0, rel=1e-6)
    assert not found.rival_wins
    assert found.rival_command is None
    rows = compensation_section(found).rows
    assert [row[:2] for row in rows[2:]] == [
        *[["quintic", "0.6 s"]] * 2,
        ["optimised, slowed", "0.6 s"],
    ]
    assert "slowed to 0.6 s" in rival_text(found)


def test_rival_that_wins_is_handed_over_with_a_command_within_the_limits(tmp_path):
    problem = replace(load(tmp_path), uncertainty=Uncertainty(draws=50))
    path = JointPath.through(resolve(problem).points)
    rival = FairRival(problem, path, "quintic", quintic_law(1.0))
    rough = FairRival(problem, path, "optimised", s_curve_law(problem, path, 0.4)).at(0.6)
    quick = PlannedMotion.of_solution(assess(problem, rough), rough)
    calm = PlannedMotion.of_rival(rival, assess(problem, rival.at(0.6)), True)
    arm = elastic_arm(problem, quick.position[0])
    found = compensate(problem, arm, [quick, calm])
    assert found.rival_wins
    assert found.best_rival.name == "quintic"
    # The plan ends where the motion does, and its command keeps every limit of the motors.
    assert found.rival_plan.time[-1] == pytest.approx(0.6)
    np.testing.assert_allclose(found.rival_plan.position[-1], quick.position[-1], atol=1e-9)
    command = found.rival_command
    assert max(each.value for each in command.violations) <= 5e-3
    assert np.max(np.abs(command.position - command.link)) > 1e-5
    write_rival(found, tmp_path)
    for name, wanted in (("rival_command", command), ("rival_trajectory", found.rival_plan)):
        rows = np.loadtxt(tmp_path / f"{name}.csv", delimiter=",", skiprows=1)
        np.testing.assert_allclose(rows[:, 1:3], wanted.position, atol=1e-9)
    # Those of an earlier solve go with the rival's advantage.
    write_rival(replace(found, rival_plan=None, rival_command=None), tmp_path)
    assert not list(tmp_path.glob("rival_*"))


def test_without_a_command_within_the_limits_the_one_of_least_excess_is_taken(
    tmp_path, monkeypatch
):
    problem = load(tmp_path)
    motion = replace(planned(problem, 0.31), exceeded=())
    arm, law = elastic_arm(problem, motion.position[0]), MotorLaw(problem.robot)
    search = command_search.CommandSearch(problem, arm, motion, law)
    leads = list(map(search._lead_of, search._spacings))
    assert not any(command_search._LeadWithinLimits(search, lead).servo_shares for lead in leads)
    monkeypatch.setattr(search, "_worst_arms", None)  # nothing is simulated
    excess = [search.excess_beyond_plan(each.command(1.0, 0.0).motors) for each in leads]
    assert min(excess) < 0.9 * max(excess)
    chosen = search.chosen_command()
    assert search.excess_beyond_plan(chosen.motors) == pytest.approx(min(excess))
