"""Joint damping other than nominal, and springs that are refused."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnosed_folders import copied
from simulated_sets import COULOMB, diagnosis_of, said

from benchmarks.simulator import ROBOTS, CaseSpec, simulate
from benchmarks.simulator import integrator as simulator
from stiffopt.cli import run
from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, LocatedEffect
from stiffopt.discovery.training import _check_damping
from stiffopt.discovery.user_effects import sample_signals
from stiffopt.errors import InputFileError
from stiffopt.robot.files import load_robot

SHARP = CaseSpec(
    robot="big6", seed=21, train=3, test=1, extrapolate=0, seconds=5.0, rate=250.0, substeps=8,
    payload=10.0, smoothing=0.2,
)  # fmt: skip
MORE = 4.0


@pytest.mark.slow
def test_joint_damping_is_found_with_its_size(monkeypatch):
    begin = simulator._Spring.__init__

    def damped(self, world):
        begin(self, world)
        self._damping = self._damping * np.where(np.arange(6) == 1, MORE, 1.0)

    monkeypatch.setattr(simulator._Spring, "__init__", damped)
    found = diagnosis_of(simulate(SHARP), lambda folder: None)
    assert [f.located.label for f in found.findings] == ["joint_damping of joint 2"], said(found)
    added = found.findings[0].parameters[0]
    truth = (MORE - 1.0) * ROBOTS["big6"].joint_damping[1]
    assert abs(added.value - truth) < max(3.0 * added.sd, 0.05 * truth)
    assert found.nrmse("test")[1] < 1.1
    assert not any(mode.is_shifted for mode in found.modes)


def test_change_robot_sets_estimated_damping():
    entry, constants = effect("joint_damping"), sample_signals().constants.joints[2]
    found = EstimatedEffect(located=LocatedEffect(effect=entry, joint=2), amplitudes=(30.0,))
    change = entry.change_robot(load_robot("er3a_c60"), found, 2, constants)
    assert change.robot.damping[2] == pytest.approx(90.0)
    assert "60 to 90" in change.sentence


@pytest.mark.parametrize(
    ("key", "stated", "said_of_it"),
    [
        ("joint_damping", "[-1.0, 2.0]", r"joint_damping.*0"),
        ("joint_damping", "[9e5, 2.0]", r"9e\+?0?5|900000.*above the critical"),
        ("joint_damping", "[5.0, 1e12]", r"joint_damping\[2\]: 1e\+12"),
        ("stiffness", "1.5", r"tolerance\.stiffness.*1"),
    ],
)
def test_invalid_springs_are_refused(tmp_path, capsys, key, stated, said_of_it):
    source = copied(COULOMB, tmp_path / "set")
    file = source / "recordings.toml"
    text = file.read_text(encoding="utf-8")
    changed = re.sub(rf"(?m)^{key} = .*$", f"{key} = {stated}", text)
    assert changed != text
    file.write_text(changed, encoding="utf-8")
    assert run(["diagnose", str(source), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert re.search(said_of_it, " ".join(told.split())), told
    assert "Traceback" not in told
    assert not (tmp_path / "out").exists()


def test_damping_above_critical_is_reported_in_joint_unit() -> None:
    """A slide has N s/m."""
    told: Any = SimpleNamespace(
        path=Path("recordings.toml"), joints=("lift",), prismatic=np.array([True])
    )
    swing = SimpleNamespace(
        bodies=(None, None, np.ones((2, 1, 1))),
        stiffness=np.full((2, 1), 1e4),
        damping=np.array([300.0]),
    )
    probe: Any = SimpleNamespace(vibration=swing)
    robot: Any = SimpleNamespace(recordings=told)
    with pytest.raises(InputFileError, match="300 N s/m at 'lift' is above the critical 200"):
        _check_damping(robot, probe)
