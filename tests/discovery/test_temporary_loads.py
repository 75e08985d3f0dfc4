"""Parts grasped and released within runs, and pushes: when, how heavy, none where others act."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from own_machines import GANTRY, SCARA, Log

from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.judging.episodes import episodes_of_force
from stiffopt.discovery.judging.temporary_loads import (
    TemporaryLoad,
    find_known_part,
    find_temporary_load,
)
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings
from stiffopt.report.diagnosis.mismatch import carried_part_sentences
from stiffopt.report.diagnosis.words import headline

MASS = 1.5
# Runs from 0; the last one is held out.
CARRIED = {0: ((1.0, 2.5), (4.0, 5.5)), 1: ((2.0, 5.0),), 3: ((1.5, 4.5),)}


def carrying(mass: float, carried: Mapping[int, tuple]) -> Callable[[list[Log]], None]:
    def change(logs: list[Log]) -> None:
        for run, intervals in carried.items():
            # The same motion and noise with the part throughout.
            loaded = GANTRY.logs(payload=(run, mass))[run]
            for begin, end in intervals:
                inside = (loaded["t"] >= begin) & (loaded["t"] <= end)
                logs[run]["tau"][inside] = loaded["tau"][inside]

    return change


def pushed(joint: int, force: float) -> Callable[[list[Log]], None]:
    def change(logs: list[Log]) -> None:
        for log in logs[:2]:
            inside = (log["t"] > 2.0) & (log["t"] < 4.0)
            log["tau"][inside, joint] += force

    return change


def rubbing(logs: list[Log]) -> None:
    for log in logs:
        late = log["t"] > 3.0
        log["tau"][late, 2] += 8.0 * np.tanh(log["v"][late, 2] / 0.01)


def found_in(folder: Path) -> TemporaryLoad | None:
    training = prepare_training(load_recordings(folder), Settings())
    return find_temporary_load(training.robot, training.runs)


@pytest.mark.parametrize("mass", [MASS, 0.3])
def test_intervals_of_a_part_are_found(mass: float, tmp_path: Path) -> None:
    found = found_in(GANTRY.write(tmp_path / "set", carrying(mass, CARRIED)))
    assert found is not None
    assert found.is_part
    for run, own in enumerate(found.intervals):
        assert np.allclose(own, CARRIED.get(run, ()), atol=0.1)


def test_a_force_at_the_hand_for_a_while_is_a_contact(tmp_path: Path) -> None:
    """Beside masses that are two and a half times as large as stated, which hide it."""
    model, force = pin.buildModelFromXML(SCARA.urdf), np.array([6.0, -4.0, 0.0])
    data = model.createData()

    def push(logs: list[Log]) -> None:
        for log in logs:
            log["tau"] *= 2.5
        log = logs[1]
        for k in np.flatnonzero((log["t"] > 2.0) & (log["t"] < 3.5)):
            lever = pin.computeJointJacobian(model, data, log["q"][k], 3)
            pin.forwardKinematics(model, data, log["q"][k])
            log["tau"][k] -= (data.oMi[3].rotation @ lever[:3]).T @ force

    folder = SCARA.write(tmp_path / "set", push)
    found = found_in(folder)
    assert found is not None
    assert not found.is_part
    first, (interval,), third = found.intervals
    assert not (*first, *third)
    assert np.allclose(interval, (2.0, 3.5), atol=0.1)
    runs = prepare_training(load_recordings(folder), Settings()).recorded
    (episode,) = episodes_of_force(found, runs)
    assert (episode.run, episode.begin, episode.end) == ("run_2", *interval)
    assert episode.joints[:2] == (1, 2)


@pytest.mark.parametrize(
    "change", [lambda logs: None, pushed(0, 20.0), rubbing], ids=["nothing", "push", "friction"]
)
def test_something_else_for_a_while_is_no_load(change, tmp_path: Path) -> None:
    """Friction that grows in all runs may look like a force: too often for a contact."""
    folder = GANTRY.write(tmp_path / "set", change)
    training = prepare_training(load_recordings(folder), Settings())
    found = find_temporary_load(training.robot, training.runs)
    assert found is None or not (found.is_part or episodes_of_force(found, training.recorded))


def test_part_is_named_with_its_mass_and_times_and_held_out_runs_follow(tmp_path: Path) -> None:
    diagnosis = diagnose(GANTRY.write(tmp_path / "set", carrying(MASS, CARRIED)), experiment=False)
    (finding,) = (each for each in diagnosis.findings if each.probability > 0.5)
    assert finding.effect.name == "carried_part"
    mass = finding.parameters[0]
    assert abs(mass.value - MASS) < 3.0 * mass.sd < 0.3
    assert headline(diagnosis).startswith("A part of 1.5")
    (proof,) = diagnosis.held_out
    assert np.allclose(proof.run.carried, CARRIED[3], atol=0.1)
    assert proof.nrmse_after < 1.1 < proof.nrmse_before
    (sentence,) = carried_part_sentences(diagnosis)
    assert all(name in sentence for name in ("run_1", "run_2", "run_4"))
    assert "run_3" not in sentence


def test_a_run_without_the_part_carries_none() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 10.0, 0.01)
    noise, part = rng.normal(size=(len(time), 2)), 3.0 * np.cos(time)[:, None] * np.ones(2)
    used = np.ones(noise.shape, dtype=bool)
    assert find_known_part(time, used, noise, noise - part) == ()
    inside = ((time >= 4.0) & (time <= 7.0))[:, None]
    (found,) = find_known_part(time, used, noise + inside * part, noise + (inside - 1.0) * part)
    assert np.allclose(found, (4.0, 7.0), atol=0.1)
