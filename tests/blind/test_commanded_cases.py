"""Sealed arms that follow commands: drawn from the key, simulated by MuJoCo, scored."""

import json
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from benchmarks.blind import commanded
from benchmarks.blind.key import Key
from benchmarks.blind.store import Store, write_json
from benchmarks.simulator import commanded_case
from benchmarks.simulator.commanded_arms import ARMS
from benchmarks.simulator.commanded_effects import COMMANDED_EFFECTS, Healthy
from benchmarks.simulator.commanded_world import TIMESTEP, nominal_world, simulate

ROOT = Path(__file__).resolve().parents[2]
KEY = Key("dev-test", "0" * 40)
LEG = ARMS["leg"]


def test_what_makes_commanded_cases_does_not_know_the_tool():
    code = (
        "import sys; import benchmarks.simulator.commanded_case;"
        "print([m for m in sys.modules if m.split('.')[0] == 'stiffopt'])"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert run.stdout.strip() == "[]"


def test_every_effect_and_arm_has_its_turn():
    specs = [commanded.spec_of(KEY, "commanded", i) for i in range(45)]
    assert {spec.effect for spec in specs} == set(COMMANDED_EFFECTS)
    assert {spec.arm for spec in specs} == set(ARMS)
    assert specs[7] == commanded.spec_of(KEY, "commanded", 7)
    assert not any(commanded.spec_of(KEY, "idle", i).effect for i in range(3))


def test_a_held_arm_sags_by_its_weight_over_the_gain():
    world = nominal_world(LEG, 0.0)
    # Friction holds an arm anywhere near: none here.
    world.coulomb, world.viscous = np.zeros(3), 5.0 * world.viscous
    command = np.tile([0.0, 0.7, -0.4], (round(3.0 / TIMESTEP), 1))
    q = simulate(world, command)[0][-1]
    levers = np.array(LEG.lengths)
    knee = LEG.masses[2] * 9.81 * 0.5 * levers[2] * np.sin(q[1] + q[2])
    hip = knee + 9.81 * levers[1] * (0.5 * LEG.masses[1] + LEG.masses[2]) * np.sin(q[1])
    sag = np.array([knee, hip]) / np.array(LEG.kp)[[2, 1]]
    np.testing.assert_allclose((command[-1] - q)[[2, 1]], sag, rtol=1e-3)


@pytest.mark.parametrize("effect", COMMANDED_EFFECTS)
def test_every_effect_moves_the_arm_and_tells_its_parameters(effect):
    time = np.arange(round(0.6 / TIMESTEP)) * TIMESTEP
    command = 0.4 + 0.3 * np.sin(2.0 * np.pi * np.outer(time, [1.5, 2.0, 1.7]))
    healthy, torque = simulate(nominal_world(LEG, 0.004), command)
    about = Healthy(np.abs(torque).max(0), healthy.min(0), healthy.max(0), np.array([-0.5, -0.3]))
    world = nominal_world(LEG, 0.004)
    params = COMMANDED_EFFECTS[effect].act(world, 1, 2.0, np.random.default_rng(0), about)
    moved = np.abs(simulate(world, command)[0] - healthy).max()
    assert 1e-3 < moved < 0.5
    assert params


@pytest.fixture(name="case", scope="module")
def answered_case(tmp_path_factory):
    """Sealed case with viscous friction, and a way to answer it."""
    patch = pytest.MonkeyPatch()
    patch.setattr(commanded_case, "_SECONDS", 0.5)
    store = Store(tmp_path_factory.mktemp("store"))
    spec = commanded_case.CommandedSpec(
        name="commanded_0000", arm="leg", effect="viscous", size=1.7, gains_stated=True, seed=5
    )
    commanded.make(spec, store)
    patch.undo()
    return store, json.loads(store.truth(spec.name).read_text())


def test_a_case_is_sealed_and_tells_nothing_of_its_effect(case):
    store, truth = case
    folder = store.case(truth["id"])
    sealed = sha256(store.truth(truth["id"]).read_bytes()).hexdigest()
    assert (folder / "commitment.txt").read_text().strip() == sealed
    text = (folder / "recordings.toml").read_text()
    assert str(truth["params"]["dFv"]) not in text
    assert sorted(each.name for each in folder.glob("*.npz"))[0] == "run0.npz"


def answer_case(store, truth, effect, joint, gain=1.0):
    folder = store.answer(truth["id"])
    folder.mkdir(parents=True, exist_ok=True)
    sized = {"value": 1.01 * truth["params"]["dFv"], "sd": 0.01 * truth["params"]["dFv"]}
    finding = {"effect": effect, "joint": joint, "certainty": "found", "parameters": {"dFv": sized}}
    position = {"rms_before": [3e-3] * 3, "rms_after": [1e-3] * 3}
    write_json(folder / "diagnosis.json", {"findings": [finding], "positions": [position]})
    names = ("gain", "damping", *commanded.FITTED)
    zeros = {name: [0.0] * 3 for name in names}
    values = zeros | {name: truth[name] for name in commanded.FITTED} | {"delay": [0.0]}
    loop = {"stiffness": [gain * each for each in truth["kp"]], "damping": truth["kd"]}
    deviations = {name: [0.1] * 3 for name in names} | {"delay": [1.0]}
    lines = ["[closed_loop]", *(f"{key} = {value}" for key, value in loop.items())]
    lines += ["[closed_loop.values]", *(f"{key} = {value}" for key, value in values.items())]
    lines += ["[closed_loop.deviations]"]
    lines += [f"{key} = {value}" for key, value in deviations.items()]
    (folder / "extended.toml").write_text("\n".join(lines) + "\n")
    write_json(folder / "time.json", {"status": "ok", "cpu": 10.0})
    return commanded.score(store, truth["id"])


def test_a_right_answer_is_counted_right(case):
    store, truth = case
    scored = answer_case(store, truth, "viscous", truth["joint"], gain=1.01)
    assert scored.right
    assert scored.joint_right
    assert scored.false == 0
    np.testing.assert_allclose(scored.gain_errors, 0.01)
    assert scored.covered["finding"] == [True]
    assert scored.after == pytest.approx(1e-3)
    assert "| effect and joint first | 1 of 1" in commanded.page([scored], KEY)


def test_a_wrong_answer_is_counted_wrong(case):
    store, truth = case
    scored = answer_case(store, truth, "coulomb", truth["joint"])
    assert not scored.right
    assert scored.false == 1
    other = answer_case(store, truth, "viscous", truth["joint"] % 3 + 1)
    assert other.right
    assert not other.joint_right
