from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stiffopt.errors import OutOfValidityError, ProblemError
from stiffopt.result.trajectory import Trajectory


def random_trajectory(seed: int, degree: int = 2, joints: int = 3) -> Trajectory:
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.6, 7))])
    coefficients = rng.normal(0, 5, (7, degree + 1, joints))
    return Trajectory.from_acceleration(times, coefficients, rng.normal(size=joints), [1, -2, 0])


def test_constant_acceleration_gives_a_parabola() -> None:
    fall = Trajectory.from_acceleration([0.0, 1.0, 3.0], [[[-9.81]], [[-9.81]]], [2.0], [4.0])
    t = np.linspace(0, 3, 31)
    assert fall(t)[:, 0] == pytest.approx(2 + 4 * t - 9.81 / 2 * t**2, rel=1e-13)
    assert fall(t, 1)[:, 0] == pytest.approx(4 - 9.81 * t, rel=1e-13, abs=1e-13)
    assert np.all(fall(t, 2) == -9.81)
    assert np.all(fall(t, 3) == 0.0)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), degree=st.integers(0, 5), order=st.integers(0, 2))
def test_each_order_is_the_integral_of_the_next(seed: int, degree: int, order: int) -> None:
    motion = random_trajectory(seed, degree)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    for low, high in zip(motion.times[:-1], motion.times[1:], strict=True):
        t = 0.5 * (high + low) + 0.5 * (high - low) * nodes
        gain = 0.5 * (high - low) * weights @ motion(t, order + 1)
        # Just before the break, because acceleration may jump there.
        before = motion(high - 1e-13, order)
        assert before - motion(low, order) == pytest.approx(gain, abs=1e-9)


def test_position_and_velocity_are_continuous_at_breaks() -> None:
    motion = random_trajectory(3)
    for order in (0, 1):
        inner = motion.times[1:-1]
        jump = motion(inner, order) - motion(inner - 1e-12, order)
        assert np.max(np.abs(jump)) < 1e-9


def test_linear_acceleration_passes_its_nodes() -> None:
    rng = np.random.default_rng(1)
    times = np.array([0.0, 0.2, 0.5, 1.0])
    nodes = rng.normal(size=(4, 2))
    motion = Trajectory.piecewise_linear_acceleration(times, nodes, [0, 1], [2, 3])
    assert motion(times, 2) == pytest.approx(nodes, abs=1e-14)
    middle = 0.5 * (times[:-1] + times[1:])
    assert motion(middle, 2) == pytest.approx(0.5 * (nodes[:-1] + nodes[1:]), abs=1e-14)
    # The trapezoidal rule is exact for the velocity.
    gain = 0.5 * (nodes[:-1] + nodes[1:]) * np.diff(times)[:, None]
    assert motion(1.0, 1) == pytest.approx(np.array([2, 3]) + gain.sum(axis=0), rel=1e-14)


def test_scaled_duration_keeps_the_path_and_scales_the_rates() -> None:
    motion = random_trajectory(5)
    slow = motion.scaled_to(2.5 * motion.duration)
    x = np.linspace(0, 1, 101)[:-1]
    assert slow.duration == 2.5 * motion.duration
    for order in range(4):
        expected = motion(x * motion.duration, order) / 2.5**order
        assert slow(x * slow.duration, order) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_single_times_and_shapes() -> None:
    motion = random_trajectory(2)
    assert motion(0.1).shape == (3,)
    assert motion([0.1]).shape == (1, 3)
    assert motion(np.full((2, 4), 0.1), 1).shape == (2, 4, 3)
    assert motion.joints == 3
    assert np.array_equal(motion(0.0), motion.q0)
    # At the end the last interval answers.
    assert motion(motion.duration, 3) == pytest.approx(motion(motion.duration - 1e-9, 3), rel=1e-6)


def test_samples_include_the_end() -> None:
    motion = Trajectory.from_acceleration([0.0, 1.0], [[[1.0]]], [0.0], [0.0])
    assert motion.sample(0.25) == pytest.approx([0, 0.25, 0.5, 0.75, 1.0], abs=1e-15)
    assert motion.sample(0.3) == pytest.approx([0, 0.3, 0.6, 0.9, 1.0], abs=1e-15)
    many = motion.sample(0.002)
    assert len(many) == 501
    assert many[-1] == 1.0
    with pytest.raises(ProblemError, match="step must be positive"):
        motion.sample(0.0)


@pytest.mark.parametrize("time", [-0.1, 1.1, np.nan])
def test_times_outside_are_refused(time: float) -> None:
    motion = Trajectory.from_acceleration([0.0, 1.0], [[[1.0]]], [0.0], [0.0])
    with pytest.raises(OutOfValidityError, match="validity range 0 to 1"):
        motion(time)


@pytest.mark.parametrize(
    ("times", "coefficients", "message"),
    [
        ([0.1, 1.0], [[[1.0]]], "start at 0"),
        ([0.0, 1.0, 1.0], [[[1.0]], [[1.0]]], "increase strictly"),
        ([0.0, 1.0], [[[1.0]], [[1.0]]], "shape"),
        ([0.0, 1.0], [[[np.nan]]], "not finite"),
    ],
)
def test_invalid_coefficients_are_refused(
    times: object, coefficients: object, message: str
) -> None:
    with pytest.raises(ProblemError, match=message):
        Trajectory.from_acceleration(times, coefficients, [0.0], [0.0])


def test_trajectory_is_immutable() -> None:
    motion = random_trajectory(1)
    with pytest.raises(ValueError, match="read-only"):
        motion.times[0] = 1.0


def test_import_of_trajectory_is_light() -> None:
    code = (
        "import sys, stiffopt.result.trajectory;"
        "print([m for m in ('scipy', 'casadi', 'pinocchio', 'toppra') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_sum_is_exact_for_breaks_microseconds_apart():
    rng = np.random.default_rng(2)
    own, other = np.array([0.0, 0.4, 0.4 + 5e-6, 1.0]), np.array([0.0, 0.4 + 2e-6, 0.7, 1.0])
    motion = Trajectory(own, rng.normal(size=(3, 6, 2)), np.ones(2), np.ones(2))
    change = Trajectory(other, rng.normal(size=(3, 4, 2)), np.zeros(2), np.zeros(2))
    both = motion.plus(change)
    assert both.duration == motion.duration
    times = np.union1d(np.linspace(0.0, 1.0, 301), 0.4 + 1e-6 * np.arange(-1, 7))
    for order in range(4):
        wanted = motion(times, order) + change(times, order)
        np.testing.assert_allclose(both(times, order), wanted, rtol=1e-9, atol=1e-9)
    # What is added may be the one of more powers.
    again = change.plus(motion)
    np.testing.assert_allclose(again(times, 3), both(times, 3), rtol=1e-9, atol=1e-9)


def test_mixed_motions_share_breaks_that_differ_by_rounding():
    rng = np.random.default_rng(3)
    own, other = np.array([0.0, 0.3, 0.6, 1.0]), np.array([0.0, 0.3 - 4e-17, 0.6 + 1e-15, 1.0])
    first, second = (
        Trajectory(times, rng.normal(size=(3, size, 2)), rng.normal(size=2), np.zeros(2))
        for times, size in ((own, 4), (other, 6))
    )
    mixed = first.mixed_with(second, 0.3)
    assert np.diff(mixed.times).min() > 0.1
    times = np.linspace(0.0, 1.0, 98)
    for order in range(4):
        wanted = 0.7 * first(times, order) + 0.3 * second(times, order)
        np.testing.assert_allclose(mixed(times, order), wanted, rtol=1e-9, atol=1e-9)


def test_short_steps_do_not_turn_rounding_into_jerk():
    times = np.array([0.0, 1e-3, 1e-3 + 5e-6, 2e-3])
    # Far from zero, as joints are.
    sine = [2.0 + np.sin(times), np.cos(times), -np.sin(times), -np.cos(times)]
    still = Trajectory([0.0, 2e-3], np.zeros((1, 1, 1)), np.zeros(1), np.zeros(1))
    motion = Trajectory.through(times, np.stack(sine)[:, :, None], still)
    dense = np.linspace(0.0, 2e-3, 8001)
    assert motion(dense, 0)[:, 0] == pytest.approx(2.0 + np.sin(dense), abs=1e-14)
    assert motion(dense, 3)[:, 0] == pytest.approx(-np.cos(dense), abs=1e-3)


def test_jump_at_a_sample_stays_local():
    times = np.array([0.0, 1e-2, 2e-2])
    # At rest, then with a constant jerk.
    later = times - 1e-2
    rates = [later**3 / 6.0, later**2 / 2.0, later, np.ones(3)]
    starts = np.stack([np.where(later < 0.0, 0.0, each) for each in rates])[:, :, None]
    ends = starts[:, 1:].copy()
    ends[3, 0] = 0.0
    still = Trajectory([0.0, 2e-2], np.zeros((1, 1, 1)), np.zeros(1), np.zeros(1))
    motion = Trajectory.through(times, starts, still, ends)
    dense = np.linspace(0.0, 2e-2, 401)
    assert motion(dense, 3)[:, 0] == pytest.approx(np.where(dense < 1e-2, 0.0, 1.0), abs=1e-9)
