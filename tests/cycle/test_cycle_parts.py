"""Parts of a cycle against closed forms: payload change, duty, time split, joined motions."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_arms import CONSTANT, joint, write_robot

from stiffopt.cycle.time_split import ShortestDuration, TimeSplit, combined
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.report.pages.cycle import write_cycle_report
from stiffopt.result.cycle import CycleSolution, JoinedMotion, LegResult
from stiffopt.result.duty import DutyHistory, DutyLimits, LifeRating, duty_of
from stiffopt.result.status import SolveStatus
from stiffopt.result.trajectory import Trajectory
from stiffopt.robot.files import load_robot

STIFFNESS = 1e4


def test_gripped_part_makes_the_tool_vibrate_by_its_static_displacement(tmp_path):
    """A horizontal link at rest takes a mass: it vibrates between the old and twice the new sag."""
    spring = [joint("shoulder", CONSTANT.format(stiffness=STIFFNESS))]
    robot = load_robot(write_robot(tmp_path, "pendulum", joints=spring))
    robot = replace(robot, damping=np.zeros(1))
    at = np.zeros(1)
    mass, length = 1.5, 0.4
    before, after = ElasticArm(robot, at), ElasticArm(robot.with_payload(mass), at)
    rest = MotorMotion(np.array([0.0, 0.3]), np.zeros((2, 1)), np.zeros((2, 1)))
    event = 0.1234
    found = simulate(before, rest, changes=[(event, after)])
    assert found.distance[found.time < event].max() < 1e-9
    inertia = 1e-2 + 2.0 * 0.2**2 + mass * length**2
    rate = np.sqrt(STIFFNESS / inertia)
    jump = mass * 9.81 * length / STIFFNESS * length
    later = found.time > event
    wanted = jump * np.abs(np.cos(rate * (found.time[later] - event)))
    # Sag turns the link by 1 mrad at most: its lever arm is constant within 1e-6.
    np.testing.assert_allclose(found.distance[later], wanted, atol=2e-3 * jump)
    assert found.distance.max() == pytest.approx(jump, rel=1e-3)


def test_change_at_arrival_counts_afterwards(tmp_path):
    robot = load_robot(write_robot(tmp_path, "pendulum"))
    before, after = (ElasticArm(each, np.zeros(1)) for each in (robot, robot.with_payload(1.0)))
    rest = MotorMotion(np.array([0.0, 0.2]), np.zeros((2, 1)), np.zeros((2, 1)))
    found = simulate(before, rest, changes=[(0.2, after)])
    assert found.peak < 1e-9
    assert found.peak_after > 1e-5


def test_joined_motion_rests_between_parts_and_overlaps_without_a_jump():
    def quintic(start, end, duration):
        rates = np.array([[[0.0], [60.0], [-180.0], [120.0]]]) * (end - start)
        rates /= duration ** np.array([2.0, 3.0, 4.0, 5.0])[:, None]
        return Trajectory.from_acceleration([0.0, duration], rates, [start], [0.0])

    joined = JoinedMotion([quintic(0.0, 1.0, 1.0), quintic(1.0, 0.5, 0.5)], [0.0, 1.2], 2.0)
    times = np.array([0.0, 0.5, 1.0, 1.1, 1.2, 1.45, 1.7, 2.0])
    assert joined(times)[:, 0] == pytest.approx([0.0, 0.5, 1.0, 1.0, 1.0, 0.75, 0.5, 0.5])
    assert joined(times, 1)[[0, 3, 7], 0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    fine = np.linspace(0.0, 2.0, 4001)
    slope = np.gradient(joined(fine)[:, 0], fine)
    np.testing.assert_allclose(joined(fine, 1)[:, 0], slope, atol=2e-3)
    # The second part begins before the first has ended: both add.
    early = JoinedMotion([quintic(0.0, 1.0, 1.0), quintic(1.0, 0.5, 0.5)], [0.0, 0.9], 1.5)
    assert early(np.array([1.5]))[0, 0] == pytest.approx(0.5)


def one_joint(rating, prismatic=False):
    """Robot of one joint whose reducer has a rating."""
    element = SimpleNamespace(
        rated_torque=rating.torque, rated_speed=rating.speed, rated_life=rating.life,
        life_exponent=rating.exponent)  # fmt: skip
    stages = [SimpleNamespace(element=element, reduction=1.0, ratio=1.0)]
    return SimpleNamespace(n=1, joint_names=["a"], torque_max=[60.0], prismatic=[prismatic],
                           chains=[SimpleNamespace(stages=stages)])  # fmt: skip


def test_duty_of_a_duty_cycle_by_hand():
    """Half the time 30 N m at 2 rad/s, a quarter -10 N m at 4 rad/s, a quarter holding 20 N m."""

    def piece(start, end, torque, speed):
        rows = [np.full((2, 1), each) for each in (speed, torque, torque)]
        return DutyHistory(time=np.array([start, end]), velocity=rows[0], torque=rows[1],
                           reducer_torque=rows[2])  # fmt: skip

    rating = LifeRating(torque=40.0, speed=2.0, life=7000.0 * 3600.0, exponent=3.0)
    parts = [piece(0.0, 2.0, 30.0, 2.0), piece(2.0, 3.0, -10.0, 4.0), piece(3.0, 4.0, 20.0, 0.0)]
    (found,) = duty_of(one_joint(rating), parts).joints
    assert found.rms_torque == pytest.approx(np.sqrt((2 * 900 + 100 + 400) / 4))
    assert (found.peak_torque, found.peak_speed, found.peak_power) == (30.0, 4.0, 60.0)
    assert (found.energy, found.regenerated) == (120.0, 40.0)
    assert found.mean_speed == pytest.approx(2.0)
    mean = ((4 * 30.0**3 + 4 * 10.0**3) / 8) ** (1 / 3)
    assert found.mean_torque == pytest.approx(mean)
    assert found.life == pytest.approx(7000 * 3600 * (40 / mean) ** 3)


def test_limits_of_the_duty_name_joint_and_numbers():
    time, rate = np.array([0.0, 1.0]), np.ones((2, 1))
    part = DutyHistory(time=time, velocity=rate, torque=5 * rate, reducer_torque=8 * rate)
    rating = LifeRating(torque=4.0, speed=1.0, life=3600.0 * 80.0, exponent=3.0)
    duty = duty_of(one_joint(rating), [part])
    limits = DutyLimits(rms_torque=np.array([4.0]), reducer_life=3600.0 * 11.0, energy=6.0)
    torque, life, work = limits.uses(duty)
    assert "rms torque of a, 5 N m, exceeds duty.rms_torque 4 N m" in torque.text
    assert "lasts 10 h, below duty.reducer_life 11 h" in life.text
    # What grows with the integral: the square of the torque, the inverse of the life, the work.
    shares = [each.share for each in (torque, life, work)]
    assert shares == pytest.approx([25.0 / 16.0, 1.1, 5.0 / 6.0])
    assert not DutyLimits().uses(duty)
    force = limits.uses(duty_of(one_joint(rating, prismatic=True), [part]))[0]
    assert "rms torque of a, 5 N, exceeds duty.rms_torque 4 N" in force.text
    assert "N m" not in force.text


@pytest.mark.parametrize("by", ["peak", "rms", "sum"])
def test_time_split_finds_the_optimum_of_power_laws(by):
    """Legs whose objective is c/T^p: the split found beats all others nearby."""
    c, p = np.array([0.3, 2.0, 0.05]), np.array([2.0, 3.0, 2.5])
    split = TimeSplit(3.0, np.ones(3), by)
    for _ in range(25):
        split.learn(c / split.durations**p)
        split.durations = split.proposal()
        assert split.durations.sum() == pytest.approx(3.0)

    def value(durations):
        return combined(c / durations**p, durations, by)

    best = value(split.durations)
    random = np.random.default_rng(0)
    for _ in range(300):
        other = split.durations * np.exp(0.05 * random.normal(size=3))
        assert value(3.0 * other / other.sum()) > best * (1.0 - 1e-6)


@pytest.mark.parametrize("shortest", [0.0, 0.5])
def test_shortest_duration_within_a_limit(shortest):
    """Of c/T^2.7 beside a floor, and of one that fails below 0.5 s."""
    search = ShortestDuration(0.2, 1.7)
    best, solves = None, 0
    while (duration := search.proposal()) is not None:
        solves += 1
        value = np.nan if duration < shortest else 0.01 + 0.03 / duration**2.7
        if search.learn(value):
            best = duration
    exact = max((0.03 / 0.19) ** (1 / 2.7), shortest)
    assert exact <= best < 1.01 * exact
    assert solves <= 12


def test_time_split_gives_a_failed_leg_more_and_says_when_time_is_short():
    split = TimeSplit(2.0, np.array([1.0, 1.0]), "peak")
    split.learn(np.array([np.nan, 0.1]))
    split.durations = split.proposal()
    assert split.durations[0] > 1.02
    assert split.durations.sum() == pytest.approx(2.0)
    split.learn(np.array([np.nan, np.nan]))
    assert split.proposal() is None


def test_page_of_a_cycle_without_a_motion_says_why(tmp_path):
    failed = SimpleNamespace(assessment=None, objective=None, status=SolveStatus.ITERATION_LIMIT)
    leg = LegResult(name="to pick", moves=("pick",), problem=None, solution=failed, start=0.0,
                    arrival=1.0, dwell=0.0, until_settled=False, event="", mass_before=1.0,
                    mass_after=1.0)  # fmt: skip
    found = CycleSolution(status=SolveStatus.ITERATION_LIMIT, message="stalled in leg 1",
                          title="a cycle", legs=(leg,), objective=None)  # fmt: skip
    page = write_cycle_report(None, found, tmp_path).read_text()
    assert page.count("stalled in leg 1") == 1
    assert "No usable motion of the whole cycle: iteration limit in leg to pick" in page
    assert "cycle time" not in page
    assert "<figure" not in page
