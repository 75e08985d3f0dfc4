"""Joints that a model has never seen moving, and joints that move one a run."""

import numpy as np
import pinocchio
import pytest
from small_arms import PLANAR

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.extended.model import load_extended
from stiffopt.discovery.search.left_out_gain import select_predictive
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

RECORDINGS = """schema = 1
name = "planar"
robot = "robot.urdf"
joints = ["shoulder", "elbow"]
signals = { time = "t", position = ["q1", "q2"], torque = ["tau1", "tau2"], torque_side = "motor" }
"""
# Made from runs in which the elbow stood still.
MODEL = """schema = 1
kind = "extended"
name = "planar"
joints = ["shoulder", "elbow"]
links = ["upper", "fore"]
[nominal]
[scales]
torque_rated = [20.0, 20.0]
torque_max = [60.0, 60.0]
fastest = [2.0, 2.0]
[left_open]
cutoff = 12.0
predict = [20.0, 20.0]
torque = [0.1, 0.0]
link_position = [0.0, 0.0]
[[effect]]
name = "coulomb"
joint = 1
term = { dFc = 3.0 }
[[effect]]
name = "viscous"
joint = 1
term = { dFv = 1.0 }
"""
COULOMB, VISCOUS = (3.0, 2.5), (1.0, 0.8)


def recorded(folder, runs, extra="", offset=0.0):
    """A set whose joints rub; runs as (role, speeds of the joints)."""
    rng, t, text = np.random.default_rng(0), np.arange(0.0, 8.0, 0.01), RECORDINGS + extra
    (folder / "robot.urdf").write_text(PLANAR)
    model = pinocchio.buildModelFromUrdf(str(folder / "robot.urdf"))
    data = model.createData()
    for number, (role, speeds) in enumerate(runs):
        phase = np.outer(t, speeds)
        q = 0.7 * np.sin(phase) + 0.3 * np.sin(2.7 * phase + [0.0, 1.0])
        v, a = np.gradient(q, t, axis=0), np.gradient(np.gradient(q, t, axis=0), t, axis=0)
        tau = np.array([pinocchio.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])
        tau += np.tanh(v / 0.02) * COULOMB + v * VISCOUS + rng.normal(0.0, 0.1, q.shape)
        tau[:, 1] += offset
        columns = {"t": t, "q1": q[:, 0], "q2": q[:, 1], "tau1": tau[:, 0], "tau2": tau[:, 1]}
        np.savez(folder / f"r{number}.npz", **columns)
        text += f'[[runs]]\nfile = "r{number}.npz"\nrole = "{role}"\n'
    (folder / "recordings.toml").write_text(text)
    return folder


def test_friction_of_joint_unseen_by_model_is_found(tmp_path):
    runs = [("train", (1.0, 1.3)), ("train", (1.4, 1.1)), ("test", (1.2, 1.2))]
    folder = recorded(tmp_path, runs)
    (folder / "extended.toml").write_text(MODEL)
    found = diagnose(folder, model=folder / "extended.toml", experiment=False)
    said = {(f.effect.name, f.estimated.located.joint): f for f in found.findings}
    assert set(said) == {("coulomb", 1), ("viscous", 1)}
    values = [said[name, 1].parameters[0].value for name in ("coulomb", "viscous")]
    assert values == pytest.approx([COULOMB[1], VISCOUS[1]], rel=0.1)
    assert found.left_open.torque[1] > 0.0  # seen now


def test_open_residual_of_stationary_joint_is_kept(tmp_path):
    """Of the elbow, which these runs do not move, the next model knows what this one does."""
    folder = recorded(tmp_path, [("train", (1.0, 0.0)), ("test", (1.2, 0.0))])
    (folder / "extended.toml").write_text(MODEL.replace("[0.1, 0.0]", "[0.1, 0.3]"))
    found = diagnose(folder, model=folder / "extended.toml", experiment=False)
    assert found.left_open.torque[1] == pytest.approx(0.3)
    assert not found.findings


@pytest.mark.parametrize(("after_model", "cause"), [(True, "coulomb"), (False, "torque_offset")])
def test_effect_of_joint_moving_in_one_run_is_supported(tmp_path, after_model, cause):
    """Whole runs left out say nothing of it: in the others the joint stands."""
    runs = [("train", (1.0, 0.0))] * 5 + [("train", (0.0, 1.3)), ("test", (1.2, 1.2))]
    stated = "nominal = { coulomb = [3.0, 2.5], viscous = [1.0, 0.8] }\n"
    folder = recorded(tmp_path, runs, stated, offset=0.0 if after_model else 2.0)
    (folder / "extended.toml").write_text(MODEL.replace("[0.1, 0.0]", "[0.1, 0.1]"))
    recordings, model = load_recordings(folder), None
    if after_model:
        model = load_extended(folder / "extended.toml")
        recordings = model.applied_to(recordings)
    comparison = prepare_training(recordings, Settings(cutoff=12.0), model).comparison()
    there = LocatedEffect(effect=effect(cause), joint=1)
    load = LocatedEffect(effect=effect("load_friction"), joint=1, shapes=(0.02,))
    comparison = comparison.linearised_at(comparison.fit([there]))
    assert select_predictive(comparison, [load, there]) == [there]
