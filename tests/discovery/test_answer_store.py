"""What a diagnosis leaves behind, judged from its files alone."""

import math
import tomllib

import numpy as np
import pytest
from diagnosed_folders import answered, columns_of, contents
from simulated_sets import COULOMB

NUMBER, TEXT = (int, float), (str,)
NULL = (type(None),)
PARAMETER = {"value": NUMBER, "sd": NUMBER, "unit": TEXT, "determined": (bool,)}
RIVAL = {"effect": TEXT, "joint": (int, *NULL), "probability": NUMBER}
FINDING = {
    "effect": TEXT,
    "joint": (int, *NULL),
    "probability": NUMBER,
    "certainty": TEXT,
    "statement": TEXT,
    "to_do": TEXT,
    "equation": TEXT,
    "parameters": (dict,),
    "where": TEXT,
    "link": (*TEXT, *NULL),
    "run": (*TEXT, *NULL),
    "variance_explained": NUMBER,
    "size": (dict, *NULL),
    "held_out_ratio": (*NUMBER, *NULL),
    "confused_with": (list,),
}
CHANNEL = {
    "channel": TEXT,
    "rms_before": NUMBER,
    "rms_after": NUMBER,
    "noise": NUMBER,
    "unit": TEXT,
}
NRMSE = {"nrmse_before": NUMBER, "nrmse_after": NUMBER}
LIMIT = {
    "effect": TEXT,
    "joint": (int, *NULL),
    "parameter": TEXT,
    "value": NUMBER,
    "unit": TEXT,
}
OUTSIDE = {"channels": (list,), "regressors": (list,), "gain_heldout": NUMBER, "brief": (bool,)}
DOCUMENT = {
    "schema": (int,),
    "verdict": TEXT,
    "findings": (list,),
    "to_do": TEXT,
    "changed_values": (list,),
    "fit": (dict,),
    "detection_limits": (list,),
    "mismatch": (list,),
    "modes": (list,),
    "rigid_model": (dict, *NULL),
    "black_box": (dict, *NULL),
    "not_carried_over": (list,),
    "outside": (dict, *NULL),
    "next_experiment": TEXT,
    "assumptions": (list,),
}


def check(entry, keys):
    """Every key is there, of one of its types, and finite."""
    for key, kinds in keys.items():
        assert isinstance(entry[key], kinds), f"{key}: {entry[key]!r}"
        assert bool in kinds or not isinstance(entry[key], bool)
        if isinstance(entry[key], float):
            assert math.isfinite(entry[key]), key


def conforms(document):
    """Check a diagnosis.json key by key."""
    check(document, DOCUMENT)
    assert document["schema"] == 1
    verdict, findings = document["verdict"], document["findings"]
    assert verdict in ("named", "law_found", "nothing_missing", "outside_catalogue")
    # Beside findings that leave much open the verdict is outside the catalogue.
    assert (
        findings
        if verdict in ("named", "law_found")
        else verdict != "nothing_missing" or not findings
    )
    for finding in document["findings"]:
        check(finding, FINDING)
        assert 0.0 < finding["probability"] <= 1.0
        assert finding["parameters"]
        for parameter in finding["parameters"].values():
            check(parameter, PARAMETER)
            assert parameter["sd"] >= 0.0
        for rival in finding["confused_with"]:
            check(rival, RIVAL)
        shares = [finding["probability"], *(r["probability"] for r in finding["confused_with"])]
        assert sum(shares) <= 1.0 + 1e-9
    assert document["fit"]["channels"]
    for channel in document["fit"]["channels"]:
        check(channel, CHANNEL)
    for role in ("test", "extrapolate"):
        if document["fit"][role] is not None:
            check(document["fit"][role], NRMSE)
    for limit in document["detection_limits"]:
        check(limit, LIMIT)
    if document["outside"] is not None:
        check(document["outside"], OUTSIDE)
    assert all(isinstance(sentence, str) for sentence in document["assumptions"])


def test_diagnosis_json_has_every_key_of_the_format():
    document = answered(COULOMB).document
    assert answered(COULOMB).code == 0
    conforms(document)
    assert document["verdict"] == "named"
    first = document["findings"][0]
    assert (first["effect"], first["joint"]) == ("coulomb", 2)
    assert set(first["parameters"]) == {"dFc"}
    assert first["parameters"]["dFc"]["unit"] == "N m"
    assert document["detection_limits"]


def test_predictions_only_of_held_out_runs_at_their_stamps():
    found = answered(COULOMB)
    description = tomllib.loads((found.source / "recordings.toml").read_text())
    names = [*description["signals"]["torque"], *description["signals"]["link_position"]]
    held_out = [r["file"] for r in description["runs"] if r["role"] != "train"]
    predictions = found.predictions()
    assert set(predictions) == {
        f"pred_{when}_{file}" for file in held_out for when in ("before", "after")
    }
    for name, columns in predictions.items():
        recorded = columns_of(found.source / name.split("_", 2)[2])
        np.testing.assert_array_equal(columns["t"], recorded["t"])
        assert set(columns) == {"t", *names}
        for column in names:
            assert columns[column].shape == recorded["t"].shape
            assert np.isfinite(columns[column]).all()


@pytest.mark.parametrize("role", ["test", "extrapolate"])
@pytest.mark.parametrize("when", ["before", "after"])
def test_residuals_match_predictions(role, when):
    found = answered(COULOMB)
    description = tomllib.loads((found.source / "recordings.toml").read_text())
    signals, noise = description["signals"], description["noise"]
    told = {c["channel"]: c["noise"] for c in found.document["fit"]["channels"]}
    squares, count = 0.0, 0
    for entry in description["runs"]:
        if entry["role"] != role:
            continue
        recorded = columns_of(found.source / entry["file"])
        predicted = columns_of(found.out / f"pred_{when}_{entry['file']}")
        for j, (torque, link) in enumerate(
            zip(signals["torque"], signals["link_position"], strict=True)
        ):
            moving = np.abs(recorded[signals["velocity"][j]]) >= 0.03
            off = (recorded[torque] - predicted[torque])[moving] / noise["torque"][j]
            squares, count = squares + off @ off, count + off.size
            off = (recorded[link] - predicted[link]) / told[f"link_position_{j + 1}"]
            squares, count = squares + off @ off, count + off.size
    expected = math.sqrt(squares / count)
    assert found.document["fit"][role][f"nrmse_{when}"] == pytest.approx(expected, rel=1e-9)


def test_noise_equals_stated_noise():
    found = answered(COULOMB)
    noise = tomllib.loads((found.source / "recordings.toml").read_text())["noise"]
    told = {c["channel"]: c["noise"] for c in found.document["fit"]["channels"]}
    for j, stated in enumerate(noise["torque"], 1):
        assert told[f"torque_{j}"] == pytest.approx(stated)
        assert told[f"link_position_{j}"] == pytest.approx(noise["link_position"], rel=0.05)


def test_residual_of_held_out_runs_decreases():
    fit = answered(COULOMB).document["fit"]
    for role in ("test", "extrapolate"):
        assert fit[role]["nrmse_after"] < 0.7 * fit[role]["nrmse_before"]
    torque = next(c for c in fit["channels"] if c["channel"] == "torque_2")
    assert torque["rms_after"] < 0.5 * torque["rms_before"]


def test_recording_set_is_not_changed():
    found = answered(COULOMB)
    description = tomllib.loads((found.source / "recordings.toml").read_text())
    runs = {entry["file"] for entry in description["runs"]}
    assert set(contents(found.source)) == {
        "recordings.toml",
        "robot.urdf",
        "commitment.txt",
        *runs,
    }
