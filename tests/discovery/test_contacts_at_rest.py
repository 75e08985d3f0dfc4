"""A stationary joint that carries more than weight and friction hold is remarked."""

from types import SimpleNamespace

import numpy as np
import pytest
from simulated_sets import short_case, simulated

from benchmarks.simulator import write_case
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.sensor_doubts import doubt_contacts_at_rest
from stiffopt.recording.recording_set import load_recordings

TIME = np.arange(0.0, 6.0, 0.004)
# Moves for two seconds, stands for four.
PHASE = np.minimum(TIME, 2.0) * np.pi
ANGLE, SPEED = 0.3 * (1.0 - np.cos(PHASE)), 0.3 * np.pi * np.sin(PHASE) * (TIME < 2.0)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    case = simulated(short_case(seed=73, robot="small3", train=2, link_encoders=False))
    return RobotModel(load_recordings(write_case(case, tmp_path_factory.mktemp("rest") / "set")))


def run_with(robot, added):
    """A run in which all joints move and stand; `added` (K,) is carried by the second one."""
    q, v = np.tile(ANGLE[:, None], (1, 3)), np.tile(SPEED[:, None], (1, 3))
    a = np.gradient(v, 0.004, axis=0)
    torque = robot.spring_torque(q, v, a) + robot.rotor_inertia * a + robot.friction(v)
    torque[:, 1] += added
    return SimpleNamespace(
        name="r1", usable=True, time=TIME, step=0.004, position=q, link_position=None, torque=torque
    )


def test_load_at_rest_is_remarked_with_joint_and_time(robot):
    push = 4.0 * robot.coulomb[1] * ((TIME > 3.0) & (TIME < 4.0))
    (doubt,) = doubt_contacts_at_rest(robot, [run_with(robot, push)])
    assert doubt.joints == (2,)
    assert doubt.evidence.startswith("In r1, 3.0")


def test_friction_at_rest_is_no_contact(robot):
    held = 1.3 * robot.coulomb[1] * (TIME > 3.0)
    assert not list(doubt_contacts_at_rest(robot, [run_with(robot, held)]))


def test_load_during_all_rest_is_left_to_the_diagnosis(robot):
    payload = 4.0 * robot.coulomb[1] * np.ones(len(TIME))
    assert not list(doubt_contacts_at_rest(robot, [run_with(robot, payload)]))
