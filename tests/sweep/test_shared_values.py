"""Values of several arms of one type: common, or each arm's own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from servo_sets import ARMATURE, COULOMB, DELAY, KP, write_servo_set

from stiffopt.cli import run
from stiffopt.sweep.cases import Case, Sweep
from stiffopt.sweep.shared_values import SharedValue, shared_values
from stiffopt.sweep.summary import SweepSummary


def told(
    parameter: str, value: float, sd: float, expected_sd: float = 10.0, case: str = ""
) -> dict[str, Any]:
    """One value of an arm."""
    expected = {"expected": 1.0, "expected_sd": expected_sd, "case": case}
    return {"joint": 1, "parameter": parameter, "unit": "N m", "value": value, "sd": sd} | expected


def one_value(*values: dict[str, Any]) -> SharedValue:
    (found,) = shared_values({str(k): [each] for k, each in enumerate(values)})
    return found


def test_one_value_of_all_arms_is_that_of_a_joint_fit() -> None:
    # The joint fit: two measurements and one prior.
    prior, first, second = (1.0, 0.5), (1.4, 0.3), (1.2, 0.2)

    def fit(*told_by: tuple[float, float]) -> tuple[float, float]:
        weight = np.array([1.0 / sd**2 for _, sd in told_by])
        return float(weight @ [x for x, _ in told_by] / weight.sum()), float(weight.sum() ** -0.5)

    found = one_value(*(told("coulomb", *fit(prior, each), prior[1]) for each in (first, second)))
    np.testing.assert_allclose((found.value, found.sd), fit(prior, first, second))
    assert found.common


def test_values_too_far_apart_are_each_arm_s_own() -> None:
    found = one_value(told("coulomb", 1.0, 0.02), told("coulomb", 1.2, 0.02))
    assert not found.common
    assert found.p < 1e-6
    assert [arm for arm, *_ in found.arms] == ["0", "1"]


def test_among_many_values_one_far_apart_by_chance_stays_common() -> None:
    near = {"coulomb": 0.07, **{f"value {k}": 0.01 for k in range(20)}}
    found = shared_values(
        {
            "one": [told(name, 1.0, 0.02) for name in near],
            "other": [told(name, 1.0 + away, 0.02) for name, away in near.items()],
        }
    )
    assert 0.001 < found[0].p < 0.05
    assert all(each.common for each in found)


def test_common_values_are_seldom_called_own() -> None:
    rng = np.random.default_rng(0)
    wrong = 0
    for _ in range(300):
        arms = {
            str(k): [told(str(j), 1.0 + 0.1 * rng.normal(), 0.1) for j in range(8)]
            for k in range(3)
        }
        wrong += any(not each.common for each in shared_values(arms))
    assert 3 <= wrong <= 27  # 5 % of 300, and three deviations of that count


def test_values_that_only_their_expectation_tells_are_left_out() -> None:
    assert shared_values({"0": [told("drag", 1.0, 9.9)], "1": [told("drag", 1.0, 9.9)]}) == []
    assert shared_values({"0": [told("drag", 1.0, 0.1)]}) == []


def test_arms_are_compared_within_a_case_of_the_sweep() -> None:
    sweep = Sweep(path=Path("s.toml"), title="", kind="recordings", places=("limit",), front="",
                  starts=1, cases=tuple(
        Case(k + 1, "recordings", Path(arm) / "recordings.toml", (("limit", limit),), 0, False, "")
        for k, (arm, limit) in enumerate([("a", 1), ("a", 2), ("b", 1), ("b", 2)])
    ))  # fmt: skip
    results = [
        {"result": {"simulation": [told("coulomb", value, 0.02)]}} for value in (1.0, 2.0, 1.0, 3.0)
    ]
    found = {each.case: each for each in SweepSummary(sweep, results, False).shared_values()}
    assert found["limit=1"].common
    assert not found["limit=2"].common
    assert [value for _, value, _ in found["limit=2"].arms] == [2.0, 3.0]


@pytest.mark.slow
def test_two_servos_share_rotor_and_delay_but_not_their_dry_friction(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    actuator = f"kp = [{KP}]\nkd = [0.0]\ntolerance = 0.02"
    worn = 1.6 * COULOMB
    for name, coulomb in (("one", COULOMB), ("other", worn)):
        write_servo_set(tmp_path / name, actuator=actuator, coulomb=coulomb)
    sets = [str(tmp_path / name) for name in ("one", "other")]
    assert run(["diagnose", *sets, "--out", str(tmp_path / "out"), "--quiet"]) == 0
    said = capsys.readouterr().out
    assert "Each arm's own: coulomb of joint 1" in said
    document = json.loads((tmp_path / "out" / "sweep.json").read_text(encoding="utf-8"))
    found = {each["parameter"]: each for each in document["shared_values"]}
    assert not found["coulomb"]["common"]
    assert all(found[name]["common"] for name in ("armature", "viscous", "delay"))
    own = {arm: value for arm, value, _ in found["coulomb"]["arms"]}
    np.testing.assert_allclose([own["one"], own["other"]], [COULOMB, worn], rtol=0.05)
    assert abs(found["delay"]["value"] - DELAY) < 1e-3
    assert abs(found["armature"]["value"] - ARMATURE) < 3.0 * found["armature"]["sd"]
