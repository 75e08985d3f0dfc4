"""Friction that settles over a session: told where the times of the runs are known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from own_machines import GANTRY, Log

from stiffopt.discovery.diagnose import diagnose, diagnose_change
from stiffopt.recording.recording_set import load_recordings
from stiffopt.starter.recording_set import start_recording_set

BEGINS, MORE, TIME_CONSTANT = (0.0, 40.0, 95.0, 150.0), 9.0, 45.0


def cold(logs: list[Log], begins: Sequence[float] = BEGINS) -> None:
    """The ram rubs by 9 N more when cold."""
    for begin, log in zip(begins, logs, strict=True):
        more = MORE * np.exp(-(begin + log["t"]) / TIME_CONSTANT)
        log["tau"][:, 2] += more * np.tanh(log["v"][:, 2] / 0.01)


def with_session_times(folder: Path) -> Path:
    path = folder / "recordings.toml"
    head, *runs = path.read_text().split("[[runs]]")
    told = [f"[[runs]]{run}session_time = {at}\n" for run, at in zip(runs, BEGINS, strict=True)]
    path.write_text("".join([head, *told]))
    return folder


def test_friction_that_settles_over_the_session_is_named(tmp_path: Path) -> None:
    folder = with_session_times(GANTRY.write(tmp_path / "set", cold))
    diagnosis = diagnose(folder, experiment=False)
    (finding,) = (each for each in diagnosis.findings if each.probability > 0.5)
    assert (finding.effect.name, finding.joint) == ("cold_start", 3)
    values = {each.name: each for each in finding.parameters}
    for name, truth in (("dFc", MORE), ("tau_w", TIME_CONSTANT)):
        assert abs(values[name].value - truth) < 3.0 * values[name].sd < truth
    (proof,) = diagnosis.held_out
    assert proof.nrmse_after < 1.1


def test_order_of_runs_stands_for_their_times(tmp_path: Path) -> None:
    """Runs of equal pauses: where no session times are given, the fit has the period as well."""
    folder = GANTRY.write(
        tmp_path / "set", lambda logs: cold(logs, begins=(0.0, 40.0, 80.0, 120.0))
    )
    diagnosis = diagnose(folder, experiment=False)
    (finding,) = (each for each in diagnosis.findings if each.probability > 0.5)
    assert (finding.effect.name, finding.joint) == ("untimed_cold_start", 3)
    values = {each.name: each for each in finding.parameters}
    # Time constant and period are known as a ratio: the friction left at the next run.
    for name, truth in (("dFc", MORE), ("tau_w", TIME_CONSTANT), ("period", 40.0)):
        assert values[name].value == pytest.approx(truth, rel=0.15)
        assert abs(values[name].value - truth) < 2.0 * values[name].sd
    (proof,) = diagnosis.held_out
    assert proof.nrmse_after < 1.1


@pytest.mark.parametrize(("begins", "known"), [(BEGINS, BEGINS), ((0.0,) * 4, (None,) * 4)])
def test_logs_of_one_clock_have_session_times(begins, known, tmp_path: Path) -> None:
    def of_one_clock(logs: list[Log]) -> None:
        for begin, log in zip(begins, logs, strict=True):
            log["t"] += 2e4 + begin

    GANTRY.write(tmp_path / "logs", of_one_clock)
    files = [tmp_path / "logs" / f"run_{k}.csv" for k in range(1, 5)]
    start_recording_set(files, tmp_path / "logs" / "robot.urdf", tmp_path / "set")
    runs = load_recordings(tmp_path / "set").runs
    assert [each.session_time for each in runs] == pytest.approx(known, abs=1e-3)


@pytest.mark.slow
def test_more_friction_after_a_change_is_no_warming(tmp_path: Path) -> None:
    """With a short time constant, friction that changes within each run is a constant one."""

    def worn(logs: list[Log]) -> None:
        for log in logs:
            v = log["v"][:, 2]
            log["tau"][:, 2] += 0.5 * (
                GANTRY.coulomb[2] * np.tanh(v / 0.01) + GANTRY.viscous[2] * v
            )

    before = GANTRY.write(tmp_path / "before")
    after = GANTRY.write(tmp_path / "after", worn)
    diagnosis = diagnose_change(before, after)
    changed = {(each.effect.name, each.joint) for each in diagnosis.changes}
    assert changed == {("coulomb", 3), ("viscous", 3)}
