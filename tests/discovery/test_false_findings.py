"""What a diagnosis must not fall for, each on a simulated set that tempts it."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated_sets import diagnosed, diagnosis_of, said, simulated

from benchmarks.simulator import CaseSpec, write_case
from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.comparison.located_effect import effect_places
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import prepare_run
from stiffopt.discovery.diagnosis import Diagnosis
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

pytestmark = pytest.mark.slow

SMALL = CaseSpec(seconds=5.0, train=4, test=1, extrapolate=0, rate=250.0, substeps=8)


def small(*effects: tuple[str, int | None, float], seed: int, **other: Any) -> CaseSpec:
    """A small set with effects hidden in it."""
    return replace(SMALL, effects=effects, seed=seed, **other)


def families(diagnosis: Diagnosis) -> set[str]:
    """Of everything that is named."""
    return {finding.effect.family for finding in diagnosis.findings}


def names(diagnosis: Diagnosis) -> set[str]:
    """Of everything that is named."""
    return {finding.effect.name for finding in diagnosis.findings}


def columns_changed(
    change: Callable[[str, dict[str, np.ndarray]], None],
) -> Callable[[Path], None]:
    """Change of a written set: the columns of its runs, one run after another."""

    def changed(folder: Path) -> None:
        for file in sorted(folder.glob("*.npz")):
            with np.load(file) as stored:
                columns = dict(stored)
            change(file.stem, columns)
            np.savez_compressed(file, **columns)

    return changed


# ---- nothing is missing


@pytest.mark.parametrize(("robot", "seed"), [("planar2", 101), ("planar2", 102), ("small3", 103)])
def test_robot_within_tolerance_has_no_findings(robot: str, seed: int) -> None:
    diagnosis = diagnosed(small(seed=seed, robot=robot))
    assert diagnosis.verdict == "nothing_missing", said(diagnosis)


@pytest.mark.parametrize("stated", [0.5, 2.0])
def test_wrong_noise_has_no_findings(stated: float) -> None:
    diagnosis = diagnosed(small(seed=101, stated_noise=stated))
    assert diagnosis.verdict == "nothing_missing", said(diagnosis)


@pytest.mark.parametrize("stated", [0.5, 2.0])
def test_effect_is_found_with_wrong_noise(stated: float) -> None:
    diagnosis = diagnosed(small(("load_friction", 1, 1.0), seed=104, stated_noise=stated))
    assert [f.located.label for f in diagnosis.findings] == ["load_friction of joint 1"]


# ---- one thing taken for another


@pytest.mark.parametrize("severity", [1.0, 4.0])
def test_link_encoder_delay_is_not_compliance(severity: float) -> None:
    diagnosis = diagnosed(small(("encoder_skew", None, severity), seed=105))
    assert "elastic" not in families(diagnosis), said(diagnosis)


@pytest.mark.parametrize("link", [1, 2])
def test_wrong_inertia_is_not_friction(link: int) -> None:
    diagnosis = diagnosed(small(("inertial_error", link, 2.0), seed=106, robot="small3"))
    # The first link turns about an upright axis: of its errors next to nothing shows.
    assert diagnosis.findings or link == 1
    assert "friction" not in families(diagnosis), said(diagnosis)


def test_payload_is_not_friction() -> None:
    diagnosis = diagnosed(small(("payload", None, 2.0), seed=107, robot="small3"))
    assert diagnosis.findings
    assert "friction" not in families(diagnosis), said(diagnosis)


# ---- fits that are no proof


def test_terms_do_not_use_measured_torque(tmp_path: Path) -> None:
    assert [effect.name for effect in CATALOGUE if effect.takes_recorded] == ["saturation"]
    recordings = load_recordings(write_case(simulated(small(seed=101)), tmp_path / "set"))
    settings = Settings()
    training = prepare_training(recordings, settings)
    robot, constants = RobotModel(recordings), training.constants
    for run in training.recorded[:1]:
        shuffled = np.random.default_rng(0).permutation(run.torque, axis=0)
        as_is, other = (
            prepare_run(robot, each, 0, constants, settings)
            for each in (run, replace(run, torque=shuffled))
        )
        assert not np.array_equal(as_is.torque, other.torque)
        for effect in CATALOGUE:
            located = next(effect_places(effect, constants, [run.name]), None)
            # A drive's demand beyond its limit is no prediction, and costs its own density.
            if located is None or effect.takes_recorded:
                continue
            for one, two in zip(located.columns(as_is), located.columns(other), strict=True):
                for a, b in zip(one, two, strict=True):
                    same = (a is None and b is None) if a is None or b is None else (a == b).all()
                    assert same, located.label


def test_noise_of_the_torque_sensor_does_not_explain_itself() -> None:
    draw = np.random.default_rng(5)

    def noisy(run: str, columns: dict[str, np.ndarray]) -> None:
        for name in ("tau1", "tau2"):
            columns[name] = columns[name] + 2.0 * draw.standard_normal(len(columns[name]))

    diagnosis = diagnosis_of(simulated(small(seed=101)), columns_changed(noisy))
    assert diagnosis.findings == (), said(diagnosis)


def test_friction_of_one_run_is_not_found_in_all() -> None:
    """Stribeck friction that one training run shows would worsen every other run."""

    def once(run: str, columns: dict[str, np.ndarray]) -> None:
        if run == "train_2":
            speed = columns["qd1"]
            rise = 2.0 * np.exp(-((speed / 0.1) ** 2)) * np.tanh(speed / 0.01)
            columns["tau1"] = columns["tau1"] + rise

    diagnosis = diagnosis_of(simulated(small(seed=102)), columns_changed(once))
    assert "stribeck" not in names(diagnosis), said(diagnosis)


# ---- channels and labels


@pytest.mark.parametrize("column", ["ql2", "tau2"])
def test_zeros_in_unused_channel_have_no_findings(column: str) -> None:
    def empty(run: str, columns: dict[str, np.ndarray]) -> None:
        columns[column] = np.zeros_like(columns[column])

    diagnosis = diagnosis_of(simulated(small(seed=101)), columns_changed(empty))
    assert diagnosis.verdict == "nothing_missing", said(diagnosis)
    assert any(fault.left_out and fault.joint == 2 for _, fault in diagnosis.faults)


def test_zeros_in_an_unused_channel_do_not_hide_an_effect() -> None:
    def empty(run: str, columns: dict[str, np.ndarray]) -> None:
        columns["ql2"] = np.zeros_like(columns["ql2"])

    case = simulated(small(("load_friction", 1, 1.0), seed=104))
    diagnosis = diagnosis_of(case, columns_changed(empty))
    assert [f.located.label for f in diagnosis.findings] == ["load_friction of joint 1"]


def backwards(folder: Path) -> None:
    """Name the joints of a set in the opposite order, everything of them along."""
    file = folder / "recordings.toml"
    text = file.read_text(encoding="utf-8")
    data = tomllib.loads(text)
    n = len(data["joints"])
    lines = []
    for line in text.splitlines():
        key, equals, value = line.partition(" = ")
        values = tomllib.loads(f"v = {value}")["v"] if equals else None
        if isinstance(values, list) and len(values) == n and key != "gravity":
            items = [repr(v) if not isinstance(v, str) else f'"{v}"' for v in reversed(values)]
            line = f"{key} = [{', '.join(items)}]"
        lines.append(line)
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.mark.parametrize(("effect", "joint"), [("load_friction", 1), ("stiffness_linear", 2)])
def test_joint_order_does_not_change_result(effect: str, joint: int) -> None:
    spec = small((effect, joint, 1.0), seed=104)
    straight = diagnosed(spec)
    turned = diagnosis_of(simulated(spec), backwards)
    assert straight.recordings.joints == tuple(reversed(turned.recordings.joints))

    def answer(diagnosis: Diagnosis) -> list[tuple[str, str | None]]:
        joints = diagnosis.recordings.joints
        return [
            (f.effect.name, None if f.joint is None else joints[f.joint - 1])
            for f in diagnosis.findings
        ]

    assert answer(straight) == answer(turned) == [(effect, f"joint{joint}")]
    for one, two in zip(straight.findings, turned.findings, strict=True):
        for a, b in zip(one.parameters, two.parameters, strict=True):
            assert a.value == pytest.approx(b.value, rel=1e-3)
