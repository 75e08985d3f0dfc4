"""Search in the simulation from commands."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from servo_sets import (
    COULOMB,
    DELAY,
    KP,
    STRIBECK_SPEED,
    WARMUP_SECONDS,
    commanded_motion,
    state_drive,
    write_servo_set,
)

from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.least_squares import Score
from stiffopt.closed_loop.polish import score_amplitudes
from stiffopt.discovery.catalogue import CATALOGUE, effect
from stiffopt.discovery.comparison.located_effect import (
    EstimatedEffect,
    Extension,
    LocatedEffect,
)
from stiffopt.discovery.extended.value_changes import extended_model
from stiffopt.discovery.judging.unexplained import Unexplained
from stiffopt.discovery.loop_search import LoopSearch, beyond_simulation, explained_joints
from stiffopt.discovery.position_fit import model_section, read_model
from stiffopt.discovery.sanity.actuator_estimate import resolve_actuator
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import EXPLAINED_SHARE
from stiffopt.discovery.training import open_training_runs, prepare_training
from stiffopt.recording.recording_set import load_recordings

RISE = 0.1  # [N m]


def add_servo(folder: Path) -> None:
    """Put a like servo with an encoder that waves in time before that of a set."""
    urdf, file = folder / "robot.urdf", folder / "recordings.toml"
    text = urdf.read_text()
    link = text[text.index('<link name="arm">') : text.index("</robot>")]
    other = link.replace('"arm"', '"arm0"').replace('"servo"', '"servo0"')
    urdf.write_text(text.replace("</robot>", other + "</robot>"))
    text = file.read_text().replace('joints = ["', 'joints = ["servo0", "')
    for name in ("present_position", "goal_position"):
        text = text.replace(f'["{name}"]', f'["{name}0", "{name}"]')
    text = re.sub(r"= \[([0-9.]+)\]", r"= [\1, \1]", text)
    file.write_text(text)
    for k, run in enumerate(sorted(folder.glob("run*.npz"))):
        columns = dict(np.load(run))
        time, command, position = commanded_motion(10 + k)
        wave = 0.004 * np.sin(4.8 * time) * np.sin(19.5 * time)
        own = {"goal_position0": command, "present_position0": position + wave}
        np.savez(run, **columns, **own)


def search(
    folder: Path,
    *,
    beside_another: bool = False,
    gain: float = KP,
    tolerance: float = 0.01,
    **physics: float,
) -> LoopSearch:
    """Return the search of a servo whose drive is stated but for some physics."""
    actuator = f"kp = [{gain}]\nkd = [0.0]\ntolerance = {tolerance}\ndelay = {DELAY}"
    write_servo_set(folder, actuator=actuator, runs=2, **physics)
    state_drive(folder)
    if beside_another:
        add_servo(folder)
    recordings = load_recordings(folder)
    own = resolve_actuator(recordings, open_training_runs(recordings))
    training = prepare_training(own.recordings, Settings(), None, lambda _: None, own.runs)
    asked = [each for each in CATALOGUE if each.family in ("friction", "geometry")]
    return LoopSearch(
        recordings=own.recordings,
        training=training,
        asked=asked,
        runs=own.runs,
        estimated=None,
        say=lambda _: None,
    )


def test_friction_at_low_speed_is_found_in_the_residual(tmp_path: Path) -> None:
    _, findings = search(tmp_path / "set", stribeck=RISE).run(Extension(), ())
    first = findings[0]
    assert (first.effect.name, first.joint) == ("stribeck", 1)
    assert first.certainty == "found"
    told = {each.name: each for each in first.parameters}
    assert 0.5 * RISE < told["A"].value < 2.0 * RISE
    speed = told["vs"]
    assert speed.sd is not None
    assert abs(speed.value - STRIBECK_SPEED) < 2.0 * speed.sd < 0.5 * STRIBECK_SPEED


@pytest.mark.slow
def test_a_joint_that_no_effect_explains_hides_no_other(tmp_path: Path) -> None:
    searched = search(tmp_path / "set", beside_another=True, stribeck=RISE)
    model, findings = searched.run(Extension(), ())
    assert model is not None
    # The joint that is explained leaves the simulation's own error.
    assert [*searched.recordings.robot.joint_names] == ["servo", "servo0"]
    np.testing.assert_array_equal(model.lacks, [False, True])
    assert [(each.effect.name, each.joint) for each in findings] == [("stribeck", 2)]


def test_effects_are_not_sought_where_torque_has_no_scale(tmp_path: Path) -> None:
    searched = search(tmp_path / "set", stribeck=RISE)
    law = searched.recordings.actuator
    assert law is not None
    guessed = replace(law, estimated=np.ones(1, dtype=bool), tolerance=np.ones(1))
    recordings = searched.recordings.with_actuator(guessed)
    model, findings = replace(searched, recordings=recordings).run(Extension(), ())
    assert model is not None
    assert model.lacks.all()
    assert not any(each.effect.name == "stribeck" for each in findings)


def test_a_finding_that_the_simulation_fits_as_well_without_is_refuted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even if its value is as likely as not."""
    monkeypatch.setattr(LoopSearch, "_judge", lambda _, model, findings: tuple(findings))
    searched = search(tmp_path / "set")
    located = LocatedEffect(effect=effect("stribeck"), joint=0, shapes=(0.1, 2.0))
    small = EstimatedEffect(located=located, amplitudes=(0.002,))
    found = Extension(effects=(small,))
    fitted = searched.fit(found)
    assert fitted.begins_with(found)
    likely = searched._finding(small, 0.4, 0.9)
    model, (judged,) = searched.run(found, [likely], fitted)
    assert model is not None
    assert model.without == (located.label,)
    assert judged.certainty == "possible"


def test_torques_count_as_explained_where_the_simulation_leaves_less_than_them(
    tmp_path: Path,
) -> None:
    searched = search(tmp_path / "set", stribeck=RISE)
    model = searched.fit(Extension()).model
    assert model is not None
    assert model.lacks.all()
    runs = [SimpleNamespace(low_pass=SimpleNamespace(noise_gain=0.5))]
    comparison = SimpleNamespace(
        rows=SimpleNamespace(runs=runs), noise=SimpleNamespace(torque=np.array([0.2]))
    )
    told = []
    for factor in (0.5, 2.0):
        least = model.left_torque / np.sqrt(1.0 - EXPLAINED_SHARE) / (0.5 * 0.2)
        result: Any = SimpleNamespace(comparison=comparison, after=factor * least)
        told.append(explained_joints(searched.recordings, model, result))
    assert told == [(), (0,)]
    open_torque = Unexplained(("torque_1",), (), None, 0.5, 10.0)
    assert beyond_simulation(open_torque, ()) is open_torque
    assert beyond_simulation(open_torque, (0,)) is None


def test_findings_that_make_the_loop_unstable_are_searched_without(tmp_path: Path) -> None:
    located = LocatedEffect(effect=effect("cable_spring"), joint=0, shapes=(0.0,))
    pushing = EstimatedEffect(located=located, amplitudes=(-400.0, 0.0))
    _, findings = search(tmp_path / "set", stribeck=RISE).run(Extension(effects=(pushing,)), ())
    assert [each.effect.name for each in findings] == ["stribeck"]


def test_effects_with_which_the_simulation_diverges_hide_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched = search(tmp_path / "set", stribeck=RISE)
    model = searched.fit(Extension()).model
    assert model is not None
    # Springs of backlash change what the others are scored beside.
    every = searched._candidates(0, ())
    candidates = [each for each in every if each.effect.family == "friction"]
    expected = searched._scores(model, Extension(), candidates, 0)
    assert sum(each is not None for each in expected) > 3
    wild = next(k for k, each in enumerate(expected) if each is not None)

    def score(loop: CommandedArm, *given: Any) -> list[Score | None]:
        if any(key == candidates[wild].key for key, _ in loop.physics.amplitudes.names):
            raise FloatingPointError
        return score_amplitudes(loop, *given)

    monkeypatch.setattr("stiffopt.discovery.loop_search.score_amplitudes", score)
    found = searched._scores(model, Extension(), candidates, 0)
    assert found[wild] is None
    for k, (own, other) in enumerate(zip(found, expected, strict=True)):
        if own is not None and other is not None:
            assert own.evidence == pytest.approx(other.evidence, rel=1e-6)
        else:
            assert k == wild or own is other is None


@pytest.mark.parametrize(
    ("physics", "changed", "certainty"),
    [
        ({"warmup": 0.1}, 0.1, "found"),
        ({"warmup": -0.06}, -0.06, "found"),
        ({"warmup": 0.1}, 0.5, "possible"),
        ({"stribeck": 0.1}, 0.1, "possible"),
        ({}, 0.1, "possible"),
    ],
)
def test_an_effect_with_memory_is_refuted_where_the_simulation_leaves_less_than_it(
    tmp_path: Path, physics: dict[str, float], changed: float, certainty: str
) -> None:
    """Most of friction that changes within a run is dry friction, which every simulation fits."""
    searched = search(tmp_path / "set", **physics)
    model = searched.fit(Extension()).model
    assert model is not None
    assert model.lacks.all() == bool(physics)
    located = LocatedEffect(effect=effect("friction_warmup"), joint=0, shapes=(WARMUP_SECONDS,))
    estimated = EstimatedEffect(located=located, amplitudes=(changed, 0.0))
    (judged,) = searched._judge(model, [searched._finding(estimated, 0.6)])
    assert judged.certainty == certainty


def test_nothing_is_found_where_the_simulation_leaves_noise(tmp_path: Path) -> None:
    own = search(tmp_path / "set")
    model, findings = own.run(Extension(), ())
    assert model is not None
    assert not model.lacks.any()
    assert findings == ()


def test_a_stored_simulation_is_read_without_the_effects_that_it_is_without(tmp_path: Path) -> None:
    searched = search(tmp_path / "set")
    located = LocatedEffect(effect=effect("cable_spring"), joint=0, shapes=(0.0,))
    spring = EstimatedEffect(located=located, amplitudes=(0.001, 0.0))
    whole = Extension(effects=(spring,))
    model, _ = searched.run(whole, (searched._finding(spring, 1.0),))
    assert model is not None
    assert model.without == (located.label,)
    recordings, constants = searched.recordings, searched.training.constants
    section = model_section(recordings, model)
    stored = replace(extended_model(recordings, constants, whole), closed_loop=section)
    read = read_model(recordings, stored)
    np.testing.assert_allclose(read.fitted.values, model.fitted.values)


def test_a_size_is_that_of_the_simulation(tmp_path: Path) -> None:
    """Filtered torques told a spring where there is none."""
    searched = search(tmp_path / "set")
    located = LocatedEffect(effect=effect("cable_spring"), joint=0, shapes=(0.0,))
    spring = EstimatedEffect(located=located, amplitudes=(0.1, 0.0))
    model = searched._fit(Extension(effects=(spring,)))
    assert model is not None
    (sizes, spread) = (x[model.fitted.amplitudes] for x in (model.fitted.values, model.deviations))
    assert len(sizes) == 3  # of the two amplitudes, and the centre of the range
    np.testing.assert_array_less(np.abs(sizes), 4.0 * spread + 1e-3)


def test_friction_that_vanishes_is_replaced_by_what_loses_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As far as the fit with its cause leaves less, over four stretches of 2 s."""
    searched = replace(search(tmp_path / "set"), asked=[effect("output_backlash")])
    less = EstimatedEffect(
        located=LocatedEffect(effect=effect("coulomb"), joint=0), amplitudes=(-COULOMB,)
    )
    found = Extension(effects=(less,))
    fitted = searched._fit(found)
    assert fitted is not None
    fitted.fitted.values[fitted.fitted.place("coulomb")] = 0.0
    assert fitted.polished is not None
    model, better = (
        replace(
            fitted,
            noise_ratio=np.array([ratio]),
            polished=replace(fitted.polished, residual=ratio * fitted.polished.noise),
        )
        for ratio in (3.0, 2.0)
    )
    claimed = searched._finding(less, 0.4)
    monkeypatch.setattr(LoopSearch, "_fit", lambda *_: better)
    left, _, (own,) = searched._replace_losses(model, found, [claimed])
    assert left is better
    assert (own.effect.name, own.rivals[0].located) == ("output_backlash", less.located)
    assert own.probability == pytest.approx(1.0 / (1.0 + 1.5**-4.0), rel=0.01)
    quiet = replace(model, noise_ratio=np.array([1.0]))
    assert searched._replace_losses(quiet, found, [claimed])[2] == (claimed,)


def test_a_stated_value_that_the_simulation_moves_beyond_its_tolerance_is_named(
    tmp_path: Path,
) -> None:
    """Here the search of filtered torques has not named it."""
    more = 0.06
    _, findings = search(tmp_path / "set", coulomb=COULOMB + more).run(Extension(), ())
    (first,) = findings
    assert first.effect.name == "coulomb"
    assert first.certainty == "found"
    (value,) = first.parameters
    assert value.sd is not None
    assert abs(value.value - more) < 2.0 * value.sd < 0.5 * more


@pytest.mark.parametrize(("deviations", "named"), [(2.0, []), (3.7, ["coulomb"])])
def test_a_stated_value_is_named_where_no_stated_value_lies_by_chance(
    tmp_path: Path, deviations: float, named: list[str]
) -> None:
    """The tolerance of the set is 5 %."""
    coulomb = COULOMB * (1.0 + 0.05 * deviations)
    _, findings = search(tmp_path / "set", coulomb=coulomb).run(Extension(), ())
    assert [each.effect.name for each in findings] == named


def test_a_stated_gain_that_is_wrong_is_the_gain_of_the_loop(tmp_path: Path) -> None:
    """Three quarters of the true gain are stated: torque by it reads a quarter too little."""
    searched = search(tmp_path / "set", gain=0.75 * KP, tolerance=0.05)
    model, (first,) = replace(searched, asked=[effect("torque_gain")]).run(Extension(), ())
    assert model is not None
    assert first.effect.name == "torque_gain"
    assert first.parameters[0].value == pytest.approx(-0.25, abs=0.02)
    again = searched._fit(Extension(effects=(first.estimated,)))
    assert again is not None
    np.testing.assert_allclose(again.fitted.of("gain"), model.fitted.of("gain"), atol=0.01)


def test_a_limit_is_told_where_a_fit_without_it_strains_all_others(tmp_path: Path) -> None:
    limit = 1.6
    searched = search(tmp_path / "set", limit=limit)
    _, findings = replace(searched, asked=[effect("saturation")]).run(Extension(), ())
    assert [each.effect.name for each in findings] == ["saturation"]
    (told,) = findings[0].parameters
    assert told.sd is not None
    assert abs(told.value - limit) < 2.0 * told.sd < 0.1 * limit
