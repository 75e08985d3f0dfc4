"""Modes against closed forms, and descriptions of their shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from elastic_arms import INERTIA, RATE, STIFFNESS, arm
from small_arms import CONSTANT, joint, write_robot

from stiffopt.cli import run
from stiffopt.elastic.arm import ElasticArm, questionable_springs
from stiffopt.elastic.modes import Mode, modes
from stiffopt.errors import NotSimulatedError, RobotError
from stiffopt.robot.files import load_robot


def test_one_joint_mode_is_that_of_a_mass_on_a_spring(tmp_path):
    (mode,) = modes(arm(tmp_path), np.zeros(1))
    assert mode.frequency == pytest.approx(RATE / (2.0 * np.pi))
    assert mode.describe() == "joint 1 (100 % of the energy)"
    # Of unit modal mass, about the vertical: along y with the arm along x.
    np.testing.assert_allclose(np.abs(mode.tool), [0.0, 0.4 / np.sqrt(0.09), 0.0], atol=1e-9)


@pytest.mark.parametrize("angle", [-1.2, 0.3, 1.4])
def test_weight_changes_the_frequency_of_a_pendulum_on_a_spring(tmp_path, angle):
    pendulum = arm(tmp_path, "pendulum", at=[angle])
    (mode,) = modes(pendulum, np.array([angle]))
    (q,) = pendulum.static_equilibrium(np.array([[angle]]))[0]
    # Turning about y lowers the tip: the weight's torque is -m g l cos(q).
    torque = -2.0 * 9.81 * 0.2 * np.cos(q)
    assert pendulum.static_torque(np.array([q]))[0] == pytest.approx(torque)
    stiffness = pendulum.stiffness(np.array([torque]))[0] + 2.0 * 9.81 * 0.2 * np.sin(q)
    assert mode.frequency == pytest.approx(np.sqrt(stiffness / 0.09) / (2.0 * np.pi), rel=1e-7)


def test_two_joint_modes_keep_the_trace_and_are_orthogonal(tmp_path):
    planar = arm(tmp_path, "planar")
    found = modes(planar, np.array([0.3, 0.2]))
    assert [mode.frequency for mode in found] == sorted(mode.frequency for mode in found)
    q = planar.static_equilibrium(np.array([[0.3, 0.2]]))[0]
    inertia = planar.bodies.inertia_matrix(q)
    shapes = np.stack([mode.shape for mode in found])
    np.testing.assert_allclose(shapes @ inertia @ shapes.T, np.eye(2), atol=1e-10)
    for mode in found:
        assert mode.shares.sum() == pytest.approx(1.0)


def test_mode_shapes_are_described():
    mode = Mode(9.0, 0.02, np.array([0.05, 0.6, 0.35]), np.array([0.1, 1.0, -2.0]), np.zeros(3))
    assert mode.describe() == "joint 2 (60 % of the energy) against joint 3 (35 %)"


def test_springs_too_soft_for_the_weight_are_refused(tmp_path):
    pendulum = arm(tmp_path, "pendulum", at=[-1.5])
    pendulum.robot.model.inertias[1].mass = 5e4
    heavy = replace(pendulum.robot)
    with pytest.raises(RobotError, match="springs"):
        modes(type(pendulum)(heavy, np.array([-1.5])), np.array([-1.5]))


def test_implausibly_soft_springs_are_named(tmp_path, capsys):
    right = write_robot(tmp_path, "swivel")
    assert questionable_springs(load_robot(right), np.zeros(1)) == ""
    # As given in N m/arcmin, read as N m/rad.
    wrong = STIFFNESS * np.pi / (180.0 * 60.0)
    path = write_robot(tmp_path, "swivel", [joint("swivel", CONSTANT.format(stiffness=wrong))])
    sentence = questionable_springs(load_robot(path), np.zeros(1))
    frequency = np.sqrt(wrong / INERTIA) / (2.0 * np.pi)
    assert f"swivel alone would vibrate at {frequency:.2g} Hz with {wrong:.3g} N m/rad;" in sentence
    assert run(["modes", str(path), "--at", "0"]) == 0
    assert "1 N m/arcmin is 3438 N m/rad" in " ".join(capsys.readouterr().out.split())


def test_arm_without_equilibrium_names_its_softest_joint(tmp_path):
    soft = joint("shoulder", CONSTANT.format(stiffness=1.0))
    robot = load_robot(write_robot(tmp_path, "pendulum", [soft]))
    with pytest.raises(
        NotSimulatedError, match=r"hang .* shoulder alone would vibrate at 0\.\d+ Hz"
    ):
        ElasticArm(robot, np.zeros(1))
