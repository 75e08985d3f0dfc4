"""Two states of one robot: what changed is named, what both share is not, and mistakes are told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from stiffopt import diagnose_change
from stiffopt.cli import run
from stiffopt.discovery.answer import action
from stiffopt.discovery.catalogue.drift import friction_drift
from stiffopt.discovery.extended.model import load_extended
from stiffopt.discovery.store import answer_document, write_diagnosis
from stiffopt.discovery.user_effects import sample_signals
from stiffopt.errors import InputFileError
from stiffopt.recording.state_pair import load_state_pair
from stiffopt.report.diagnosis.changes import change_headline, change_verdict
from stiffopt.report.diagnosis.page import write_diagnosis_report
from tests.discovery.own_machines import SCARA, Machine

# An upright arm with gravity on two joints; masses and lengths of no product.
UPRIGHT = Machine(
    name="upright",
    urdf=SCARA.urdf.replace('name="scara"', 'name="upright"').replace(
        '<axis xyz="0 0 1"/>', '<axis xyz="0 1 0"/>'
    ),
    joints=SCARA.joints,
    middle=SCARA.middle,
    swing=(0.8, 1.0, 1.5),
    coulomb=(4.0, 2.2, 0.5),
    viscous=(2.5, 1.2, 0.2),
    noise=(0.4, 0.2, 0.05),
)
MACHINES = (SCARA, UPRIGHT)
SCARA_CONSTANTS = sample_signals().constants.joints[0]


def _write_state(
    machine: Machine,
    folder: Path,
    seed: int,
    coulomb: tuple[float, ...] = (),
    payload: float = 0.0,
    drift: float = 0.0,
) -> Path:
    """Write a set with the machine's nominal model; `coulomb` and `payload` [kg] are the truth.

    Dry friction differs between runs by the relative standard deviation `drift`.
    """
    own = np.array(coulomb or machine.coulomb)
    model = pin.buildModelFromXML(machine.urdf)
    # Both states have masses that the nominal model does not: 1 % more in the second body.
    model.inertias[2].mass *= 1.01
    if payload:
        last = model.inertias[model.njoints - 1]
        extra = pin.Inertia(payload, last.lever, 1e-3 * payload * np.eye(3))
        model.inertias[model.njoints - 1] = last + extra
    rng = np.random.default_rng(seed)

    def record(logs: list) -> None:
        for number in range(len(logs)):
            level = own * (1.0 + drift * rng.normal(size=len(own))) if drift else own
            logs[number] = replace(machine, coulomb=tuple(level))._log(model, rng)

    return machine.write(folder, record)


@pytest.mark.parametrize("machine", MACHINES, ids=lambda each: each.name)
def test_friction_of_one_joint_is_the_change(machine, tmp_path):
    harder = (machine.coulomb[0], 1.3 * machine.coulomb[1], machine.coulomb[2])
    before = _write_state(machine, tmp_path / "before", 11)
    after = _write_state(machine, tmp_path / "after", 12, coulomb=harder)
    found = diagnose_change(before, after, experiment=False)
    (change,) = found.changes
    assert (change.effect.name, change.joint) == ("coulomb", 2)
    assert change.probability > 0.9
    (value,) = change.parameters
    assert value.value == pytest.approx(0.3 * machine.coulomb[1], abs=4.0 * value.sd)
    assert value.sd < 0.1 * value.value
    assert found.nrmse("test")[1] < 1.2
    assert change_headline(found).startswith("Joint 2 changed: 0.")


def test_payload_of_a_new_gripper_is_the_change(tmp_path):
    before = _write_state(UPRIGHT, tmp_path / "before", 21)
    after = _write_state(UPRIGHT, tmp_path / "after", 22, payload=0.6)
    found = diagnose_change(before, after, experiment=False)
    (change,) = found.changes
    assert change.effect.family == "inertial"
    mass = next(p for p in change.parameters if p.name == "dm")
    assert mass.value == pytest.approx(0.6, abs=max(4.0 * mass.sd, 0.06))
    assert {p.name for p in change.parameters} >= {"dm"}


def test_heavy_load_is_the_change_and_its_remedy_comes_first(tmp_path):
    """Runs of the states do not fit each other, and both lack more friction than the load adds."""
    own = tuple(3.0 * each for each in UPRIGHT.coulomb)
    before = _write_state(UPRIGHT, tmp_path / "before", 23, coulomb=own)
    after = _write_state(UPRIGHT, tmp_path / "after", 24, coulomb=own, payload=4.0)
    found = diagnose_change(before, after, experiment=False)
    (change,) = found.changes
    assert change.effect.family == "inertial"
    mass = next(p for p in change.parameters if p.name == "dm")
    assert mass.value == pytest.approx(4.0, abs=max(4.0 * mass.sd, 0.1))
    assert change.probability > 0.9
    assert len(found.findings) > 1
    assert change.effect.title in change_headline(found) or "heavier" in change_headline(found)
    assert any(word in action(found) for word in ("payload", "mass", "load"))


@pytest.mark.parametrize("machine", MACHINES, ids=lambda each: each.name)
def test_unchanged_robot_has_no_change(machine, tmp_path):
    # Friction differs from the nominal model in both states alike: nothing has changed.
    own = tuple(1.5 * each for each in machine.coulomb)
    before = _write_state(machine, tmp_path / "before", 31, coulomb=own)
    after = _write_state(machine, tmp_path / "after", 32, coulomb=own)
    found = diagnose_change(before, after, experiment=False)
    assert not found.changes
    assert change_verdict(found) == "unchanged"
    assert any(limit.effect.only_in for limit in found.detection_limits)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("machine", "seed", "drift"),
    [(SCARA, 100, 0.02), (UPRIGHT, 100, 0.02), (UPRIGHT, 103, 0.08), (SCARA, 107, 0.05)],
)
def test_drift_between_runs_is_no_change(machine, seed, drift, tmp_path):
    before = _write_state(machine, tmp_path / "before", seed, drift=drift)
    after = _write_state(machine, tmp_path / "after", seed + 100, drift=drift)
    found = diagnose_change(before, after, experiment=False)
    assert not found.changes
    assert change_headline(found).startswith("No change of the robot shows")


def test_files_of_a_comparison(tmp_path):
    harder = (SCARA.coulomb[0], SCARA.coulomb[1], 1.6 * SCARA.coulomb[2])
    before = _write_state(SCARA, tmp_path / "before", 41)
    after = _write_state(SCARA, tmp_path / "after", 42, coulomb=harder)
    found = diagnose_change(before, after, experiment=False)
    assert [(f["effect"], f["joint"], f["state"]) for f in answer_document(found)["findings"]] == [
        ("coulomb", 3, "after")
    ]
    out = tmp_path / "out"
    out.mkdir()
    write_diagnosis(found, out)
    model = load_extended(out / "extended.toml")
    (effect,) = model.extension.effects
    assert effect.amplitudes[0] == pytest.approx(0.6 * SCARA.coulomb[2], rel=0.1)
    page = write_diagnosis_report(found, out).read_text()
    assert "What changed" in page
    assert "What did not change, with detection limits" in page


def test_sets_that_cannot_be_compared_are_refused(tmp_path):
    before = _write_state(SCARA, tmp_path / "before", 51)
    with pytest.raises(InputFileError, match="two sets of one robot"):
        load_state_pair(before, before)
    other = _write_state(UPRIGHT, tmp_path / "other", 52)
    text = (other / "recordings.toml").read_text()
    changes = {
        "lies .* m from the joint before": (
            "robot.urdf",
            SCARA.urdf.replace('xyz="0.325 0 0"', 'xyz="0.4 0 0"'),
        ),
        "same joints in the same order": (
            "recordings.toml",
            text.replace("['shoulder', 'elbow', 'roll']", "['elbow', 'shoulder', 'roll']"),
        ),
        "differs from .* in coulomb": ("recordings.toml", text),
        "recorded before the change only": (
            "recordings.toml",
            (before / "recordings.toml").read_text().replace("'tau_elbow'", "''"),
        ),
        'none of the 4 runs has role = "test"': ("recordings.toml", text.replace("test", "train")),
    }
    for number, (message, (file, content)) in enumerate(changes.items()):
        wrong = _write_state(SCARA, tmp_path / f"wrong_{number}", 53)
        (wrong / file).write_text(content)
        with pytest.raises(InputFileError, match=message):
            load_state_pair(before, wrong)


def test_command_writes_result_and_tells_mistakes(tmp_path, capsys):
    before = _write_state(SCARA, tmp_path / "before", 61)
    after = _write_state(SCARA, tmp_path / "after", 62)
    out = tmp_path / "out"
    call = ["diagnose", "--out", str(out), "--quiet", "--no-report", "--no-experiment"]
    states = ["--before", str(before), "--after", str(after)]
    assert run([*call, *states]) == 0
    assert "unchanged: No change of the robot shows between the two states." in (
        " ".join(capsys.readouterr().out.split())
    )
    assert (out / "extended.toml").is_file()
    for wrong, message in (
        (["--before", str(before)], "--before needs --after as well"),
        ([str(before), *states], "one too many"),
        ([*states, "--model", str(out / "extended.toml")], "give one of the two"),
        ([], "needs a recording set, or two states"),
    ):
        assert run(["diagnose", *wrong]) == 2
        assert message in " ".join(capsys.readouterr().err.split())


def test_drift_between_runs_is_about_the_mean_of_each_state():
    runs, states = ("a", "b", "c", "d"), ("before", "before", "after", "after")
    drift = friction_drift(runs, states=states)
    # A difference of the states alone is no drift.
    assert drift.report((0.0, 0.0, 1.0, 1.0), (1.0,), SCARA_CONSTANTS)["dFv_spread"] == 0.0
    assert drift.report((0.0, 0.2, 1.0, 1.0), (1.0,), SCARA_CONSTANTS)["dFv_spread"] > 0.0
