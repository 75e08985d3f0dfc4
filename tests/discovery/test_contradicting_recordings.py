"""Own logs of a SCARA arm and a gantry that are wrong: what is wrong is named, and nothing else."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from own_machines import GANTRY, SCARA, Log
from test_sanity_gate import doubted

from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.sanity.gate import (
    SanityGate,
    _doubt_single_runs,
    _is_odd,
    find_odd_runs,
)
from stiffopt.discovery.sanity.interpretations import Samples
from stiffopt.discovery.training import open_training_runs
from stiffopt.recording.recording_set import load_recordings
from stiffopt.report.diagnosis.mismatch import carried_part_sentences
from stiffopt.report.diagnosis.sections import fault_lines
from stiffopt.report.diagnosis.words import (
    headline,
    unassessed_joint_sentences,
)


def millimetres(*joints: int):
    def change(logs: list[Log]) -> None:
        for log in logs:
            for kind in ("q", "v"):
                log[kind][:, list(joints)] *= 1e3

    return change


def slower_clock(*runs: int):
    def change(logs: list[Log]) -> None:
        for run in runs:
            logs[run]["t"] *= 2.0

    return change


def exchanged(logs: list[Log]) -> None:
    for log in logs:
        for kind in ("q", "v", "tau"):
            log[kind][:, [0, 1]] = log[kind][:, [1, 0]]


def constant_torque(logs: list[Log]) -> None:
    for log in logs:
        log["tau"][:, 1] = 1.234


def stuck_encoder(logs: list[Log]) -> None:
    logs[1]["q"][:, 1] = 0.5


def with_a_gap(logs: list[Log]) -> None:
    kept = np.r_[0:500, 700:1200]
    logs[1].update({name: values[kept] for name, values in logs[1].items()})


def unknown_torque(logs: list[Log]) -> None:
    logs[1]["tau"][500:700, 1] = np.nan


@pytest.mark.parametrize("machine", [SCARA, GANTRY], ids=lambda machine: machine.name)
def test_valid_recordings_are_not_doubted(machine, tmp_path: Path) -> None:
    assert doubted(machine.write(tmp_path / "set")) == ()


@pytest.mark.parametrize(
    ("joints", "line"),
    [((0, 1, 2), 'position = "mm"'), ((2,), "position = [1.0, 1.0, 0.001]")],
)
def test_prismatic_joint_in_millimetres_is_doubted(joints, line, tmp_path: Path) -> None:
    first = doubted(GANTRY.write(tmp_path / "set", millimetres(*joints)))[0]
    assert (first.kind, first.joints) == ("position unit", tuple(j + 1 for j in joints))
    assert "look like mm" in first.evidence
    assert first.line.startswith(line)


def test_exchanged_gantry_axes_are_no_currents(tmp_path: Path) -> None:
    assert doubted(GANTRY.write(tmp_path / "set", exchanged))[0].kind == "joint order"


@pytest.mark.parametrize(
    ("runs", "line", "words"),
    [
        ((0, 1, 2, 3), "time = 0.5 in [signals.scale]", "The velocity contradicts"),
        ((1,), "", "Only in run_2, not in all runs: The velocity contradicts"),
    ],
)
def test_wrong_clock_is_doubted(runs, line, words, tmp_path: Path) -> None:
    found = doubted(SCARA.write(tmp_path / "set", slower_clock(*runs)))
    (velocity,) = (each for each in found if each.kind == "velocity")
    assert velocity.evidence.startswith(words)
    assert velocity.line == line
    assert "time or sampling rate" in velocity.evidence


@pytest.mark.parametrize("change", [with_a_gap, unknown_torque])
def test_gap_is_no_odd_run(change, tmp_path: Path) -> None:
    assert doubted(SCARA.write(tmp_path / "set", change)) == ()


def test_a_run_is_not_odd_where_the_model_fails_in_all_runs() -> None:
    far = np.array([2400.0])
    assert _is_odd(far, np.array([0.01])).all()
    assert not _is_odd(far, np.array([200.0])).any()


def test_missing_torque_is_not_explained(tmp_path: Path) -> None:
    diagnosis = diagnose(SCARA.write(tmp_path / "set", constant_torque), experiment=False)
    assert diagnosis.verdict == "nothing_missing"
    (sentence,) = unassessed_joint_sentences(diagnosis)
    assert sentence == "Joint 2 was not assessed: its torque is usable in no training run."
    assert sentence.removesuffix(".") in headline(diagnosis)
    (line,) = fault_lines(diagnosis)
    assert "torque of joint 2 of run_1, run_2, run_3 and run_4 stays at 1.234" in line


def test_a_run_without_a_position_is_left_out_by_name_and_reason(tmp_path: Path) -> None:
    diagnosis = diagnose(SCARA.write(tmp_path / "set", stuck_encoder), experiment=False)
    (note,) = (each for each in diagnosis.assumptions if each.startswith("run_2.csv"))
    assert "joint 2 stays at 0.5 rad" in note
    assert any("position of joint 2 of run_2" in line for line in fault_lines(diagnosis))


def test_payload_of_one_run_is_named_with_its_run(tmp_path: Path) -> None:
    diagnosis = diagnose(SCARA.write(tmp_path / "set", payload=(1, 0.6)), experiment=False)
    (finding,) = (each for each in diagnosis.findings if each.probability > 0.5)
    assert finding.effect.name == "carried_part"
    mass = finding.parameters[0]
    assert mass.name == "m"
    assert abs(mass.value - 0.6) < 3.0 * mass.sd < 0.2
    assert headline(diagnosis).startswith("A part of 0.6")
    (sentence,) = carried_part_sentences(diagnosis)
    assert "run_2 0.00 to" in sentence
    assert "run_1" not in sentence


def saturated(logs: list[Log]) -> None:
    """Torques are demands: in one run they exceed those of the others, and what the drive gives."""
    largest = max(np.abs(log["tau"][:, 1]).max() for log in (logs[0], logs[1], logs[3]))
    demand = logs[2]["tau"][:, 1]
    excess = np.maximum(np.abs(demand) - 1.02 * largest, 0.0)
    assert np.count_nonzero(excess) > 30
    demand += 10.0 * np.sign(demand) * excess


def test_demand_beyond_a_limit_in_one_run_is_remarked_not_doubted(tmp_path: Path) -> None:
    recordings = load_recordings(SCARA.write(tmp_path / "set", saturated))
    gate = SanityGate(recordings, open_training_runs(recordings))
    assert gate.doubts == ()
    (odd,) = gate._odd_runs
    assert (odd.run.name, odd.joints, odd.outside_range) == ("run_3", (1,), True)
    assert "run_3 moves faster or further than the other runs, or with larger torques" in (
        gate.remarks[0].evidence
    )


@pytest.mark.parametrize("reverses", [True, False])
def test_a_joint_that_moves_in_one_direction_alone_makes_no_run_odd(reverses: bool) -> None:
    """Its torque varies by noise only: a large share of that is a small residual."""
    rng, direction = np.random.default_rng(3), np.repeat([-1.0, 1.0], 10)[:, None]

    def searched(friction: np.ndarray, share: float) -> tuple[Any, Any]:
        torque = 2.5 * friction + rng.normal(0.0, 0.1, friction.shape)
        speed = 0.1 * friction
        samples = Samples(0.0 * speed, speed, 0.0 * speed, torque, ())
        strict, motion = np.array([share]), SimpleNamespace(velocity=speed)
        own = SimpleNamespace(with_free_guesses=strict, samples=samples, motion=motion)
        return SimpleNamespace(name="run"), own

    last = searched(direction if reverses else np.abs(direction), 0.33)
    odd = find_odd_runs([searched(direction, 0.002), searched(direction, 0.001), last])
    assert [each.search for each in odd] == ([last[1]] if reverses else [])


def test_a_reading_of_several_joints_in_one_run_is_compared_with_the_others():
    """The other runs do not fit either: nothing is told of one."""
    shares = np.array([0.6, 0.5, 0.01])
    reading = SimpleNamespace(joints=(0, 1))
    searches = [
        (SimpleNamespace(name=name), SimpleNamespace(best=lambda: reading, strict=shares))
        for name in ("one", "two")
    ]
    assert not list(_doubt_single_runs(None, searches, SimpleNamespace(strict=shares)))
