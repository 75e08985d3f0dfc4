"""Times in which something touches the arm: told, and no part of what is judged."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from shipped_set import LACKS, SHIPPED
from simulated_sets import diagnosed, said, short_case

from stiffopt.discovery.judging.episodes import ResidualTrack, find_episodes, training_tracks
from stiffopt.discovery.judging.held_out import HeldOutRuns
from stiffopt.discovery.judging.refutation import Refutation
from stiffopt.discovery.prediction import Predictor
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings
from stiffopt.report.diagnosis.mismatch import episode_sentences

RATE, SECONDS = 30.0, 10.0


def track(run="train_1", seed=0, role="train"):
    """Two joints that go to and fro in a run, with noise of unit size left in all channels."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(RATE * SECONDS)) / RATE
    phase = np.outer(time, [2.0, 2.9]) + rng.uniform(0.0, 6.0, 2)
    speed = np.cos(phase)
    return ResidualTrack(
        run=run,
        role=role,
        time=time,
        left=rng.standard_normal((len(time), 4)),
        unit=np.full(4, 0.1),
        velocity=speed,
        state=0.5 * np.stack([np.sin(phase), speed, np.sin(phase)], axis=2),
    )


def runs():
    return [track(f"train_{k}", k) for k in range(1, 5)]


def added(one, values, channels=(0, 1)):
    left = one.left.copy()
    for channel in channels:
        left[:, channel] += values
    return replace(one, left=left)


def bump(one, begin, end, size=40.0):
    inside = (one.time > begin) & (one.time < end)
    return size * np.where(inside, np.sin(np.pi * (one.time - begin) / (end - begin)), 0.0)


def test_push_is_found_with_run_times_joints_and_size():
    every = runs()
    every[1] = added(every[1], bump(every[1], 3.0, 4.0))
    (found,) = find_episodes(every)
    assert (found.run, found.joints) == ("train_2", (1, 2))
    assert found.begin == pytest.approx(3.0, abs=0.15)
    assert found.end == pytest.approx(4.0, abs=0.15)
    assert found.sizes == pytest.approx((4.0, 4.0), rel=0.15)
    assert not np.any(np.abs(every[1].left[~found.holds(every[1].time)]) > 5.0)


def test_noise_alone_has_no_contact():
    assert find_episodes(runs()) == ()


def test_drag_against_motion_is_no_contact():
    every = runs()
    brake = np.sign(every[1].velocity[:, 0]) * np.abs(bump(every[1], 2.0, 5.0))
    every[1] = added(every[1], brake, channels=(0,))
    assert find_episodes(every) == ()


def test_residual_recurring_with_state_is_no_contact():
    every = [
        added(one, np.where(one.state[:, 0, 0] > 0.45, 30.0, 0.0), channels=(0, 2))
        for one in runs()
    ]
    assert find_episodes(every) == ()


def test_residual_in_unvisited_states_is_no_contact():
    """A stop near the end of a stroke that one run alone reaches."""
    every = runs()
    one = every[1]
    crest = one.time[60 + np.argmax(one.state[60:-60, 0, 0])]
    state = one.state.copy()
    state[:, 0, 0] += bump(one, crest - 0.5, crest + 0.5, 0.2)
    pushed = added(one, bump(one, crest - 0.5, crest + 0.5), channels=(0,))
    # Where other parts have gone, the same is one.
    assert find_episodes([every[0], pushed, *every[2:]])
    assert find_episodes([every[0], replace(pushed, state=state), *every[2:]]) == ()


def test_residual_in_most_runs_is_no_contact():
    every = [added(one, bump(one, 2.0 + k, 3.0 + k)) for k, one in enumerate(runs())]
    assert find_episodes(every) == ()


def test_burst_is_no_contact():
    every = runs()
    every[0] = added(every[0], bump(every[0], 5.0, 5.1, 200.0))
    assert find_episodes(every) == ()


def test_held_out_run_is_compared_with_training_runs():
    test = track("test_1", 9, "test")
    (found,) = find_episodes([added(test, bump(test, 6.0, 6.8))], runs())
    assert (found.run, found.role) == ("test_1", "test")
    assert find_episodes([test], runs()) == ()


@cache
def opened(what):
    """Episodes and proof of the shipped test run, in which something begins at 0.75 of it."""
    recordings = load_recordings(SHIPPED)
    training = prepare_training(recordings, Settings())
    comparison = training.comparison()
    fit = comparison.fit([each.located for each in LACKS.effects])
    run = recordings.open(recordings.with_role("test")[0])
    predictor = Predictor(training, run)
    prepared = predictor.nominal
    signals, at = prepared.signals, np.searchsorted(prepared.time, run.time)
    motion = [
        values[np.clip(at, 0, len(prepared.time) - 1)]
        for values in (
            signals.motor_position, signals.motor_velocity, signals.motor_acceleration,
        )
    ]  # fmt: skip
    since = run.time > 0.75 * run.time[-1]
    until = run.time < 0.95 * run.time[-1]
    more = {
        "load": training.robot.body_torques(1, *motion)[:, :, 0] * 4.0 * since[:, None],
        "offset": np.outer(since, [8.0, 0.0]),
        "offset for a while": np.outer(since & until, [8.0, 0.0]),
    }[what]
    own = SimpleNamespace(
        with_role=lambda *_: [SimpleNamespace(file=run.file)],
        open=lambda _: replace(run, torque=run.torque + more),
    )
    untested = Refutation(comparison, (), {})
    held = HeldOutRuns(training, LACKS, (), untested, known=training_tracks(comparison, fit))
    held.predict_all(own, lambda _: None)
    return held


@pytest.mark.parametrize(
    ("what", "remains"), [("load", True), ("offset", False), ("offset for a while", False)]
)
def test_only_lasting_load_stays_in_proof(what, remains):
    held = opened(what)
    (found,), (proof,) = held.episodes, held.proofs
    assert found.stays == remains
    assert found.nrmse_with > 1.5 * found.nrmse_without
    judged = found.nrmse_with if remains else found.nrmse_without
    assert proof.nrmse_after == pytest.approx(judged)
    joints = (SimpleNamespace(prismatic=False),) * 2
    constants = SimpleNamespace(joints=joints)
    (line,) = episode_sentences(
        SimpleNamespace(training=SimpleNamespace(constants=constants), episodes=[found])
    )
    assert line.startswith(
        "Permanent change, as of a load, in " if remains else "Contact, load or offset in "
    )
    assert ("included in the validation" in line) == remains
    assert "times the noise with this interval" in line


TOUCHED = short_case(("touched", None, 1.0), seed=71)


@pytest.mark.slow
@pytest.mark.parametrize("effects", [(), (("coulomb", 1, 1.0),)])
def test_pushes_are_not_found_as_friction_or_weight(effects):
    spec = replace(TOUCHED, effects=(*TOUCHED.effects, *effects))
    found = diagnosed(spec)
    named = [(f.effect.name, f.joint) for f in found.findings]
    assert named == [(name, joint) for name, joint, _ in effects], said(found)
    assert [each.role for each in found.episodes] == ["train", "test"]
    lines = episode_sentences(found)
    assert lines[0].startswith("Contact, load or offset in train_")
    assert lines[1].startswith("Contact, load or offset in test_")
    assert found.episodes[1].nrmse_with > 2.0 * found.episodes[1].nrmse_without
    assert f"{found.episodes[1].nrmse_with:.2g} times the noise with this interval" in lines[1]
    assert found.nrmse("test")[1] < 1.3
