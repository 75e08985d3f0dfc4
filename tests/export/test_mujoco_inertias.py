"""MJCF export of inertias that violate the triangle inequality."""

from __future__ import annotations

import re

import numpy as np
import pytest
from small_arms import PLANAR

from stiffopt.export.model_format import MODEL_FORMATS, DiagnosedRobot
from stiffopt.robot.files import load_robot


@pytest.mark.parametrize(
    "moments",
    [
        (0.01, 0.02, 0.5),  # as of a URDF of a large arm: x and y together less than z
        (0.0, 0.0, 0.0),
        (0.2, 0.2, 0.2),
    ],
)
def test_mujoco_reads_raised_inertias(moments, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    values = dict(zip(("ixx", "iyy", "izz"), moments, strict=True))
    written = " ".join(f'{key}="{value}"' for key, value in values.items())
    inertia = f'<inertia {written} ixy="0" ixz="0" iyz="0"/>'
    *parts, last = re.split(r"<inertia [^>]*/>", PLANAR)
    (tmp_path / "arm.urdf").write_text(inertia.join([*parts, last]))
    arm = load_robot(tmp_path / "arm.urdf")
    found = DiagnosedRobot(
        name="arm",
        nominal=arm,
        robot=arm,
        gain=np.ones(arm.n),
        zeros=np.zeros(arm.n),
        stiffness=np.full(arm.n, np.nan),
        damping=np.full(arm.n, np.nan),
        changes=(),
        left_out=(),
    )
    mjcf = MODEL_FORMATS["mjcf"]
    model = mujoco.MjModel.from_xml_string(mjcf.text(found))
    said = mjcf.remarks(found)
    assert np.sort(model.body_inertia[2])[2] == pytest.approx(max(moments), abs=1e-8)
    if moments[0] == 0.2:
        assert said == []
        assert model.body_inertia[2] == pytest.approx(moments)
    else:
        assert len(said) == arm.n
        assert "belongs to no rigid body, which MuJoCo refuses" in said[0]
