"""Small elastic arms, and motions with closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from small_arms import CONSTANT, joint, write_robot

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.result.trajectory import Trajectory
from stiffopt.robot.files import load_robot

# Swivel: spring [N m/rad] and inertia of its link about the joint [kg m^2].
STIFFNESS = 1e4
INERTIA = 1e-2 + 2.0 * 0.2**2
RATE = float(np.sqrt(STIFFNESS / INERTIA))
LENGTH = 0.4


def arm(folder, name="swivel", at=None, process_force=(0.0, 0.0, 0.0), **numbers):
    """Elastic arm of a small robot, with fields of the robot replaced."""
    robot = replace(load_robot(write_robot(folder, name)), **numbers)
    return ElasticArm(robot, np.zeros(robot.n) if at is None else np.array(at), process_force)


def one_soft_joint(folder, **numbers):
    """The planar arm with a spring at the shoulder and a rigid elbow."""
    joints = [joint("shoulder", CONSTANT.format(stiffness=STIFFNESS)), joint("elbow", "")]
    robot = load_robot(write_robot(folder, "planar", joints=joints))
    return ElasticArm(replace(robot, **numbers), np.zeros(2))


def there_and_stop(acceleration, half, start):
    """Motion of constant acceleration, then as much deceleration, for `half` seconds each."""
    steps = np.array([[acceleration], [-np.asarray(acceleration)]], dtype=float)
    return Trajectory.from_acceleration(
        [0.0, half, 2 * half], steps, start, np.zeros(len(acceleration))
    )


def bang(acceleration, half, start):
    """`there_and_stop` as a motor motion."""
    return MotorMotion.of(there_and_stop(acceleration, half, start))


def answer(t, rate, damping):
    """Deflection of a mass on a unit-stiffness spring after a unit step of force at time 0."""
    t = np.maximum(t, 0.0)
    damped = rate * np.sqrt(1.0 - damping**2)
    ratio = damping * rate / damped
    return 1.0 - np.exp(-damping * rate * t) * (np.cos(damped * t) + ratio * np.sin(damped * t))
