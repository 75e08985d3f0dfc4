"""Body torques on demand: cache and changed bodies."""

import numpy as np
import pytest
from swivel_sets import recorded, swivel_model

from stiffopt.discovery.comparison import nominal_robot
from stiffopt.discovery.comparison.nominal_robot import LazyArmSignals, RobotModel
from stiffopt.recording.recording_set import load_recordings

COUNT = 50


@pytest.fixture
def robot(tmp_path):
    folder = recorded(tmp_path, lambda q: 0.0 * q, swivel_model(1.0))
    return RobotModel(load_recordings(folder))


@pytest.fixture
def arms(robot):
    rng = np.random.default_rng(2)
    return [LazyArmSignals(robot, *rng.normal(0.0, 1.0, (3, COUNT, robot.n))) for _ in range(3)]


def test_body_torques_recently_used_stay_cached(robot, arms, monkeypatch):
    size = arms[0].body_regressor.of_part(0).nbytes
    monkeypatch.setattr(nominal_robot, "_TORQUE_CACHE_BYTES", 2 * size)
    first = arms[0].body_regressor.of_part(0)
    assert arms[0].body_regressor.of_part(0) is first
    for arm in arms:
        arm.body_regressor.of_part(0)
    assert [regressor for regressor, _ in robot.torque_cache] == [
        arm.body_regressor for arm in arms[1:]
    ]
    assert sum(each.nbytes for each in robot.torque_cache.values()) <= 2 * size
    np.testing.assert_array_equal(arms[0].body_regressor.of_part(0), first)


def test_body_torques_match_columns_of_full_regressor(robot, arms):
    regressor = arms[0].body_regressor
    whole = robot.body_regressor(*arms[0]._motion)
    assert whole.shape == (COUNT, robot.n, 10 * robot.n)
    for k in range(10 * robot.n):
        np.testing.assert_array_equal(regressor[..., k], whole[..., k])


def test_changed_body_torques_match_regressor_on_two_motions(robot, arms):
    change = np.random.default_rng(5).normal(0.0, 1.0, (robot.n, 10))
    there = [LazyArmSignals(robot, *arm._motion) for arm in arms]
    moved = arms[0].with_bodies(*arms[1]._motion)
    expected = robot.body_regressor(*arms[1]._motion) @ change.ravel()
    np.testing.assert_allclose(moved.body_regressor.torque(change), expected, atol=1e-12)
    # Tool and weight stay those of the motion before.
    np.testing.assert_array_equal(moved.tool_position, there[0].tool_position)
    np.testing.assert_array_equal(moved.weight, there[0].weight)
    few = arms[0].decimate(10)
    np.testing.assert_array_equal(few.tool_jacobian, there[0].tool_jacobian[::10])


def test_first_samples_are_those_of_the_whole_motion(robot, arms):
    few, change = arms[0].head(20), np.ones((robot.n, 10))
    np.testing.assert_array_equal(few.tool_position, arms[0].tool_position[:20])
    np.testing.assert_array_equal(few.zero_harmonics[..., 3], arms[0].zero_harmonics[..., 3][:20])
    np.testing.assert_array_equal(
        few.body_regressor.torque(change), arms[0].body_regressor.torque(change)[:20]
    )
