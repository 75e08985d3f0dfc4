"""From an MJCF and a log by way of a diagnosis to the same MJCF with the true values."""

from __future__ import annotations

import numpy as np
import pytest
from mjcf_models import write_legs

from stiffopt.cli import run
from stiffopt.robot.mjcf import read_mjcf

mujoco = pytest.importorskip("mujoco")

JOINTS = ("hip_l", "thigh_l", "calf_l")
NOMINAL, TRUE = (0.2, 0.2, 0.1), (0.2, 0.35, 0.1)


def write_log(path, model, friction):
    """Write torques of MuJoCo's inverse dynamics with this dry friction and noise, as CSV."""
    compiled = mujoco.MjModel.from_xml_path(str(model))
    compiled.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, rng = mujoco.MjData(compiled), np.random.default_rng(3)
    time = np.arange(0.0, 20.0, 0.005)
    rate, phase = rng.uniform(0.8, 5.0, (2, 3, 4))
    size = 0.5 / rate
    rows = []
    for t in time:
        angle = rate * t + phase
        q, v, a = (
            (size * rate**k * wave(angle)).sum(axis=1)
            for k, wave in enumerate((np.sin, np.cos, lambda x: -np.sin(x)))
        )
        for k, name in enumerate(JOINTS):
            joint = compiled.joint(name)
            data.qpos[joint.qposadr], data.qvel[joint.dofadr] = q[k], v[k]
            data.qacc[joint.dofadr] = a[k]
        mujoco.mj_inverse(compiled, data)
        torque = [data.qfrc_inverse[compiled.joint(name).dofadr[0]] for name in JOINTS]
        rows.append([t, *q, *(torque + friction * np.sign(v) + 0.005 * rng.normal(size=3))])
    head = ["time", *(f"{kind}_{name}" for kind in ("q", "tau") for name in JOINTS)]
    np.savetxt(path, rows, delimiter=",", header=",".join(head), comments="")


@pytest.mark.slow
def test_grown_friction_comes_back_in_the_users_file(tmp_path):
    model = write_legs(tmp_path)
    text = model.read_text()
    for name, value in zip(JOINTS, NOMINAL, strict=True):
        joint = f'<joint name="{name}"'
        text = text.replace(joint, f'{joint} armature="0.02" damping="0.1" frictionloss="{value}"')
    model.write_text(f"<!-- mine -->\n{text}")
    write_log(tmp_path / "log.csv", model, np.array(TRUE))
    made, out = tmp_path / "set", tmp_path / "out"
    start = ["init", "recording", str(tmp_path / "log.csv"), "--urdf", str(model)]
    assert run([*start, "--tip", "calf_l", "--out", str(made)]) == 0
    assert run(["diagnose", str(made), "--out", str(out), "--quiet", "--no-experiment"]) == 0
    assert run(["export", str(out), "--to", "mjcf", "--recordings", str(made)]) == 0
    written = out / "legs.xml"
    assert written.read_text().startswith("<!-- mine -->\n<mujoco>")
    joints = read_mjcf(written).joints
    found = [joints[name].frictionloss for name in JOINTS]
    assert found == pytest.approx(TRUE, rel=0.05)
    assert joints["hip_r"].frictionloss == 0.0
    assert [joints[name].armature for name in JOINTS] == pytest.approx([0.02] * 3, rel=0.1)
