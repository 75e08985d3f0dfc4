"""Diagnosed robots as URDF and MJCF: read back, and simulated in MuJoCo."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from diagnosed_two_link import TWO_LINK, diagnosed

from stiffopt.cli import run
from stiffopt.discovery.extended.value_changes import value_changes
from stiffopt.export.model_format import MODEL_FORMATS, DiagnosedRobot, read_diagnosed_robot
from stiffopt.robot.files import load_robot

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found() -> DiagnosedRobot:
    return read_diagnosed_robot(diagnosed(), TWO_LINK)


def held_out() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times of the test run, its motion smoothed, and two derivatives (K, 2)."""
    from scipy.signal import savgol_filter

    run_ = np.load(TWO_LINK / "test_1.npz")
    time, recorded = run_["t"], np.stack([run_["q1"], run_["q2"]], axis=1)
    step = float(np.median(np.diff(time)))
    motion = [savgol_filter(recorded, 21, 4, deriv=k, delta=step, axis=0) for k in range(3)]
    return time, *motion


def predicted(found: DiagnosedRobot, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Drive torque of the found robot (K, n) [N m]."""
    robot, bodies = found.robot, found.robot.rigid_bodies()
    rigid = np.array([bodies.torque(*each) for each in zip(q, v, a, strict=True)])
    return rigid + robot.rotor_inertia * a + robot.coulomb * np.sign(v) + robot.viscous * v


def rollout(
    model_file: Path, time: np.ndarray, motion: np.ndarray, torque: np.ndarray
) -> np.ndarray:
    """Torques (K, n) that make the model follow a motion: those predicted, and a loop's rest."""
    import mujoco
    from scipy.interpolate import CubicSpline

    model = mujoco.MjModel.from_xml_path(str(model_file))
    data = mujoco.MjData(model)
    n = model.nv
    reference = CubicSpline(time, np.hstack([motion[0], motion[1]]))
    data.qpos[:], data.qvel[:] = motion[0][0], motion[1][0]
    applied = []
    for now in np.arange(time[0], time[-1], model.opt.timestep):
        wanted = reference(now)
        ahead = np.array([np.interp(now, time, torque[:, j]) for j in range(n)])
        loop = 4e3 * (wanted[:n] - data.qpos) + 120.0 * (wanted[n:] - data.qvel)
        data.ctrl[:] = (ahead + loop) / model.actuator_gear[:, 0]
        applied.append(data.ctrl * model.actuator_gear[:, 0])
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos, motion[0][-1], atol=2e-3)
    at = np.arange(time[0], time[-1], model.opt.timestep)
    return np.stack([np.interp(time, at, each) for each in np.array(applied).T], axis=1)


def test_mujoco_torque_on_a_held_out_motion_equals_the_prediction(found, tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "found.xml").write_text(MODEL_FORMATS["mjcf"].text(found))
    time, *motion = held_out()
    torque = predicted(found, *motion)
    applied = rollout(tmp_path / "found.xml", time, np.array(motion), torque)
    inside = slice(21, -21)
    error = np.sqrt(np.mean((applied - torque)[inside] ** 2, axis=0))
    size = np.sqrt(np.mean(torque[inside] ** 2, axis=0))
    assert (error / size < 0.02).all(), error / size


def test_mujoco_torque_equals_that_of_the_diagnosis(found, tmp_path):
    """Where a joint moves: at rest dry friction holds with any torque within it."""
    pytest.importorskip("mujoco")
    (tmp_path / "found.xml").write_text(MODEL_FORMATS["mjcf"].text(found))
    time, *motion = held_out()
    applied = rollout(tmp_path / "found.xml", time, np.array(motion), predicted(found, *motion))
    stored = np.load(diagnosed() / "pred_after_test_1.npz")
    for j in range(2):
        written = np.interp(time, stored["t"], stored[f"tau{j + 1}"])
        moves = np.abs(motion[1][:, j]) > 0.05
        moves[:21] = moves[-21:] = False
        assert moves.mean() > 0.6
        error = np.sqrt(np.mean((applied[:, j] - written)[moves] ** 2))
        assert error < 0.02 * np.sqrt(np.mean(written[moves] ** 2)), j


def test_mujoco_torque_of_the_nominal_robot_differs(found, tmp_path):
    pytest.importorskip("mujoco")
    from dataclasses import replace

    nominal = replace(found, robot=found.nominal)
    (tmp_path / "nominal.xml").write_text(MODEL_FORMATS["mjcf"].text(nominal))
    time, *motion = held_out()
    torque = predicted(found, *motion)
    applied = rollout(tmp_path / "nominal.xml", time, np.array(motion), torque)
    error = np.sqrt(np.mean((applied - torque)[21:-21, 1] ** 2))
    # The dry friction of joint 2 that was found is missing.
    assert error > 0.05 * np.sqrt(np.mean(torque[21:-21, 1] ** 2))


def test_urdf_read_back_is_the_diagnosed_robot(found, tmp_path):
    heavier = found.robot.tree.bodies[1].inertial_parameters * 1.25
    from dataclasses import replace

    changed = replace(found, robot=found.robot.with_inertial_parameters(2, heavier))
    path = tmp_path / "found.urdf"
    path.write_text(MODEL_FORMATS["urdf"].text(changed))
    back = load_robot(path)
    # A URDF has no place for rotor inertia.
    left = [
        c for c in value_changes(back, changed.robot, np.arange(2)) if c.quantity != "rotor inertia"
    ]
    assert left == []
    np.testing.assert_allclose(
        back.rigid_bodies().torque(np.array([0.3, -0.5]), np.ones(2), np.ones(2)),
        changed.robot.rigid_bodies().torque(np.array([0.3, -0.5]), np.ones(2), np.ones(2)),
        rtol=1e-9,
    )
    names = [joint.get("name") for joint in ET.parse(path).getroot().findall("joint")]
    original = ET.parse(found.nominal.urdf).getroot()
    assert names == [joint.get("name") for joint in original.findall("joint")]


def test_changes_are_printed_and_head_the_report(tmp_path, capsys):
    out = diagnosed()
    arguments = ["export", str(out), "--recordings", str(TWO_LINK), "--out", str(tmp_path)]
    assert run([*arguments, "--to", "urdf"]) == 0
    assert "Coulomb friction of joint2: 1.7 -> 2.3" in capsys.readouterr().out
    page = (out / "report.html").read_text(encoding="utf-8")
    text = page.replace("\N{NO-BREAK SPACE}", " ")
    assert "Changed values" in text
    assert '1.7 N m</td><td data-label="to">2.3' in text


def test_robot_export_without_a_set_is_refused(capsys):
    assert run(["export", str(diagnosed()), "--to", "mjcf"]) == 2
    assert "--recordings" in capsys.readouterr().err
