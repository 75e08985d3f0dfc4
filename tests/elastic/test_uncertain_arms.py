"""Batch simulation of uncertain arms against the full simulation; corner cases and draws."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from elastic_arms import arm, bang, there_and_stop

from stiffopt.elastic import uncertain_arms
from stiffopt.elastic.led_error import worst_levels
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.simulate import simulate
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import (
    Departure,
    ParameterBox,
    Uncertainty,
    bounds_from_deviations,
)
from stiffopt.errors import InputError, ProblemError, RobotError
from stiffopt.result.trajectory import Trajectory, join_motions


def planar(folder, payload=1.0):
    elastic = arm(folder, "planar", at=(0.3, 0.4))
    loaded = elastic.robot.with_payload(payload, (0.0, 0.0, 0.0), (1e-3, 1e-3, 1e-3))
    return type(elastic)(loaded, np.array([0.3, 0.4]))


def test_batch_deviations_agree_with_full_simulation(tmp_path):
    elastic = planar(tmp_path)
    command = bang((3.0, -4.0), 0.2, (0.3, 0.4))
    plan = there_and_stop((3.0, -4.0), 0.2, (0.3, 0.4))
    unsure = Uncertainty(servo_feed_forward=0.98)
    levels = [
        [-1.0, -1.0, 0.0, 0.0, -1.0, 1.0, -1.0],
        [1.0, -1.0, 0.0, 0.0, 1.0, -1.0, -1.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    ]
    box = ParameterBox(unsure, elastic.robot)
    arms = [Departure.none(2), *(box.departure(np.array(each)) for each in levels)]
    members = [Member(command=command, departure=each) for each in arms]
    swings = UncertainArms(elastic, plan, worst=unsure.worst_servo(Servo())).simulate(members)
    for k, each in enumerate(arms):
        servo = unsure.worst_servo(Servo()) if each.servo else None
        full = simulate(elastic.with_departure(each), command, servo=servo)
        assert swings.peaks(swings.flight)["position"][k] == pytest.approx(full.peak, rel=0.02)
        assert swings.peaks(swings.after)["position"][k] == pytest.approx(full.peak_after, rel=0.02)


def test_arms_that_differ_in_damping_share_their_equilibrium(tmp_path, monkeypatch):
    elastic, solved = planar(tmp_path), []
    sound = uncertain_arms.solve_equilibrium

    def counted(springs, weight, arms, turn):
        solved.append(turn.shape[:2])
        return sound(springs, weight, arms, turn)

    many = UncertainArms(elastic, there_and_stop((3.0, -4.0), 0.2, (0.3, 0.4)))
    monkeypatch.setattr(uncertain_arms, "solve_equilibrium", counted)
    soft = np.array([0.9, 0.8])
    arms = [
        Departure.none(2),
        *(Departure(stiffness=soft, damping=factor) for factor in (1.0, 1.5)),
    ]
    command = bang((3.0, -4.0), 0.2, (0.3, 0.4))
    members = [Member(command=command, departure=each) for each in arms]
    together = many.position_peaks(members)
    alone = [many.position_peaks([each])[:, 0] for each in reversed(members)]
    assert together == pytest.approx(np.array(alone[::-1]).T, rel=1e-9)
    # Beside those of the start: two for three arms, which stay known.
    along = [count for count, samples in solved if samples > 1]
    assert along == [2]


def test_twice_the_stiffness_halves_the_windup(tmp_path):
    elastic = arm(tmp_path, "planar")
    torque = np.linspace(-20.0, 20.0, 41)
    for spring in elastic.springs:
        stiff = spring.times(2.0)
        assert stiff.windup(2.0 * torque) == pytest.approx(spring.windup(torque), abs=1e-15)
        assert stiff.torque(spring.windup(torque)) == pytest.approx(2.0 * torque, abs=1e-9)
        angle = float(spring.windup(np.array([5.0]))[0])
        assert stiff.torque_at(angle)[1] == pytest.approx(2.0 * spring.torque_at(angle)[1])


def test_rigid_joints_follow_their_motors_in_a_batch(tmp_path):
    from elastic_arms import one_soft_joint

    elastic = one_soft_joint(tmp_path)
    command = bang((3.0, -4.0), 0.2, (0.3, 0.4))
    plan = there_and_stop((3.0, -4.0), 0.2, (0.3, 0.4))
    one = [Member(command=command, departure=Departure.none(2))]
    found, full = UncertainArms(elastic, plan).simulate(one), simulate(elastic, command)
    assert found.peaks(found.flight)["position"][0] == pytest.approx(full.peak, rel=0.02)
    assert found.peaks(found.after)["position"][0] == pytest.approx(full.peak_after, rel=0.02)


def test_heavier_payload_increases_windup(tmp_path):
    elastic = planar(tmp_path, payload=2.0)
    heavier = elastic.with_departure(Departure(stiffness=np.ones(2), payload=1.5))
    q = np.array([0.3, 0.4])
    more = heavier.static_torque(q) - elastic.static_torque(q)
    empty = elastic.with_departure(Departure(stiffness=np.ones(2), payload=0.0)).static_torque(q)
    assert more == pytest.approx(0.5 * (elastic.static_torque(q) - empty), rel=1e-9)
    with pytest.raises(RobotError, match="the factor of a payload"):
        elastic.robot.with_payload_times(-0.1)


def test_corners_and_draws_are_within_bounds(tmp_path):
    unsure, robot = Uncertainty(stiffness=(0.1, 0.3), seed=3), planar(tmp_path).robot
    box = ParameterBox(unsure, robot)
    found = [box.departure(each) for each in box.alike_corners()]
    assert len(found) == 16
    assert {tuple(each.stiffness) for each in found} == {(0.9, 0.7), (1.1, 1.3)}
    assert {each.payload for each in found} == {0.9, 1.1}
    assert {each.servo for each in found} == {0.0, 1.0}
    empty = ParameterBox(unsure, replace(robot, payload=None), servo=False)
    assert len(empty.alike_corners()) == 4
    nominal, modelled = box.departure(box.nominal), Departure.none(2)
    assert nominal.factors() == modelled.factors()
    arms = box.drawn()
    stiffness = np.array([each.stiffness for each in arms])
    assert len(arms) == 100
    assert np.all(np.abs(stiffness - 1.0) <= [0.1, 0.3])
    assert np.all(np.std(stiffness, axis=0) > [0.04, 0.12])
    assert np.array_equal(stiffness, np.array([each.stiffness for each in box.drawn()]))
    assert "stiffness -10 % of J1, -30 % of J2" in found[0].label


def test_worst_arms_are_the_worst_corners_of_all(tmp_path):
    elastic = planar(tmp_path)
    plan = there_and_stop((3.0, -4.0), 0.2, (0.3, 0.4))
    command, unsure = MotorMotion.of(plan), Uncertainty(draws=200)
    many = UncertainArms(elastic, plan)
    box = ParameterBox(unsure, elastic.robot, servo=False)
    worst = worst_levels(many, command, box)
    every = np.zeros((16, len(box.nominal)))
    every[:, box.free] = list(product((-1.0, 1.0), repeat=4))

    def peaks(arms):
        error = many.simulate([Member(command=command, departure=each) for each in arms])
        return [error.peaks(phase)["position"].max() for phase in (error.flight, error.after)]

    found = peaks([box.departure(each) for each in worst])
    assert found == pytest.approx(peaks([box.departure(each) for each in every]))
    # Arms within the box may be worse than its corners, but hardly.
    assert np.all(1.02 * np.array(found) >= peaks(box.drawn()))


def test_standard_deviations_give_stiffness_bounds():
    unsure = bounds_from_deviations(Uncertainty(), np.array([np.nan, 0.03, 0.8]))
    assert unsure.stiffness == pytest.approx((0.2, 0.03 * np.sqrt(3.0), 0.99))
    assert unsure.payload == Uncertainty().payload
    heavy = bounds_from_deviations(Uncertainty(), np.array([np.nan, np.nan]), 0.03)
    assert heavy.payload == pytest.approx(0.03 * np.sqrt(3.0))
    assert heavy.stiffness == Uncertainty().stiffness


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"stiffness": 1.0}, "lets the stiffness of a joint be zero or negative"),
        ({"stiffness": (0.1, 1.4)}, "stiffness = 1.4"),
        ({"stiffness": -0.1}, "stiffness"),
        ({"damping": 1.2}, "lets the damping of a joint be negative"),
        ({"payload": 1.5}, "payload"),
        ({"servo_bandwidth": 20.0, "servo_delay": 0.02}, "the servo is unstable"),
        ({"servo_bandwidth": 0.0}, "servo_bandwidth"),
        ({"draws": 10}, "draws"),
    ],
)
def test_invalid_uncertainties_are_refused(given, what):
    with pytest.raises(InputError, match=what):
        Uncertainty(**given)


def test_stiffness_shares_must_match_the_joints():
    with pytest.raises(ProblemError, match="has 3 numbers"):
        Uncertainty(stiffness=(0.1, 0.1, 0.1)).shares(2)


def test_damping_above_critical_is_refused_with_its_limit(tmp_path):
    elastic = arm(tmp_path, "planar")
    damped = type(elastic)(
        elastic.robot.__class__(**{**vars(elastic.robot), "damping": 40.0 * elastic.damping}),
        np.zeros(2),
    )
    with pytest.raises(RobotError, match=r"uncertainty.damping lets .* critical") as told:
        damped.with_departure(Departure(stiffness=np.ones(2), damping=1.5))
    # 40 times the 2 % that are assumed: a quarter more is critical.
    assert "from 0 to 0.2" in str(told.value)
    largest = float(str(told.value).split("uncertainty.damping = ")[1].rstrip("."))
    assert largest == pytest.approx(0.25, abs=0.0011)
    damped.with_departure(Departure(stiffness=np.ones(2), damping=1.0 + largest))


def test_worst_servo_has_the_stated_bounds_and_typical_ones_elsewhere():
    nominal = Servo(kind="industrial")
    worst = Uncertainty(servo_delay=1e-3).worst_servo(nominal)
    assert worst.delay == 1e-3
    assert worst.bandwidth == pytest.approx(0.8 * nominal.bandwidth)
    assert worst.torque_feed_forward == pytest.approx(nominal.torque_feed_forward - 0.1)
    assert (worst.feed_forward, worst.rate) == (nominal.feed_forward, nominal.rate)


def test_members_in_parts_are_those_of_one_batch(tmp_path, monkeypatch):
    elastic = planar(tmp_path)
    command, plan = (made((1.0, -1.0), 0.2, (0.3, 0.4)) for made in (bang, there_and_stop))
    box = ParameterBox(Uncertainty(), elastic.robot)
    levels = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 7))
    members = [Member(command=command, departure=box.departure(each)) for each in levels]
    many = UncertainArms(elastic, plan)
    whole = many.simulate(members)
    monkeypatch.setattr(uncertain_arms, "_MAX_EQUILIBRIA", 1)
    monkeypatch.setattr(uncertain_arms, "_MEMBERS_AT_ONCE", 1)
    monkeypatch.setattr(uncertain_arms, "_STEPS_AT_ONCE", 7)
    many = UncertainArms(elastic, plan)
    parts = many.simulate(members)
    for found, phase in zip(many.peaks(members), (whole.flight, whole.after), strict=True):
        for name, peaks in whole.peaks(phase).items():
            np.testing.assert_allclose(found[name], peaks, rtol=1e-9)
    own = many.position_peaks(members)
    np.testing.assert_allclose(own, [whole.peak(whole.flight), whole.peak(whole.after)], rtol=1e-9)
    # All end where one is not below the bound.
    bound = 0.5 * own.max(axis=1).sum()
    some = many.position_peaks(members, below=bound)
    assert bound <= some.max(axis=1).sum() < own.max(axis=1).sum()
    assert np.all(some <= own)
    assert parts.position.shape == whole.position.shape
    np.testing.assert_allclose(parts.position, whole.position, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(parts.orientation, whole.orientation, rtol=1e-12, atol=1e-15)


def test_weighted_sums_of_commands_have_the_errors_of_the_summed_commands(tmp_path, monkeypatch):
    elastic = planar(tmp_path)
    plan = there_and_stop((1.0, -1.0), 0.2, (0.3, 0.4))
    ends = [there_and_stop((1.0 + share, -1.0), 0.2, (0.3, 0.4)) for share in (0.0, 0.01)]
    shares = np.array([0.0, 0.3, 1.0])
    box = ParameterBox(Uncertainty(), elastic.robot)
    arms = [box.departure(each) for each in np.random.default_rng(3).uniform(-1.0, 1.0, (5, 7))]
    many = UncertainArms(elastic, plan)
    summed = []
    for share in shares:
        command = MotorMotion.of(ends[0].mixed_with(ends[1], share))
        found = many.position_peaks([Member(command=command, departure=each) for each in arms])
        summed.append(found.max(axis=1).sum())
    weights = np.column_stack([1.0 - shares, shares])
    commands = list(map(MotorMotion.of, ends))
    found = many.mixed_peaks(commands, arms, weights)
    assert summed[2] > 1.5 * summed[0]
    np.testing.assert_allclose(found, summed, rtol=1e-3)
    monkeypatch.setattr(uncertain_arms, "_STEPS_AT_ONCE", 7)
    parts = UncertainArms(elastic, plan).mixed_peaks(commands, arms, weights)
    np.testing.assert_allclose(parts, found, rtol=1e-9)
    # All end where none is below the bound.
    ended = UncertainArms(elastic, plan).mixed_peaks(commands, arms, weights, 0.5 * found.min())
    assert 0.5 * found.min() <= ended.min() < found.min()


def test_one_derivative_of_the_bodies_stands_for_several_steps(tmp_path, monkeypatch):
    elastic = planar(tmp_path)
    command, plan = (made((3.0, -4.0), 0.2, (0.3, 0.4)) for made in (bang, there_and_stop))
    box = ParameterBox(Uncertainty(payload=0.3), elastic.robot)
    levels = np.random.default_rng(2).uniform(-1.0, 1.0, (5, 7))
    members = [Member(command=command, departure=box.departure(each)) for each in levels]
    held = UncertainArms(elastic, plan)
    monkeypatch.setattr(uncertain_arms, "_BODY_STRIDE", 1)
    monkeypatch.setattr(uncertain_arms, "_BODY_CHANGES", (1e-9, 1e-9, 1e-9))
    exact = UncertainArms(elastic, plan)
    assert held.bodies.nbytes < 0.2 * exact.bodies.nbytes
    peaks = exact.position_peaks(members)
    np.testing.assert_allclose(held.position_peaks(members), peaks, rtol=0, atol=3e-4 * peaks.max())


def test_worst_arms_are_searched_where_corners_deviate_most(tmp_path, monkeypatch):
    """The search takes blocks of steps with a lead time; its arms are those of the whole motion."""
    elastic = planar(tmp_path)
    slow, fast = (there_and_stop((size, -size), half, (0.3, 0.4)) for size, half in
                  ((0.3, 0.4), (3.0, 0.2)))  # fmt: skip
    plan = join_motions([(slow, 2.0), (fast, 2.0), (slow, 0.0)])
    command, box = MotorMotion.of(plan), ParameterBox(Uncertainty(), elastic.robot, servo=False)

    def worst(many):
        levels = worst_levels(many, command, box)
        members = [Member(command=command, departure=box.departure(each)) for each in levels]
        return members, many.position_peaks(members)

    _, whole = worst(UncertainArms(elastic, plan))
    monkeypatch.setattr(uncertain_arms, "_STEPS_AT_ONCE", 400)
    monkeypatch.setattr(uncertain_arms, "_SEARCHED_BLOCKS", 2)
    many = UncertainArms(elastic, plan)
    members, peaks = worst(many)
    np.testing.assert_allclose(peaks.max(axis=1), whole.max(axis=1), rtol=0.02)
    # Where the search sees less than the bound, all blocks are judged.
    np.testing.assert_array_equal(
        many.position_peaks(members, 1.01 * peaks.max(axis=1).sum()), peaks
    )
    assert sum(len(run) for run in many._searched) <= 6 < len(many._whole[0]) // 2


def test_servo_responds_in_parts_as_in_one(tmp_path, monkeypatch):
    elastic, servo = planar(tmp_path), Servo(kind="industrial")
    rise = np.outer([0.0, 0.3, 0.0, -0.3, 0.0], [1.0, -1.0])
    plan = Trajectory.piecewise_linear_acceleration(np.arange(5), rise, (0.3, 0.4), (0.0, 0.0))
    command = MotorMotion.of(plan)
    found = []
    for blocks in (1000, 2):
        monkeypatch.setattr(uncertain_arms, "_SERVO_BLOCKS", blocks)
        monkeypatch.setattr(uncertain_arms, "_STEPS_AT_ONCE", 600)
        many = UncertainArms(elastic, plan, servo, Uncertainty().worst_servo(servo))
        many.position_peaks([Member(command=command, departure=Departure.none(2))])
        found.append(many.motors(command))
    assert len(many._whole[0]) > 6
    np.testing.assert_allclose(found[1], found[0], atol=1e-6 * np.abs(found[0]).max())
