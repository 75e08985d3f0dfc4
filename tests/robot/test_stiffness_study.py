"""Table of stiffness over torque ratio."""

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import stiffopt.robot
from stiffopt.errors import InputError, RobotError
from stiffopt.exact.chain import compliance_shares, exact_compliance
from stiffopt.robot.files import load_robot
from stiffopt.robot.stiffness_study import (
    COLUMNS,
    stiffness_study,
    write_stiffness_csv,
)


@pytest.fixture(scope="module")
def robot():
    return load_robot("er3a_c60")


def test_columns_are_as_documented():
    assert ",".join(COLUMNS) == (
        "joint,torque_ratio,torque,tangent_stiffness,secant_stiffness,windup,"
        "reducer_only_tangent_stiffness,ratio_to_reducer_only,flanks,"
        "first_loading_stiffness,cyclic_stiffness"
    )


def test_rows_agree_with_the_chain(robot):
    rows = stiffness_study(robot, [0.01, 0.1, 1.0])
    assert len(rows) == 6 * 2 * 3
    for row in rows:
        assert row.torque == pytest.approx(row.torque_ratio * robot.torque_max[row.joint - 1])
        assert row.secant_stiffness == pytest.approx(row.torque / row.windup, rel=1e-12)
        ratio = row.tangent_stiffness / row.reducer_only_tangent_stiffness
        assert row.ratio_to_reducer_only == pytest.approx(ratio, rel=1e-12)
        assert ratio < 1
        # The contacts alone differ: at 1 % of the torque they count most.
        assert row.first_loading_stiffness == row.tangent_stiffness
        assert row.first_loading_stiffness < row.cyclic_stiffness
        assert row.cyclic_stiffness < row.reducer_only_tangent_stiffness
    own = [r for r in rows if r.joint == 3 and r.flanks == "parallel"]
    expected = exact_compliance(robot.chains[2], 38.0 * np.array([0.01, 0.1, 1.0]))
    np.testing.assert_allclose([1 / r.tangent_stiffness for r in own], expected, rtol=1e-12)
    # The robot's own reading comes first; series flanks are softer.
    assert [r.flanks for r in rows[:6]] == ["parallel"] * 3 + ["series"] * 3
    assert all(s.windup > p.windup for p, s in zip(rows[:3], rows[3:6], strict=True))
    assert len(stiffness_study(robot, [0.5], both_readings=False)) == 6


def test_default_ratios_cover_a_thousandth_to_one(robot):
    single = replace(robot, chains=(robot.chains[0], *(None,) * 5))
    ratios = [r.torque_ratio for r in stiffness_study(single, both_readings=False)]
    assert ratios == sorted(ratios)
    assert ratios[0] == 0.001
    assert ratios[-1] == 1.0


def test_csv_has_all_rows(robot, tmp_path):
    rows = stiffness_study(robot, [0.1, 1.0])
    write_stiffness_csv(rows, tmp_path / "stiffness.csv")
    with (tmp_path / "stiffness.csv").open() as stream:
        read = list(csv.DictReader(stream))
    assert len(read) == len(rows)
    assert float(read[5]["windup"]) == rows[5].windup
    assert read[0]["flanks"] == "parallel"


def test_shares_sum_to_one(robot):
    for chain, limit in zip(robot.chains, robot.torque_max, strict=True):
        shares = compliance_shares(chain, 0.1 * float(limit))
        assert sum(shares.values()) == pytest.approx(1.0, abs=1e-12)


def test_invalid_ratios_are_refused(robot):
    with pytest.raises(RobotError, match="no joint has a drivetrain"):
        stiffness_study(replace(robot, chains=(None,) * 6))
    for ratios in ([0.0, 1.0], [-0.1], [float("nan")]):
        with pytest.raises(InputError, match="above 0"):
            stiffness_study(robot, ratios)


def test_robot_file_sets_the_loading_of_contacts(robot, tmp_path):
    text = (Path(stiffopt.robot.__file__).parent / "data/er3a_c60/robot.toml").read_text()
    shutil.copytree(Path(stiffopt.robot.__file__).parent / "data/er3a_c60", tmp_path / "arm")
    changed = text.replace("[assembly]", '[assembly]\nloading = "cyclic"', 1)
    assert changed != text
    (tmp_path / "arm/robot.toml").write_text(changed)
    worn = load_robot(tmp_path / "arm/robot.toml")
    for new, old in zip(stiffness_study(worn, [0.01]), stiffness_study(robot, [0.01]), strict=True):
        assert new.tangent_stiffness == old.cyclic_stiffness > old.tangent_stiffness
        assert new.first_loading_stiffness == old.tangent_stiffness
