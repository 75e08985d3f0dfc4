"""One's own parts, in a file beside the robot's."""

from __future__ import annotations

import re
import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from gripper_arm import write_gripper_urdf
from small_arms import ROOT

from stiffopt.cli import run
from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputError
from stiffopt.preload.files import load_study
from stiffopt.preload.store import study_document, study_hash
from stiffopt.preload.study import preload_study
from stiffopt.problem.files import load_problem
from stiffopt.report.preload.page import write_preload_report
from stiffopt.result.provenance import inputs_hash
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


def test_robot_uses_reducers_of_its_catalogue(folder):
    arm = load_robot(folder / "robot.toml")
    [chain] = [chain for chain in arm.chains if chain is not None and chain.stages]
    assert chain.stages[0].element.K3 == 9e3
    assert pytest.approx(2.0 / (np.pi / 10800.0)) == chain.stages[0].element.K1
    [source] = [row for row in arm.sources if row.element == "reducer"]
    assert source.source == "data sheet of the maker"
    # Nowhere else.
    assert "sesame_87" not in catalogue.reducer_names()


def test_init_robot_considers_reducers_of_the_catalogue(folder, capsys):
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
def test_faulty_catalogue_files_are_refused(old, new, said, tmp_path):
    assert old in OWN
    (tmp_path / "own.toml").write_text(OWN.replace(old, new))
    with pytest.raises(InputError, match=re.escape(said)):
        read_own_catalogue(tmp_path / "own.toml")


PARTS = """
[[bolt]]
size = "K5"
diameter = "5 mm"
pitch = "0.8 mm"
head_diameter = "8.5 mm"
bearing_diameter = "8.03 mm"
hole = "5.5 mm"
provenance = "catalogue"
source = "drawing of the maker"

[[key]]
width = "5 mm"
height = "4 mm"
shaft_min = "12 mm"
shaft_max = "17 mm"
shaft_depth = "2.5 mm"
hub_depth = "1.9 mm"
shaft_flank_height = "2.2 mm"
hub_flank_height = "1.5 mm"

[[belt]]
name = "AT7"
pitch = "7 mm"
tooth_height = "1.9 mm"
tooth_root_width = "3.4 mm"
flank_angle = "25 deg"
tooth_modulus = "80 MPa"
span_stiffness = { "10e-3" = 2e5 }

[[surface]]
name = "ground"
first = "steel"
second = "aluminium"
fractal_dimension = 2.5
fractal_roughness = 2e-9
friction = 0.14
"""


def test_every_kind_of_part_is_listed(tmp_path, capsys):
    own = tmp_path / "own.toml"
    own.write_text(OWN + PARTS)
    for kind, name in (("bolts", "K5"), ("keys", "5x4"), ("belts", "AT7"), ("surfaces", "ground")):
        assert run(["catalogue", kind, "--own", str(own)]) == 0
        assert name in capsys.readouterr().out
        assert run(["catalogue", kind]) == 0
        assert name not in capsys.readouterr().out
    with catalogue.with_own(read_own_catalogue(own)):
        ours, theirs = catalogue.bolt("K5"), catalogue.bolt("M5")
        # The thread that was left out is that of ISO 724 and 898-1.
        for name in ("pitch_diameter", "minor_diameter", "stress_area"):
            assert getattr(ours, name) == pytest.approx(getattr(theirs, name), rel=2e-3)
        assert catalogue.key(5e-3, 4e-3).hub_flank_height == pytest.approx(1.5e-3)
        assert catalogue.surface("ground").friction == 0.14
        assert catalogue.surface("fine_steel").friction == 0.15
        assert catalogue.belt("AT7").span_stiffness_at(5e-3) == pytest.approx(1e5)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('hole = "5.5 mm"', 'hole = "4.5 mm"', "bolt[K5].hole: 4.5 mm must be above diameter"),
        ('pitch = "0.8 mm"', 'pitch = "5 mm"', "bolt[K5].pitch_diameter: 1.75"),
        ('= "1.5 mm"', '= "2.5 mm"', "key[5x4].hub_flank_height: both flanks"),
        ('"10e-3"', '"ten"', "belt[AT7].span_stiffness: 'ten' is no width"),
        ("= 2.5\n", "= 1.5\n", "surface[ground].fractal_dimension: must lie between"),
        ('second = "aluminium"', 'second = "wood"', "no material 'wood'"),
        ('size = "K5"', 'size = "K5"\nlength = 3', "unknown key"),
    ],
)
def test_faulty_parts_are_refused(old, new, said, tmp_path):
    assert old in PARTS
    (tmp_path / "own.toml").write_text(OWN + PARTS.replace(old, new))
    with pytest.raises(InputError, match=re.escape(said)):
        read_own_catalogue(tmp_path / "own.toml")


def test_study_tightens_and_selects_bolts_of_the_user(tmp_path):
    """The same numbers under another name give the same preloads."""
    study = (ROOT / "problems" / "er3a_preload_j2_flexspline.toml").read_text()
    (tmp_path / "own.toml").write_text(OWN + PARTS)
    shipped = ROOT / "stiffopt" / "robot" / "data" / "er3a_c60"
    text = (shipped / "robot.toml").read_text()
    shutil.copy(shipped / "robot.urdf", tmp_path)
    text = text.replace('name = "er3a_c60"', 'name = "er3a_c60"\ncatalogue = "own.toml"', 1)
    (tmp_path / "robot.toml").write_text(text)
    study = study.replace('robot = "er3a_c60"', 'robot = "robot.toml"')
    study = study.replace('sizes = ["M4", "M5", "M6"]', 'sizes = ["K5"]').replace(
        "[6, 8, 9, 12]", "[9]"
    )
    (tmp_path / "study.toml").write_text(study)
    loaded = load_study(tmp_path / "study.toml")
    found = preload_study(loaded.problem, front_points=0)
    assert found.choice is not None
    assert "K5" in str(found.choice)
    assert study_document(found)["inputs_hash"] == study_hash(loaded.problem)
    assert hash_with(loaded.problem, "K5", 5.1e-3) != study_hash(loaded.problem)
    assert hash_with(loaded.problem, "unused", 5.1e-3) == study_hash(loaded.problem)
    page = write_preload_report(found, tmp_path / "out").read_text()
    assert "K5" in page
    with pytest.raises(InputError, match="no bolt 'K5' in the catalogue"):
        catalogue.bolt("K5")


def hash_with(study, size, diameter):
    """Hash of a study with one of its robot's own bolts changed, or a bolt more."""
    bolts = study.robot.own["bolt"]
    changed = {**bolts, size: {**bolts["K5"], "size": size, "diameter": diameter}}
    own = {**study.robot.own, "bolt": changed}
    return study_hash(replace(study, robot=replace(study.robot, own=own)))


def test_unused_parts_do_not_change_the_hash_of_inputs(folder):
    robot = load_robot(folder / "robot.toml")
    assert inputs_hash(replace(robot, own={})) == inputs_hash(robot)
    (folder / "own.toml").write_text(OWN + PARTS)
    assert inputs_hash(load_robot(folder / "robot.toml")) == inputs_hash(robot)
    (folder / "own.toml").write_text(OWN.replace("K2 = 8e3", "K2 = 8.5e3"))
    assert inputs_hash(load_robot(folder / "robot.toml")) != inputs_hash(robot)


def test_hash_of_a_shipped_problem_is_independent_of_user_parts():
    problem = load_problem(ROOT / "problems" / "ur10_torque_squared.toml").problem
    robot = replace(problem.robot, own={"bolt": {"K5": {"size": "K5"}}})
    assert inputs_hash(replace(problem, robot=robot)) == inputs_hash(problem)
