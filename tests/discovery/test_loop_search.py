"""Search in the simulation from commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from servo_sets import ARMATURE, COULOMB, DELAY, KP, STRIBECK_SPEED, VISCOUS, write_servo_set

from stiffopt.discovery.catalogue import CATALOGUE, effect
from stiffopt.discovery.comparison.located_effect import (
    EstimatedEffect,
    Extension,
    LocatedEffect,
)
from stiffopt.discovery.loop_search import LoopSearch
from stiffopt.discovery.sanity.actuator_estimate import resolve_actuator
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import open_training_runs, prepare_training
from stiffopt.recording.recording_set import load_recordings

RISE = 0.1  # [N m]


def search(folder: Path, **physics: float) -> LoopSearch:
    """Return the search of a servo whose drive is stated but for some physics."""
    actuator = f"kp = [{KP}]\nkd = [0.0]\ntolerance = 0.01\ndelay = {DELAY}"
    write_servo_set(folder, actuator=actuator, runs=2, **physics)
    file = folder / "recordings.toml"
    stated = {"coulomb": COULOMB, "viscous": VISCOUS, "rotor_inertia": ARMATURE}
    lines = ["[nominal]", *(f"{key} = [{value}]" for key, value in stated.items())]
    lines += ["[tolerance]", "mass = 0.01", "com = 0.001", *(f"{key} = 0.05" for key in stated)]
    text = file.read_text()
    file.write_text(text.replace("[actuator]", "\n".join([*lines, "[actuator]"])))
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
    assert 0.5 * STRIBECK_SPEED < told["vs"].value < 2.5 * STRIBECK_SPEED


def test_nothing_is_found_where_the_simulation_leaves_noise(tmp_path: Path) -> None:
    own = search(tmp_path / "set")
    model, findings = own.run(Extension(), ())
    assert model is not None
    assert not model.lacks.any()
    assert findings == ()


def test_a_size_is_that_of_the_simulation(tmp_path: Path) -> None:
    """Filtered torques told a spring where there is none."""
    searched = search(tmp_path / "set")
    located = LocatedEffect(effect=effect("cable_spring"), joint=0, shapes=(0.0,))
    spring = EstimatedEffect(located=located, amplitudes=(0.1, 0.0))
    model = searched._fit(Extension(effects=(spring,)))
    assert model is not None
    (sizes, spread) = (x[model.fitted.amplitudes] for x in (model.fitted.values, model.deviations))
    assert len(sizes) == 2
    np.testing.assert_array_less(np.abs(sizes), 4.0 * spread + 1e-3)


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
