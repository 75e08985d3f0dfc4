"""One's own reducers, in a file beside the robot's."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest
from gripper_arm import write_gripper_urdf

from stiffopt.cli import run
from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputError
from stiffopt.robot.files import load_robot
from stiffopt.robot.own_catalogue import read_own_catalogue

OWN = """schema = 1
kind = "catalogue"

[[reducer]]
name = "sesame_87"
ratio = 101
K1 = "2 N*m/arcmin"
K2 = 8e3
K3 = 9e3
T1 = 10.0
T2 = 40.0
ratings = [60.0, 90.0, 150.0]
provenance = "catalogue"
source = "data sheet of the maker"
"""
ROBOT = """schema = 1
kind = "robot"
name = "seven"
urdf = "seven.urdf"
catalogue = "own.toml"

[[joint]]
name = "axis_1"

[[joint.element]]
name = "reducer"
type = "reducer"
catalogue = "sesame_87"
"""


@pytest.fixture
def folder(tmp_path):
    write_gripper_urdf(tmp_path)
    (tmp_path / "own.toml").write_text(OWN)
    (tmp_path / "robot.toml").write_text(ROBOT)
    return tmp_path


def test_a_robot_takes_its_reducers_from_there(folder):
    arm = load_robot(folder / "robot.toml")
    [chain] = [chain for chain in arm.chains if chain is not None and chain.stages]
    assert chain.stages[0].element.K3 == 9e3
    assert pytest.approx(2.0 / (np.pi / 10800.0)) == chain.stages[0].element.K1
    [source] = [row for row in arm.sources if row.element == "reducer"]
    assert source.source == "data sheet of the maker"
    # Nowhere else.
    assert "sesame_87" not in catalogue.reducer_names()


def test_candidates_of_init_robot(folder, capsys):
    out = folder / "new.toml"
    own = ["--catalogue", str(folder / "own.toml")]
    assert run(["init", "robot", str(folder / "seven.urdf"), *own, "--out", str(out)]) == 0
    document = tomllib.loads(out.read_text())
    assert document["catalogue"] == "own.toml"
    # Repeated peak of 90 N m for 87 N m.
    assert document["joint"][0]["element"][0]["catalogue"] == "sesame_87"
    assert load_robot(out).n == 7
    capsys.readouterr()
    assert run(["catalogue", "reducers", "--own", str(folder / "own.toml")]) == 0
    assert "sesame_87" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("T2 = 40.0", "T2 = 4.0", "reducer[sesame_87].T2: must not be below T1 = 10"),
        ("[60.0, 90.0", "[60.0, 50.0", "reducer[sesame_87].ratings: must rise"),
        ("K2 = 8e3", "K4 = 8e3", "K2: this key is required and missing"),
        ('kind = "catalogue"', 'kind = "robot"', 'kind = "catalogue"'),
        (OWN[OWN.index("[[") :], OWN[OWN.index("[[") :] * 2, "is given twice"),
    ],
)
def test_faults(old, new, said, tmp_path):
    assert old in OWN
    (tmp_path / "own.toml").write_text(OWN.replace(old, new))
    with pytest.raises(InputError, match=re.escape(said)):
        read_own_catalogue(tmp_path / "own.toml")
