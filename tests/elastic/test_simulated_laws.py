"""Laws of an extended model on the simulated elastic arm, against closed forms."""

from __future__ import annotations

import json

import numpy as np
import pytest
from elastic_arms import INERTIA, RATE, STIFFNESS, answer, arm, bang
from small_arms import write_problem

from stiffopt.cli import run
from stiffopt.elastic.simulate import simulate
from stiffopt.robot.added_torque import AddedTorque

HALF, ACCELERATION = 0.0973, 40.0


def deflection(time, rate):
    """Wind-up under the inertia of the link with motors that accelerate, then brake [rad]."""
    since = [answer(time - t, rate, 0.0) for t in (0.0, HALF, 2 * HALF)]
    return ACCELERATION / rate**2 * (since[0] - 2.0 * since[1] + since[2])


def swivel_with(folder, value, *, in_spring=True):
    law = AddedTorque(joint=0, in_spring=in_spring, value=value, label="law of joint 1")
    return arm(folder, damping=np.zeros(1), added_torques=(law,))


def test_a_torque_by_the_motors_acceleration_and_a_constant_one(tmp_path):
    constant, inertia = 12.0, 0.3 * INERTIA
    swivel = swivel_with(tmp_path, lambda s: constant + inertia * s.acceleration[0])
    found = simulate(swivel, bang([ACCELERATION], HALF, [0.0]))
    expected = constant / STIFFNESS + 1.3 * deflection(found.time, RATE)
    np.testing.assert_allclose(found.windup[:, 0], expected, atol=2e-7)
    # The constant one is calibrated away at rest.
    assert found.distance[0] < 1e-9
    assert any("law of joint 1" in note for note in found.notes)


def test_a_torque_by_the_load_is_felt_as_inertia(tmp_path):
    share = 0.08
    swivel = swivel_with(tmp_path, lambda s: share * s.load[0])
    found = simulate(swivel, bang([ACCELERATION], HALF, [0.0]))
    expected = deflection(found.time, RATE / np.sqrt(1.0 + share))
    np.testing.assert_allclose(found.windup[:, 0], expected, atol=5e-7)


def test_a_torque_of_the_drive_does_not_move_the_link(tmp_path):
    swivel = swivel_with(tmp_path, lambda s: 30.0 + 0.0 * s.velocity[0], in_spring=False)
    found = simulate(swivel, bang([ACCELERATION], HALF, [0.0]))
    np.testing.assert_allclose(found.windup[:, 0], deflection(found.time, RATE), atol=2e-7)
    assert any("Without influence" in note and "law of joint 1" in note for note in found.notes)


EXTENDED = """schema = 1
kind = "extended"
name = "cell"
joints = ["shoulder", "elbow"]
links = ["upper", "fore"]
[scales]
torque_rated = [40.0, 40.0]
torque_max = [120.0, 120.0]
fastest = [2.0, 2.0]
[[effect]]
name = "hose"
joint = 2
law = { place = "link_torque", factors = [{ signal = "acceleration", form = "linear", joint = 2 }] }
term = { A = 0.02 }
"""


@pytest.mark.slow
def test_a_solved_motion_is_simulated_on_the_arm_with_the_laws_of_a_diagnosis(tmp_path, capsys):
    path = write_problem(tmp_path, minimise='objective = "dynamic_deflection"')
    model = tmp_path / "extended.toml"
    model.write_text(EXTENDED)
    plain, extended = str(tmp_path / "plain"), str(tmp_path / "extended")
    assert run(["solve", str(path), "--out", plain, "--quiet"]) == 0
    assert run(["solve", str(path), "--model", str(model), "--out", extended, "--quiet"]) == 0
    peaks = []
    for source, options in ((plain, []), (plain, ["--model", str(model)]), (extended, [])):
        out = tmp_path / f"simulated_{len(peaks)}"
        assert run(["simulate", source, "--out", str(out), *options]) == 0
        document = json.loads((out / "simulation.json").read_text())
        peaks.append(document["motions"]["optimised"]["in_flight"]["peak"])
    assert peaks[1] > 1.02 * peaks[0]
    assert peaks[2] < peaks[1]
    capsys.readouterr()
    assert run(["simulate", extended, "--model", str(model)]) == 2
    assert "planned with" in capsys.readouterr().err
