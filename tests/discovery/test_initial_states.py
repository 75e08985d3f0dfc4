"""Initial vibration of runs, and bursts of drives that it must not be taken for."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_sets import COULOMB, simulated

from benchmarks.simulator import write_case
from stiffopt.discovery.comparison.initial_states import estimate_initial_states, with_initial_state
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.judging.bursts import find_bursts
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import BURST_RATIO
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

pytestmark = pytest.mark.slow

# Of the first run, where both joints move, and a later instant [s].
BEGIN, LATER = 1.0, 3.0
# Over noise.
SIZE = 30.0


@pytest.fixture(scope="module")
def begun_moving(tmp_path_factory):
    """Training of a set with nothing missing whose first run begins while its joints move."""
    folder = write_case(
        simulated(replace(COULOMB, effects=())), tmp_path_factory.mktemp("begun") / "set"
    )
    file = folder / "train_1.npz"
    with np.load(file) as columns:
        late = columns["t"] >= BEGIN
        cut = {name: columns[name][late] for name in columns.files}
    np.savez(file, **cut)
    return prepare_training(load_recordings(folder), Settings())


def vibrating(training, begin, *, links=False):
    """The training with a free swing of the lowest mode in the first run, from an instant on.

    In the torque, and where told so in the link encoders.
    """
    run = training.runs[0]
    shape = run.vibration.response.modes(0)[1][:, 0]
    torque, deflection = run.vibration.free_vibration(np.append(shape, 0.0 * shape)[:, None])
    size = SIZE * training.noise.channels.torque[0] / abs(torque[0, 0, 0])
    late = np.searchsorted(run.time, begin)
    added, wound = np.zeros((2, *run.torque.shape))
    added[late:] = size * torque[: len(added) - late, :, 0]
    wound[late:] = size * deflection[: len(added) - late, :, 0]
    shaken = replace(run, torque=run.torque + added)
    if links:
        shaken = replace(shaken, deflection=run.deflection + wound)
    return replace(training, runs=(shaken, *training.runs[1:]))


def test_bursts_exclude_initial_vibration(begun_moving):
    assert find_bursts(vibrating(begun_moving, BEGIN), Extension()) is None


def test_bursts_include_vibration_without_cause(begun_moving):
    found = find_bursts(vibrating(begun_moving, LATER), Extension())
    assert found is not None
    assert found.channels[0] in ("torque_1", "torque_2")


def test_bursts_exclude_measured_link_vibration(begun_moving):
    """Their encoders show what the torque shows: the arm swings otherwise than modelled."""
    assert find_bursts(vibrating(begun_moving, LATER, links=True), Extension()) is None


def test_bursts_of_the_starting_model_are_not_reported(begun_moving):
    shaken = vibrating(begun_moving, LATER)
    ratio = find_bursts(shaken, Extension()).ratio
    least = np.full(4, 0.5 * ratio / BURST_RATIO)
    assert find_bursts(replace(shaken, least=least), Extension()).ratio == pytest.approx(
        2.0 * BURST_RATIO
    )
    assert find_bursts(replace(shaken, least=4.0 * least), Extension()) is None


@pytest.fixture(scope="module")
def heavy(tmp_path_factory):
    """Training of an arm whose lowest mode lies within a fit's band."""
    case = simulated(replace(COULOMB, effects=(), payload=4.0))
    return prepare_training(
        load_recordings(write_case(case, tmp_path_factory.mktemp("heavy"))), Settings()
    )


def shown(training, run):
    """The run as links show it that begin in a swing of two modes, and their true signals."""
    state = 0.7 * run.initial_states()[:, 0] + 0.7 * run.initial_states()[:, 1]
    true = with_initial_state(run, state).signals
    read = replace(
        run,
        torque=run.torque + true.drive_torque - run.signals.drive_torque,
        deflection=run.deflection + run.signals.link_position - true.link_position,
    )
    return read, true


def test_initial_states_recover_vibration_of_a_run(heavy):
    """Springs bend: what a start makes is no free swing of the model."""
    run, *others = heavy.runs
    read, true = shown(heavy, run)
    found, *_ = estimate_initial_states(heavy.comparison().with_runs((read, *others)))
    off = run.signals.link_position - true.link_position
    assert np.std(found.signals.link_position - true.link_position) < 0.15 * np.std(off)


def test_initial_states_without_gain_leave_runs_unchanged(heavy):
    assert estimate_initial_states(heavy.comparison()) == heavy.runs


def test_initial_states_ignore_missing_effects(heavy):
    """Beside a friction that nobody told, a start explains a little of what is left."""
    run, *others = heavy.runs
    read, _ = shown(heavy, run)
    rubbing = 40.0 * heavy.noise.channels.torque * np.sign(run.signals.motor_velocity)
    runs = (replace(read, torque=read.torque + rubbing), *others)
    assert estimate_initial_states(heavy.comparison().with_runs(runs)) == runs
