"""Predictions of an arm that resonates within the motion's own frequencies."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from simulated_sets import simulated

from benchmarks.simulator import CaseSpec, write_case
from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.comparison.extension_change import added_inertia
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension, LocatedEffect
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import prepare_run
from stiffopt.discovery.comparison.recorded_scales import constants_over
from stiffopt.discovery.prediction import Predictor
from stiffopt.discovery.settings import Settings
from stiffopt.recording.recording_set import load_recordings

# The large arm swings at 9.5 and 10.3 Hz; nothing of it differs from the nominal one by chance.
HEALTHY = CaseSpec(
    robot="big6", seed=3, train=1, test=2, extrapolate=0, seconds=5.0, rate=250.0, substeps=8,
    tolerance=0.0,
)  # fmt: skip
LOADED = replace(HEALTHY, effects=(("payload", None, 3.0),))
SOFTER = replace(HEALTHY, effects=(("stiffness_linear", 2, 2.0),))
# The first sample lies within a corner of a sharp motion, and swings at 13 and 20 Hz.
SHARP = replace(HEALTHY, seed=770104, payload=5.723, smoothing=0.2)
MOVING = 0.03
# A tenth of a link encoder's noise [rad].
SAME = 1.5e-6
# Of the noise: more than an eighth would be added to it.
HALF = 0.5


@cache
def _opened(spec, folder):
    path = write_case(simulated(spec), Path(folder) / spec.case_name)
    recordings = load_recordings(path)
    robot = RobotModel(recordings)
    entries = (*recordings.with_role("train"), *recordings.with_role("test"))
    runs = {entry.file: recordings.open(entry) for entry in entries}
    ranged = constants_over(
        robot, [prepare_run(robot, run, 0, None, Settings()) for run in runs.values()]
    )
    return recordings, robot, runs, ranged


def _errors(spec, folder, *extensions, vibrating=True):
    """Root mean square of prediction less exact signal over noise: torque in motion, links."""
    _, robot, runs, ranged = _opened(spec, folder)
    case = simulated(spec)
    torque, link = [], []
    for record, (name, run) in zip(case.runs, runs.items(), strict=True):
        if not name.startswith("test"):
            continue
        training = SimpleNamespace(robot=robot, constants=ranged, settings=Settings())
        predictor = Predictor(training, run)
        if not vibrating:
            predictor.nominal = prepare_run(
                robot, run, 0, ranged, replace(Settings(), cutoff=20.0), vibrating=False
            )
        found = predictor.predict(*extensions)
        for j in range(robot.n):
            moving = np.abs(record.clean[f"qd{j + 1}"]) >= MOVING
            left = found.torque[:, j] - record.clean[f"tau{j + 1}"]
            torque.append(left[moving] / case.robot.torque_noise[j])
            left = found.link_position[:, j] - record.clean[f"ql{j + 1}"]
            link.append(left / case.robot.link_noise)
    return [float(np.sqrt(np.mean(np.concatenate(part) ** 2))) for part in (torque, link)]


def _found(name, amplitudes, joint=None):
    effect = next(e for e in CATALOGUE if e.name == name)
    estimated = EstimatedEffect(
        located=LocatedEffect(effect=effect, joint=joint), amplitudes=amplitudes
    )
    return Extension(effects=(estimated,))


def _block(spec):
    """What the simulator put on the last link."""
    (line,) = simulated(spec).truth["effects"]
    mass, *place = (line["params"][name] for name in ("dm", "cx", "cy", "cz"))
    block = pin.Inertia.FromBox(mass, *line["law"]["edges"])
    return pin.Inertia(mass, np.array(place), block.inertia)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return str(tmp_path_factory.mktemp("resonant"))


def test_link_vibration_matches_simulator(folder):
    torque, link = _errors(HEALTHY, folder)
    slow_torque, slow_link = _errors(HEALTHY, folder, vibrating=False)
    assert torque < HALF
    assert link < 0.25
    assert slow_torque > 1.5 * torque
    assert slow_link > 2.0 * link


def test_link_vibration_starts_within_acceleration_phase(folder):
    torque, link = _errors(SHARP, folder)
    assert torque < 0.46
    assert link < 0.22


def test_link_vibration_is_independent_of_initial_linearisation(folder):
    """However soft or stiff they were taken to be first, links end with the same motion."""
    _, robot, runs, _ = _opened(SHARP, folder)
    run = prepare_run(robot, next(iter(runs.values())), 0, None, Settings())
    springs, slow = run.springs(), run.vibration.reference
    found = []
    for softer in (0.7, 1.0, 1.5):
        wrong = springs.linearise(run.links, np.full_like(run.signals.windup, softer))
        links = springs.solve(slow, replace(wrong, compliance_ratio=1.0), slow)
        for _ in range(2):
            links = springs.solve(links, springs.linearise(links), slow)
        found.append(links.position)
    assert np.sqrt(np.mean(np.ptp(found, axis=0) ** 2)) < SAME


def test_link_vibration_with_payload_is_slower(folder):
    found = _found("payload", tuple(_block(LOADED).toDynamicParameters()))
    torque, link = _errors(LOADED, folder, found)
    assert torque < HALF
    assert link < 0.25


def test_link_vibration_with_softer_spring_is_slower(folder):
    (line,) = simulated(SOFTER).truth["effects"]
    found = _found("stiffness_linear", (1.0 / line["params"]["factor"] - 1.0,), joint=1)
    torque, link = _errors(SOFTER, folder, found)
    assert torque < HALF
    assert link < 0.25


def test_added_inertia_matches_body(folder):
    _, robot, runs, ranged = _opened(LOADED, folder)
    run = prepare_run(robot, next(iter(runs.values())), 0, ranged, Settings())
    block = _block(LOADED)
    found = _found("payload", tuple(block.toDynamicParameters()))
    added = added_inertia(run, [found], every=100)
    model = robot.arm.model.copy()
    model.inertias[robot.n] += block
    for matrix, q in zip(added, run.signals.link_position[::100], strict=True):
        with_block = pin.crba(model, model.createData(), q)
        without = pin.crba(robot.arm.model, robot.arm.model.createData(), q)
        np.testing.assert_allclose(matrix, with_block - without, atol=1e-10)
