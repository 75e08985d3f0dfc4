"""From a set to an answer: the three verdicts, and that held-out runs decide nothing."""

import re
from dataclasses import replace

import numpy as np
import pytest
from diagnosed_folders import answered, columns_of, command, copied
from simulated_sets import COULOMB, diagnosed, said
from test_answer_store import conforms

from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.store import answer_document
from stiffopt.recording.recording_set import RecordingSet, load_recordings
from stiffopt.report.diagnosis.words import unexplained_sentence

pytestmark = pytest.mark.slow

NOTHING = replace(COULOMB, effects=())
OUTSIDE = replace(COULOMB, effects=(("pulsing_load", 1, 2.0),))
SLOW_DRIVE = replace(COULOMB, effects=(("slew_limit", 2, 1.5),))


def test_nominal_model_within_tolerance_has_no_findings():
    diagnosis = diagnosed(NOTHING)
    assert diagnosis.verdict == "nothing_missing", said(diagnosis)
    assert diagnosis.findings == ()
    document = answer_document(diagnosis)
    conforms(document)
    assert document["outside"] is None
    # What is detectable: friction of every joint, in numbers below its nominal value.
    limits = {(e["effect"], e["joint"]): e["value"] for e in document["detection_limits"]}
    for joint, nominal in enumerate(diagnosis.recordings.robot.coulomb, 1):
        assert 0.0 < limits["coulomb", joint] < nominal


def test_unexplained_residual_is_outside_catalogue():
    diagnosis = diagnosed(OUTSIDE)
    assert diagnosis.verdict == "outside_catalogue", said(diagnosis)
    document = answer_document(diagnosis)
    conforms(document)
    assert "torque_1" in document["outside"]["channels"]
    assert document["outside"]["regressors"]
    assert document["outside"]["gain_heldout"] > 0.0


def test_torque_rate_limit_shows_as_bursts():
    diagnosis = diagnosed(SLOW_DRIVE)
    assert diagnosis.verdict == "outside_catalogue", said(diagnosis)
    assert diagnosis.unexplained.brief
    assert diagnosis.unexplained.channels == ("torque_2",)
    assert diagnosis.unexplained.regressors == ("dtorque_2",)
    assert diagnosis.unexplained.ratio > 1.5
    assert "limits the rate of its torque" in unexplained_sentence(diagnosis)


@pytest.fixture(scope="module")
def disturbed(tmp_path_factory):
    """The same set with other torques in every held-out run, and what is said about it."""
    source = copied(COULOMB, tmp_path_factory.mktemp("disturbed") / "set")
    for file in source.glob("*.npz"):
        if file.stem.startswith("train"):
            continue
        columns = columns_of(file)
        for name in ("tau1", "tau2"):
            columns[name] = 3.0 * columns[name][::-1] + 5.0
        np.savez_compressed(file, **columns)
    return command(source)


def test_torque_of_held_out_runs_refutes_findings_and_changes_nothing_else_of_them(disturbed):
    first, second = answered(COULOMB).document, disturbed.document
    assert second["fit"] != first["fit"]
    # What is said about the held-out runs themselves follows their channels.
    for key in ("fit", "mismatch", "runs", "faults"):
        del first[key], second[key]
    for found, refuted in zip(first["findings"], second["findings"], strict=True):
        assert found.pop("held_out_ratio") < 1.0 < refuted.pop("held_out_ratio")
        assert refuted.pop("probability") < 0.5 < found.pop("probability")
        assert (found.pop("certainty"), refuted.pop("certainty")) == ("found", "possible")
        for rivals in (found.pop("confused_with"), refuted.pop("confused_with")):
            assert not rivals
    # So does all that follows from a probability.
    assert (first.pop("verdict"), second.pop("verdict")) == ("named", "outside_catalogue")
    for document in (first, second):
        del document["to_do"], document["next_experiment"]
        for each in document["changed_values"]:
            del each["cause"]
    assert first == second
    models = [(each.out / "extended.toml").read_text() for each in (answered(COULOMB), disturbed)]
    one, other = (re.sub(r"probability = [\d.e-]+", "", each) for each in models)
    assert models[0] != models[1]
    assert one == other


def test_torque_of_held_out_runs_changes_no_prediction(disturbed):
    first, second = answered(COULOMB).predictions(), disturbed.predictions()
    assert set(first) == set(second)
    for name, columns in first.items():
        for column, values in columns.items():
            np.testing.assert_array_equal(values, second[name][column], err_msg=name)


class TestRunWasOpened(Exception):
    __test__ = False


def test_held_out_runs_are_read_after_findings_are_fixed(monkeypatch):
    recordings = load_recordings(answered(COULOMB).source)
    told, opened = [], []
    plain = RecordingSet.open

    def watched(self, entry):
        opened.append(entry.role)
        if entry.role != "train":
            raise TestRunWasOpened
        return plain(self, entry)

    monkeypatch.setattr(RecordingSet, "open", watched)
    with pytest.raises(TestRunWasOpened):
        diagnose(recordings, progress=told.append)
    assert opened == ["train"] * 3 + ["test"]
    # Parameters are estimated and their deviations known before the first held-out run.
    assert told.index("estimate parameters") == len(told) - 3
    assert told[-2] == "fit the findings again to perturbed runs and models"
    assert told[-1].startswith("predict ")


def test_fewer_than_three_training_runs_are_cross_validated_by_stretches(tmp_path):
    source = copied(COULOMB, tmp_path / "set")
    text = (source / "recordings.toml").read_text()
    head, *runs = text.split("[[runs]]\n")
    kept = [each for each in runs if '"train_3' not in each]
    assert len(kept) == len(runs) - 1
    (source / "recordings.toml").write_text("[[runs]]\n".join([head, *kept]))
    document = command(source).document
    assert any(
        "2 training runs" in each and "stretches" in each for each in document["assumptions"]
    )
    assert not any("stretches" in each for each in answered(COULOMB).document["assumptions"])
    assert document["findings"][0]["effect"] == "coulomb"
