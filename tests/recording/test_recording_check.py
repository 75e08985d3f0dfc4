"""The check of a set: its numbers against the simulation, its verdicts against what is there."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_sets import motion

from stiffopt.discovery.effect import NEEDS
from stiffopt.discovery.identifiable import EffectCheck, effect_checks
from stiffopt.recording.channel import noise_level, resolution
from stiffopt.recording.channel_faults import regress_changes
from stiffopt.recording.check import RecordingReport, check_recordings
from stiffopt.recording.recording_set import load_recordings
from stiffopt.report.recording_check import report_lines

MakeSet = Callable[..., Path]


def check(folder: Path) -> RecordingReport:
    return check_recordings(load_recordings(folder))


def effects_of(folder: Path) -> tuple[EffectCheck, ...]:
    recordings = load_recordings(folder)
    report = check_recordings(recordings)
    return effect_checks(recordings, report.facts, report.training_runs)


def possible(checks: Sequence[EffectCheck], effect: str) -> list[int | None]:
    return [c.joint for c in checks if c.effect.name == effect and c.possible]


def why(checks: Sequence[EffectCheck], effect: str, joint: int | None) -> tuple[str, ...]:
    return next(c.lacks for c in checks if (c.effect.name, c.joint) == (effect, joint))


def test_check_reports_numbers_of_a_run(make_set: MakeSet) -> None:
    run = check(make_set()).runs[0]
    assert (run.samples, run.role, run.usable) == (2500, "train", True)
    assert run.duration == pytest.approx(9.996)
    assert run.rate == pytest.approx(250.0)
    assert run.jitter == pytest.approx(0.0, abs=1e-12)
    channels = {channel.column: channel for channel in run.channels}
    assert list(channels) == ["q1", "q2", "qd1", "qd2", "ql1", "tau1", "tau2"]
    assert channels["tau1"].noise == pytest.approx(0.05, rel=0.1)
    assert channels["tau1"].stated_noise == 0.05
    assert channels["qd1"].noise == pytest.approx(1e-3, rel=0.1)
    assert channels["qd1"].stated_noise is None
    assert channels["ql1"].noise == pytest.approx(1e-5, rel=0.1)
    assert channels["q2"].step == pytest.approx(1e-6, rel=1e-6)
    assert (channels["q1"].unit, channels["q2"].unit) == ("rad", "m")
    assert (channels["tau1"].unit, channels["tau2"].unit) == ("N m", "N")
    q1 = motion(seed=1)["q1"]
    assert channels["q1"].used == pytest.approx(np.ptp(q1) / 6.0)
    assert channels["qd1"].used == pytest.approx(2.05 / 4.0, rel=0.02)


def test_identifiable_effects_with_and_without_link_encoder(make_set: MakeSet) -> None:
    folder = make_set()
    report, checks = check(folder), effects_of(folder)
    assert report.balances == (("motor", "link", "deflection"), ("torque",))
    for effect in ("coulomb", "viscous", "rotor_inertia", "inertial_error", "cable_spring"):
        assert possible(checks, effect) == [1, 2]
    for effect in ("backlash", "stiffness_linear", "preload_loss"):
        assert possible(checks, effect) == [1]
        assert why(checks, effect, 2) == (NEEDS["windup"].missing,)
    assert why(checks, "encoder_offset", 2) == (NEEDS["link"].missing,)
    for effect in ("payload", "base_tilt", "external_contact", "time_delay", "encoder_skew"):
        assert possible(checks, effect) == [None]
    assert "equally warm" in why(checks, "thermal_friction", 1)[0]
    assert why(checks, "torque_ripple", 1) == ("nominal.pole_pairs is not given",)
    assert why(checks, "encoder_zero_change", 1) == ("there is only one training run",)
    assert why(checks, "wrist_coupling", 1) == ("there is no joint before it",)
    assert any(s.startswith("No link_position of joints 2") for s in report.missing)
    assert any("three training runs" in s for s in report.missing)


def test_test_runs_do_not_make_effects_identifiable(make_set: MakeSet) -> None:
    """Only training runs are fitted to: warmth seen in a test run teaches nothing."""
    warm = ('role = "test"', 'role = "test"\nsession_time = 3600.0')
    assert possible(effects_of(make_set(warm)), "thermal_friction") == []
    warm = ('role = "test"', 'role = "train"\nsession_time = 3600.0')
    folder = make_set(warm)
    assert possible(effects_of(folder), "thermal_friction") == [1, 2]
    assert any("role test" in s for s in check(folder).missing)


def test_unsuitable_motions_make_effects_unidentifiable(make_set: MakeSet) -> None:
    data = motion()
    t = data["t"]
    rng = np.random.default_rng(1)
    data["q1"] = -1.0 + 0.2 * t
    data["qd1"] = 0.2 + 1e-4 * rng.normal(size=len(t))
    data["ql1"] = data["q1"] + 1e-5 * rng.normal(size=len(t))
    data["q2"] = 0.1 + 1e-6 * rng.integers(-1, 2, len(t))
    data["qd2"] = np.zeros_like(t)
    checks = effects_of(make_set(one=data))
    assert any("one direction only" in each for each in why(checks, "coulomb", 1))
    assert why(checks, "viscous", 1) == ("it moves at one speed only",)
    assert any("(0.005 to 0.1 rad/s)" in each for each in why(checks, "stribeck", 1))
    assert why(checks, "coulomb", 2) == ("it does not move",)
    assert possible(checks, "rotor_inertia") == [1]


def test_gravity_that_never_changes_sign_hides_backlash(make_set: MakeSet) -> None:
    assert possible(effects_of(make_set()), "backlash") == [1]
    data = motion()
    data["q1"] = data["q1"] + 1.4
    data["ql1"] = data["ql1"] + 1.4
    checks = effects_of(make_set(one=data))
    assert why(checks, "backlash", 1) == (
        "neither gravity nor inertia changes the sign of its load",
    )
    assert possible(checks, "stiffness_linear") == [1]


def test_inertial_load_changes_sign_where_gravity_does_not(make_set: MakeSet) -> None:
    """A backlash that shows there must be able to stand beside what looks like it."""
    data = motion()
    for turns, told in ((1.0, []), (15.0, [1])):
        moved = 0.5 + 0.2 * np.sin(turns * data["t"])
        one = {**data, "q1": moved, "ql1": moved, "qd1": 0.2 * turns * np.cos(turns * data["t"])}
        assert possible(effects_of(make_set(one=one)), "backlash") == told


def test_velocity_noise_is_no_change_of_load_sign(make_set: MakeSet) -> None:
    data, rng = motion(), np.random.default_rng(1)
    data["q1"] = data["ql1"] = 1.3 + 0.2 * np.sin(data["t"])
    data["qd1"] = 0.2 * np.cos(data["t"]) + 0.002 * rng.normal(size=len(data["t"]))
    assert possible(effects_of(make_set(one=data)), "backlash") == []


def test_faulty_channel_makes_its_effects_unidentifiable(make_set: MakeSet) -> None:
    data = motion()
    data["ql1"] = np.zeros_like(data["t"])
    folder = make_set(one=data)
    report, checks = check(folder), effects_of(folder)
    assert report.balances[0] == ("torque",)
    assert possible(checks, "backlash") == []
    channel = next(c for c in report.runs[0].channels if c.column == "ql1")
    assert not channel.there
    text = "\n".join(report_lines(report, checks))
    assert "ql1 (link_position of joint 1): left out" in text
    assert "! link_position of joint 1: stays at 0" in text


def test_text_and_json_agree(make_set: MakeSet) -> None:
    folder = make_set()
    report, checks = check(folder), effects_of(folder)
    data = json.loads(json.dumps(report.as_dict(), allow_nan=False))
    assert [run["name"] for run in data["runs"]] == ["one", "two"]
    found = {(e["effect"], e["joint"]): e["possible"] for e in (c.as_dict() for c in checks)}
    assert found[("backlash", 1)]
    assert not found[("backlash", 2)]
    text = "\n".join(report_lines(report, checks))
    assert "one.npz (train): 2500 samples, 9.996 s, 250 Hz" in text
    assert f"backlash: joint 1; not 2 ({NEEDS['windup'].missing})" in text
    assert "coulomb: joints 1, 2" in text
    for sentence in (*report.missing, *report.assumptions):
        assert sentence in text


@settings(max_examples=40, deadline=None)
@given(st.floats(1e-7, 10.0), st.integers(5, 3000), st.integers(0, 99))
def test_resolution_of_counts_is_found(step: float, levels: int, seed: int) -> None:
    values = step * np.random.default_rng(seed).integers(-levels, levels, 4000)
    found = resolution(values + 17.0 * step)
    assert found == pytest.approx(step, rel=1e-3)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 99))
def test_unquantised_numbers_have_no_resolution(seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=4000)
    assert resolution(values) is None
    assert resolution(np.full(10, 3.0)) is None


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-4, 1e-2), st.integers(0, 99))
def test_noise_level_ignores_motion_and_jumps(level: float, seed: int) -> None:
    t = np.arange(5000) / 500.0
    noise = level * np.random.default_rng(seed).normal(size=5000)
    values = np.sin(5.0 * t) + np.sign(np.sin(3.0 * t)) + noise
    assert noise_level(values) == pytest.approx(level, rel=0.1)


def test_slope_between_sensors_ignores_offsets_and_gaps() -> None:
    t = np.concatenate([np.arange(0.0, 3.0, 0.01), np.arange(5.0, 8.0, 0.01)])
    one = np.sin(2.0 * t)
    two = 0.7 * one + np.where(t > 4.0, 9.0, -2.0)
    slope, correlation = regress_changes(one, two, t)
    assert slope == pytest.approx(0.7)
    assert correlation == pytest.approx(1.0)


def test_elastic_model_makes_wind_up_observable_in_torque(make_set: MakeSet) -> None:
    given = "coulomb = [1.0, 2.0]"
    sprung = f"{given}\njoint_damping = [1.0, 20.0]\ncontact_stiffness = [1e4, 1e6]"
    checks = effects_of(make_set((given, sprung)))
    for effect in ("hysteresis", "stiffness_linear", "joint_damping"):
        assert possible(checks, effect) == [1, 2]
    # The second slides: what only a link encoder reads needs one.
    assert possible(checks, "encoder_offset") == [1]
    # A torque carries its share of what couples it, also where links are in balance.
    assert possible(effects_of(make_set()), "wrist_coupling") == [2]
