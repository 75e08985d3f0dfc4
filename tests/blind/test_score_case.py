"""Counting answers: names, seals, residuals from prediction files."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.blind.score import FitScore, judged, score_case
from benchmarks.blind.tally import reason, wrong

TOML = """
noise = { torque = [0.5, 2.0], link_position = 1e-3 }
[[runs]]
file = "train_1.npz"
role = "train"
[[runs]]
file = "test_1.npz"
role = "test"
"""


def _truth(kind: str, *effects: dict[str, Any]) -> dict[str, Any]:
    lines = [{"joint": None, "link": None, "run": None, "params": {}} | e for e in effects]
    return {
        "kind": kind,
        "suite": "main",
        "robot": "planar2",
        "severity": 1.0,
        "link_encoders": True,
        "effects": lines,
    }


def _finding(effect: str, joint: int | None, *rivals: tuple[str, int | None]) -> dict[str, Any]:
    return {
        "effect": effect,
        "joint": joint,
        "link": None,
        "run": None,
        "probability": 0.9,
        "parameters": {"dFc": {"value": 1.1, "sd": 0.06, "unit": "N m"}},
        "confused_with": [
            {"effect": e, "joint": j, "link": None, "run": None, "probability": 0.05}
            for e, j in rivals
        ],
    }


def _named(*findings: dict[str, Any]) -> dict[str, Any]:
    return {"verdict": "named", "findings": list(findings)}


COULOMB = {"effect": "coulomb", "joint": 2, "params": {"dFc": 1.0}}


def test_right_name_at_the_right_joint() -> None:
    found = judged(_truth("single", COULOMB), _named(_finding("coulomb", 2)))
    assert found["exact"]
    assert found["in_group"]
    assert found["joint"]
    assert found["family"]
    assert found["false_components"] == 0
    (parameter,) = found["parameters"]
    assert parameter.error == pytest.approx(0.1)
    assert parameter.covered


def test_wrong_joint_is_not_exact_though_the_family_is() -> None:
    found = judged(_truth("single", COULOMB), _named(_finding("viscous", 1)))
    assert found["detected"]
    assert found["family"]
    assert not found["exact"]
    assert not found["joint"]
    assert not found["in_group"]
    assert found["false_components"] == 1


def test_large_groups_name_nothing() -> None:
    rivals = [("stribeck", 2), ("coulomb", 2), ("viscous", 2)]
    small = judged(_truth("single", COULOMB), _named(_finding("hysteresis", 2, *rivals)))
    large = judged(
        _truth("single", COULOMB), _named(_finding("hysteresis", 2, *rivals, ("backlash", 2)))
    )
    assert small["in_group"]
    assert not large["in_group"]
    assert small["top3"]
    assert not small["exact"]


def test_place_of_effects_of_the_whole_robot_does_not_count() -> None:
    found = judged(_truth("single", {"effect": "payload"}), _named(_finding("payload", None)))
    assert found["exact"]
    assert found["joint"] is None


def test_pair_needs_both_among_three() -> None:
    truth = _truth("pair", COULOMB, {"effect": "torque_gain", "joint": 1})
    junk = _finding("viscous", 1)
    both = judged(truth, _named(_finding("torque_gain", 1), junk, _finding("coulomb", 2)))
    late = judged(truth, _named(_finding("torque_gain", 1), junk, junk, _finding("coulomb", 2)))
    assert both["both"]
    assert both["false_components"] == 1
    assert not late["both"]


@pytest.mark.parametrize(
    ("answer", "alarm"),
    [
        ({"verdict": "nothing_missing", "findings": []}, False),
        ({"verdict": "outside_catalogue", "findings": []}, True),
        (_named(_finding("coulomb", 1)), True),
        (None, True),
    ],
)
def test_anything_but_nothing_is_a_false_alarm(answer: dict[str, Any] | None, alarm: bool) -> None:
    assert judged(_truth("none"), answer)["false_alarm"] is alarm


def test_laws_beside_an_effect_are_false_components() -> None:
    truth = _truth("single", {"effect": "coulomb", "joint": 1})
    answer = _named(_finding("coulomb", 1), _finding("law_drive_torque_2_step_q_2", 2))
    found = judged(truth, answer | {"verdict": "law_found"})
    assert found["exact"]
    assert found["false_components"] == 1


def test_outside_is_right_only_as_outside() -> None:
    truth = _truth("outside", {"effect": "slosh", "joint": 1})
    assert judged(truth, {"verdict": "outside_catalogue", "findings": []})["recognised"]
    assert not judged(truth, _named(_finding("coulomb", 1)))["recognised"]
    law = _named(_finding("law_link_torque_1_sprung_a_1", 1)) | {"verdict": "law_found"}
    assert judged(truth, law)["recognised"]
    elsewhere = _named(_finding("law_link_torque_2_sprung_a_2", 2)) | {"verdict": "law_found"}
    assert not judged(truth, elsewhere)["recognised"]
    assert not judged(truth, None)["detected"]


def _write(folder: Path, truth: dict[str, Any], answer: dict[str, Any]) -> None:
    for name in ("truth", "cases/a", "oracle/a", "answers/a"):
        (folder / name).mkdir(parents=True)
    text = json.dumps(truth).encode()
    (folder / "truth/a.json").write_bytes(text)
    digest = hashlib.sha256(text).hexdigest()
    (folder / "cases/a/commitment.txt").write_text(digest + "\n")
    (folder / "cases/a/recordings.toml").write_text(TOML)
    (folder / "oracle/a.json").write_text(json.dumps({"z": 26.0, "void": False}))
    (folder / "answers/a/diagnosis.json").write_text(json.dumps(answer))
    times = {"seconds": 9.0, "cpu": 8.0, "status": "ok"}
    (folder / "answers/a/time.json").write_text(json.dumps(times))


def _predictions(folder: Path) -> None:
    """Torques off by 3, 2 and 1 of the noise; half of joint 1's samples stand still."""
    count = 100
    moving = np.where(np.arange(count) < 50, 0.0, 1.0)
    zero = np.zeros(count)
    columns = {
        "t": 0.01 * np.arange(count), "qd1": moving, "qd2": zero + 1.0,
        "tau1": zero, "tau2": zero, "ql1": zero, "ql2": zero,
    }  # fmt: skip
    np.savez(folder / "cases/a/test_1.npz", **columns)
    for path, size in (
        ("answers/a/pred_before_test_1", 3.0),
        ("answers/a/pred_after_test_1", 2.0),
        ("oracle/a/pred_test_1", 1.0),
    ):
        # Standing samples are far off and must not count.
        one = np.where(moving > 0.0, 0.5 * size, 1e3)
        np.savez(
            folder / f"{path}.npz",
            t=columns["t"],
            tau1=one,
            tau2=zero + 2.0 * size,
            ql1=zero + 1e-3 * size,
            ql2=zero - 1e-3 * size,
        )


def test_residuals_come_from_the_prediction_files(tmp_path: Path) -> None:
    answer = _named(_finding("coulomb", 2)) | {"fit": {"test": {"nrmse_after": 0.01}}}
    _write(tmp_path, _truth("single", COULOMB), answer)
    _predictions(tmp_path)
    score = score_case(tmp_path, "a")
    assert score.sealed
    assert score.exact
    assert not wrong(score)
    fit = score.fit["test"]
    assert (fit.before, fit.after, fit.oracle) == pytest.approx((3.0, 2.0, 1.0))
    assert fit.share == pytest.approx(5.0 / 8.0)
    assert np.isnan(FitScore(before=1.0, after=0.9, oracle=1.0).share)


def test_broken_seal_is_noticed(tmp_path: Path) -> None:
    _write(tmp_path, _truth("single", COULOMB), _named(_finding("coulomb", 2)))
    path = tmp_path / "truth/a.json"
    path.write_text(path.read_text().replace("coulomb", "viscous"))
    assert not score_case(tmp_path, "a").sealed


def test_case_that_ran_out_of_time_is_a_failure(tmp_path: Path) -> None:
    _write(tmp_path, _truth("single", COULOMB), _named(_finding("coulomb", 2)))
    (tmp_path / "answers/a/time.json").write_text('{"status": "timeout", "seconds": 900}')
    score = score_case(tmp_path, "a")
    assert score.verdict is None
    assert not score.detected
    assert wrong(score)
    assert reason(score) == "no answer (timeout)"


def test_change_that_is_predicted_by_half_is_a_share_of_three_quarters(tmp_path: Path) -> None:
    _write(tmp_path, _truth("single", COULOMB), _named(_finding("coulomb", 2)))
    _predictions(tmp_path)
    time = np.arange(100)
    keys = ("tau1", "tau2", "ql1", "ql2")
    for name, size in (("nominal_test_1", 0.0), ("pred_test_1", 2.0)):
        values = dict.fromkeys(keys, size + 0.0 * time)
        np.savez(tmp_path / f"oracle/a/{name}.npz", t=time, **values)
    for name, size in (("pred_before_test_1", 5.0), ("pred_after_test_1", 6.0)):
        values = dict.fromkeys(keys, size + np.sin(time))
        np.savez(tmp_path / f"answers/a/{name}.npz", t=time, **values)
    assert score_case(tmp_path, "a").added == {"test": pytest.approx(0.75)}
