"""Published recordings of real robots: read whole, and found to have the faults they are known for.

They lie outside of this repository, in the folder that STIFFOPT_RECORDINGS names.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from stiffopt.recording.check import RecordingReport, check_recordings
from stiffopt.recording.recording_set import RecordingSet, load_recordings, require_test_runs
from stiffopt.recording.static_set import load_static_set

BESIDE = Path(__file__).resolve().parents[3] / "shared" / "recordings"
FOLDER = Path(os.environ.get("STIFFOPT_RECORDINGS", BESIDE))
SETS = {
    "dfki_a0815": (2, 9, 500.0),
    "emps": (1, 2, 1000.0),
    "kuka_kr300": (6, 2, 250.0),
    "tx40_first": (6, 2, 1000.0),
    "unisa_ur10": (6, 2, 125.0),
    "ur10e": (6, 6, 100.0),
}


def folder(name: str) -> Path:
    if not (FOLDER / name).is_dir():
        pytest.skip(f"no recordings at {FOLDER / name}; set STIFFOPT_RECORDINGS to their folder")
    return FOLDER / name


@cache
def checked(path: Path) -> tuple[RecordingSet, RecordingReport]:
    recordings = load_recordings(path)
    return recordings, check_recordings(recordings)


def kinds(report: RecordingReport, signal: str | None = None) -> set[str]:
    return {
        fault.kind
        for run in report.runs
        for fault in run.faults
        if signal is None or fault.signal == signal
    }


@pytest.mark.parametrize("name", SETS)
def test_every_run_is_read_and_usable(name: str) -> None:
    joints, runs, rate = SETS[name]
    recordings, report = checked(folder(name))
    require_test_runs(recordings)
    assert (recordings.n, len(report.runs)) == (joints, runs)
    assert recordings.robot.model.nv == joints
    for run in report.runs:
        assert run.usable
        assert run.rate == pytest.approx(rate, rel=0.35)
        assert not any(fault.left_out for fault in run.faults)
        # Whatever is taken out as a spike must be rare.
        assert sum(f.share for f in run.faults if f.kind == "outlier") < 2e-3


@pytest.mark.parametrize("name", ["dfki_a0815", "ur10e"])
def test_jitter_of_published_clocks_is_reported(name: str) -> None:
    _, report = checked(folder(name))
    for run in report.runs:
        assert any(fault.kind == "jitter" for fault in run.faults)


@pytest.mark.parametrize("name", ["emps", "kuka_kr300", "tx40_first", "unisa_ur10"])
def test_even_clocks_have_no_jitter(name: str) -> None:
    _, report = checked(folder(name))
    assert kinds(report, "time") == set()


def test_the_spread_of_the_ur10e_clock() -> None:
    _, report = checked(folder("ur10e"))
    fourier = next(run for run in report.runs if run.name == "f_14h")
    assert any("from 2 to 13 ms" in fault.detail for fault in fourier.faults)
    assert fourier.jitter == pytest.approx(0.9e-3, rel=0.15)


def test_stationary_joints_of_the_ur10e_have_no_fault() -> None:
    """In these runs one joint moves; velocities of the others are zero throughout."""
    _, report = checked(folder("ur10e"))
    for moving in (1, 2, 3):
        run = next(run for run in report.runs if run.name == f"joint{moving}")
        assert {fault.joint for fault in run.faults if fault.kind == "constant"} == set()


def test_coarse_current_of_the_dfki_arm_is_reported() -> None:
    _, report = checked(folder("dfki_a0815"))
    step = next(c for c in report.runs[0].channels if c.signal == "torque").step
    assert step == pytest.approx(0.00586, rel=0.01)
    assert "quantised" in kinds(report, "torque")


def test_kuka_has_link_encoders_on_three_joints() -> None:
    _, report = checked(folder("kuka_kr300"))
    assert [len(found) for found in report.balances] == [3, 3, 3, 1, 1, 1]
    assert kinds(report, "link_position") == set()


def test_zero_columns_of_the_kuka_source_are_removed(tmp_path: Path) -> None:
    """The source holds zeros where joints 4 to 6 have no second encoder."""
    source = folder("kuka_kr300")
    text = (source / "recordings.toml").read_text()
    text = text.replace('"ql3", "", "", ""', '"ql3", "ql4", "ql5", "ql6"')
    (tmp_path / "recordings.toml").write_text(text)
    (tmp_path / "robot.urdf").write_bytes((source / "robot.urdf").read_bytes())
    for name in ("A", "B"):
        run = dict(np.load(source / f"{name}.npz"))
        run |= {f"ql{j}": np.zeros_like(run["t"]) for j in (4, 5, 6)}
        np.savez(tmp_path / f"{name}.npz", **run)
    _, report = checked(tmp_path)
    assert [len(found) for found in report.balances] == [3, 3, 3, 1, 1, 1]
    for run in report.runs:
        left_out = {(f.signal, f.joint) for f in run.faults if f.left_out}
        assert left_out == {("link_position", j) for j in (4, 5, 6)}


def test_published_static_set_loads() -> None:
    static = load_static_set(folder("fanuc_r2000_static"))
    assert static.position.shape == (43, 6)
    assert static.stiffness is not None
    assert static.stiffness[1] == 4.129e6
    assert np.abs(static.displacement).max() < 0.01


def test_simulated_case_has_no_faults() -> None:
    cases = sorted((FOLDER.parent / "blind" / "open").glob("case_*"))
    if not cases:
        pytest.skip(f"no simulated cases at {FOLDER.parent / 'blind' / 'open'}")
    recordings, report = checked(cases[1])
    assert len(report.runs) == 8
    assert kinds(report) == set()
    assert recordings.assumptions == ()
    for run in report.runs:
        for channel in run.channels:
            if channel.stated_noise is not None:
                assert channel.noise == pytest.approx(channel.stated_noise, rel=0.25)
