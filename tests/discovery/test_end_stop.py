"""A joint that runs against something since its model was made."""

import numpy as np
import pytest
from small_arms import SWIVEL

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.soundness import sample_signals

RECORDINGS = """schema = 1
name = "swivel"
robot = "robot.urdf"
joints = ["swivel"]
signals = { time = "t", position = ["q"], torque = ["tau"], torque_side = "motor" }
"""
MODEL = """schema = 1
kind = "extended"
name = "swivel"
joints = ["swivel"]
links = ["upper"]
[nominal]
[scales]
torque_rated = [20.0]
torque_max = [60.0]
fastest = [1.5]
[left_open]
cutoff = 12.0
predict = [20.0]
torque = [0.2]
link_position = [0.0]
[[effect]]
name = "coulomb"
joint = 1
term = { dFc = 5.0 }
[[effect]]
name = "viscous"
joint = 1
term = { dFv = 3.0 }
"""
STIFFNESS, PLACE = 40.0, 0.6


def stopped(folder, side):
    """Runs against a stop at one end of the stroke."""
    rng, t, text = np.random.default_rng(0), np.arange(0.0, 8.0, 0.01), RECORDINGS
    for name, role, rate in (("a", "train", 1.0), ("b", "train", 1.4), ("c", "test", 1.2)):
        q = 0.8 * np.sin(rate * t) + 0.3 * np.sin(3.1 * rate * t)
        v = np.gradient(q, t)
        tau = 0.09 * np.gradient(v, t) + 5.0 * np.tanh(v / 0.02) + 3.0 * v
        tau += STIFFNESS * side * np.maximum(side * q - PLACE, 0.0)
        np.savez(folder / f"{name}.npz", t=t, q=q, tau=tau + rng.normal(0.0, 0.1, t.size))
        text += f'[[runs]]\nfile = "{name}.npz"\nrole = "{role}"\n'
    (folder / "robot.urdf").write_text(SWIVEL)
    (folder / "recordings.toml").write_text(text)
    (folder / "extended.toml").write_text(MODEL)
    return folder


@pytest.mark.parametrize("side", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_a_stop_is_named_with_its_place(tmp_path, side):
    folder = stopped(tmp_path, side)
    found = diagnose(folder, model=folder / "extended.toml", experiment=False)
    assert [f.effect.name for f in found.findings] == ["end_stop"]
    values = {p.name: p.value for p in found.findings[0].parameters}
    assert values == pytest.approx({"k": STIFFNESS, "q0": side * PLACE}, rel=0.03)


@pytest.mark.slow
def test_without_a_model_a_form_so_free_is_not_asked_for(tmp_path):
    found = diagnose(stopped(tmp_path, 1.0), experiment=False)
    assert "end_stop" not in {f.effect.name for f in found.findings}
    assert "end_stop" not in {limit.effect.name for limit in found.detection_limits}


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_stop_presses_inwards_beyond_its_angle_alone(side):
    signals = sample_signals().of_joint(4)
    q0 = float(np.mean(signals.constants.stroke))
    torque = effect("end_stop").term(signals, [200.0], [q0, side]).link_torque
    beyond = side * (signals.link_position - q0)
    np.testing.assert_allclose(
        torque, 200.0 * side * np.maximum(beyond, 0.0), atol=200.0 * 2e-3 * np.log(2.0) * 1.01
    )
