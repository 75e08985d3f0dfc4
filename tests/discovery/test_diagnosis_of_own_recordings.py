"""Recordings that an extended model was made from, or like them: nothing has changed since."""

from dataclasses import replace

import numpy as np
import pytest
from swivel_sets import recorded, swivel_model

from stiffopt.discovery import opening
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.extended.model import load_extended
from stiffopt.recording.recording_set import load_recordings
from stiffopt.report.diagnosis.regimes import channel_residuals
from stiffopt.report.diagnosis.sections import print_diagnosis
from stiffopt.report.diagnosis.words import headline, paragraph

# What the joint's own recordings leave, as unfiltered noise [N m].
OPEN = 2.28
MODEL = swivel_model(OPEN, link="arm", rated=30.0)
RIPPLE = """[[effect]]
name = "rotor_ripple"
joint = 1
term = { sin = 0.1, cos = 0.1, waves = 4.0 }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return with_waves(tmp_path_factory.mktemp("swivel"))


def with_waves(folder, step=0.01):
    """A joint with a torque that no entry of the catalogue has, and a model that leaves it open."""
    return recorded(folder, lambda q: 1.5 * np.sin(23.0 * q), MODEL, step=step)


@pytest.fixture(scope="module")
def again(folder):
    return diagnose(folder, model=folder / "extended.toml", experiment=False)


def test_open_residual_of_model_is_no_finding(again, tmp_path, capsys):
    assert again.search.after[0] > 5.0
    assert again.verdict == "nothing_missing"
    print_diagnosis(again, tmp_path)
    said = " ".join(capsys.readouterr().out.split())
    assert "Nothing has changed since the model; it leaves" in said
    assert "unexplained in the torque of joint 1" in said
    assert headline(again).startswith("Nothing has changed since the model; it leaves")
    assert "tolerances" not in paragraph(again)


def test_residual_above_open_residual_is_reported(folder):
    little = load_extended(folder / "extended.toml")
    section = little.left_open.model_copy(update={"torque": (0.3,)})
    found = diagnose(folder, model=replace(little, left_open=section), experiment=False)
    assert found.verdict != "nothing_missing"


def test_residual_slightly_above_open_residual_is_ignored(folder):
    """Between the ratios from which a remainder is faint and large."""
    model = load_extended(folder / "extended.toml")
    section = model.left_open.model_copy(update={"torque": (OPEN / 1.15,)})
    found = diagnose(folder, model=replace(model, left_open=section), experiment=False)
    assert found.verdict == "nothing_missing"


def test_assumptions_match_noise_and_bands(again):
    said = "\n".join(again.assumptions)
    assert "wide defaults" not in said
    assert not any(each.startswith("nominal.coulomb") for each in again.assumptions)
    assert "values of the model are fixed: mass, com" in said
    assert f"The model's open residual of torques counts as noise (joint 1: {OPEN} N m)." in said
    assert "up to 12 Hz, predicted torques up to (joint 1: 20) Hz: bands of the model." in said
    assert "nominal.gear_ratio is not given" in said


def test_initial_residuals_use_stated_noise(again):
    rows = channel_residuals(again, "torque_1")
    ratio = np.sqrt(np.mean((rows.before / rows.noise) ** 2))
    assert ratio == pytest.approx(again.search.before[0])


@pytest.mark.parametrize(("more", "taken"), [("", True), (RIPPLE, False)])
def test_pole_pairs_are_adopted_without_rotor_ripple(folder, tmp_path, more, taken):
    """The set gives them, its model does not."""
    recordings = load_recordings(folder, ["nominal.pole_pairs=4", "nominal.gear_ratio=[100]"])
    path = tmp_path / "extended.toml"
    path.write_text(MODEL.replace("[nominal]", "[nominal]\ngear_ratio = [100.0]") + more)
    poles = load_extended(path).applied_to(recordings).nominal.pole_pairs
    assert (poles is not None) == taken


@pytest.mark.parametrize("stated", ["", "\nnoise.torque = [0.1]"])
def test_open_residual_is_independent_of_decimation(tmp_path, monkeypatch, stated):
    """A long set is compared by means of a few samples, a further one may be too short for that."""
    source = with_waves(tmp_path, step=0.002)
    text = (source / "recordings.toml").read_text().replace('"swivel"\n', f'"swivel"{stated}\n', 1)
    (source / "recordings.toml").write_text(text)
    model, left = load_extended(source / "extended.toml"), []
    # At five times the rate the same torque is more noise of a sample.
    section = model.left_open.model_copy(update={"sampling_rate": 100.0})
    for every in (1, 3):
        monkeypatch.setattr(opening, "decimation_factor", lambda runs, every=every: every)
        found = diagnose(source, model=replace(model, left_open=section), experiment=False)
        assert found.verdict == "nothing_missing"
        left.append(found.left_open.torque[0])
        assert found.left_open.sampling_rate == pytest.approx(500.0)
    assert left[1] == pytest.approx(left[0], rel=0.05)
    # Told as noise of what is compared.
    assert f"counts as noise (joint 1: {(5.0 / 3.0) ** 0.5 * OPEN:.3g} N m)" in str(
        found.assumptions
    )
