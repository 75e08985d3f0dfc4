"""A flange of one's own by commands: own bolts and washers, moments, what a warning counts for."""

from __future__ import annotations

import json
import math

import pytest

from stiffopt.cli import run
from stiffopt.connection import Bolt
from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputError
from stiffopt.fastening.bolt_strength import head_bearing
from stiffopt.fastening.verification import Verification
from stiffopt.preload.files import load_study
from stiffopt.preload.flange_loads import case_loads
from stiffopt.robot.own_catalogue import read_own_catalogue

OWN = """schema = 1
kind = "catalogue"

[[bolt]]
size = "M14"
diameter = "14 mm"
pitch = "2 mm"
head_diameter = "21 mm"
bearing_diameter = "20.17 mm"
hole = "15.5 mm"

[[bolt]]
size = "M8x1"
diameter = "8 mm"
pitch = "1 mm"
head_diameter = "13 mm"
bearing_diameter = "12.33 mm"
hole = "9 mm"

[[bolt]]
size = "flanged M8"
diameter = "8 mm"
pitch = "1.25 mm"
head_diameter = "18 mm"
bearing_diameter = "17 mm"
hole = "9 mm"
"""
WASHER = '[[washer]]\nsize = "M14"\ndiameter = "28 mm"\nthickness = "2.5 mm"\n'


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(OWN + WASHER)
    return path


def test_moments_and_own_bolts_against_a_calculation_by_hand(own, tmp_path, capsys):
    out, torque, tilt, pull, count = tmp_path / "f", 500.0, 800.0, 2000.0, 12
    size = ["--size", "M14", "--catalogue", str(own), "--count", str(count), "--circle", "160 mm"]
    loads = ["--torque", "500 N*m", "--tilting-moment", "800 N*m", "--axial-force", "2 kN"]
    assert run(["init", "flange", "-o", str(out), *size, *loads]) == 0
    assert run(["preload", str(out / "flange.toml"), "-o", str(tmp_path / "r"), "--quiet"]) == 0
    study = json.loads((tmp_path / "r" / "study.json").read_text())
    assert study["status"] == "optimal"
    # Ring of 0.74 d_w to each side of the circle, rounded down to 0.1 mm.
    inner, outer, friction = 80e-3 - 14.9e-3, 80e-3 + 14.9e-3, 0.15
    lever = 2 / 3 * (outer**3 - inner**3) / (outer**2 - inner**2)
    slip = 1.2 * torque / (count * lever) / friction
    pulled = pull / count + 4 * tilt / (count * 160e-3)
    assert study["least_preloads"]["flange"] == pytest.approx(slip + pulled, rel=1e-3)
    # Pressure at the rim: F/A + M R/I, without holes, which take less away here.
    area, moment = math.pi * (outer**2 - inner**2), math.pi / 4 * (outer**4 - inner**4)
    opens = next(row for row in study["rows"] if row["kind"] == "one-sided opening")
    assert opens["limit"] == pytest.approx((pull + tilt * outer * area / moment) / count, rel=0.03)
    # The ring that is written is one for which the formulas hold.
    assert "Warning: validity" not in capsys.readouterr().out


def test_every_bolt_of_a_tilted_flange_together_balances_the_load(own, tmp_path):
    out = tmp_path / "f"
    assert run(["init", "flange", "-o", str(out), "--tilting-moment", "40 N*m"]) == 0
    problem = load_study(out / "flange.toml").problem
    [element] = problem.elements
    loads = case_loads(element.stage, 1, problem.load_cases)
    steps = Verification(element.stage.element, problem.tightening, loads, None)
    angles, forces = steps.angles[:: len(steps.angles) // 8], steps.axial[0]
    at_bolts = forces[:: len(steps.angles) // 8]
    assert at_bolts.sum() == pytest.approx(0.0, abs=1e-6)
    moment = math.hypot(*(float((at_bolts * f(angles)).sum()) * 25e-3 for f in (_cos, _sin)))
    assert moment == pytest.approx(40.0, rel=1e-3)


def _cos(angles):
    return [math.cos(each) for each in angles]


def _sin(angles):
    return [math.sin(each) for each in angles]


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--tilting-moment", "-3 N*m", "--tilting-moment is a magnitude"),
        ("--axial-force", "-500 N", "--axial-force is a magnitude, got -500"),
        ("--axial-force", "3 mm", "--axial-force"),
        ("--shear-force", "3 N*m", "--shear-force"),
        ("--size", "M7", "no bolt 'M7'"),
        ("--catalogue", "nowhere.toml", "nowhere.toml: no such file"),
        ("--set", "size=M3", "--set 'size=M3': edit the file that is written"),
    ],
)
def test_wrong_loads_of_a_first_flange(option, value, said, tmp_path, capsys):
    for given in ([f"{option}={value}"], [option, value]):
        assert run(["init", "flange", "-o", str(tmp_path / "f"), *given]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "f").exists()


def test_a_flange_that_opens_has_no_negative_safety(tmp_path, capsys):
    out = tmp_path / "f"
    assert run(["init", "flange", "-o", str(out), "--tilting-moment", "1000 N*m"]) == 0
    assert run(["preload", str(out / "flange.toml"), "-o", str(tmp_path / "r"), "--quiet"]) == 3
    said = capsys.readouterr().out
    assert "required 1.2, best reachable 0, as it opens." in " ".join(said.split())
    study = json.loads((tmp_path / "r" / "study.json").read_text())
    [slip] = [row for row in study["rows"] if row["kind"] == "slip under the whole load"]
    assert slip["value"] == 0.0
    assert slip["utilisation"] > 1.0


@pytest.mark.parametrize(
    ("size", "diameter", "said"),
    [
        (
            "M5",
            "6 mm",
            "washer[M5].diameter: 6 mm must be at least 8.03 mm, on which the head of M5",
        ),
        ("M99", "28 mm", "washer[M99].size: no bolt has this size. "),
    ],
)
def test_impossible_washers_are_refused(size, diameter, said, tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        f'schema = 1\nkind = "catalogue"\n[[washer]]\nsize = "{size}"\n'
        f'diameter = "{diameter}"\nthickness = "1 mm"\n'
    )
    with pytest.raises(InputError) as refused:
        read_own_catalogue(path)
    assert str(refused.value).startswith(f"{path}")
    assert said in str(refused.value)


def test_washers_are_listed_beside_their_bolts(own, capsys):
    assert run(["catalogue", "bolts", "--own", str(own)]) == 0
    lines = capsys.readouterr().out.splitlines()
    ends = {
        size: next(x for x in lines if f" {size} " in x) for size in ("M14", "M5", "flanged M8")
    }
    assert "28 x 2.5" in ends["M14"]
    assert "10 x 1" in ends["M5"]
    assert "16 x" not in ends["flanged M8"]


def test_a_washer_without_a_source_is_of_ones_own_catalogue(own):
    with catalogue.with_own(read_own_catalogue(own)):
        bearing = head_bearing(Bolt(size="M14", head_material="34CrMo4", washer=True))
    assert bearing.source == "head on its washer, own catalogue"


def test_washers_are_ones_own_else_those_of_the_diameter(own):
    with catalogue.with_own(read_own_catalogue(own)):
        assert catalogue.washer("M14").diameter == 28e-3
        assert catalogue.washer("M14").pressure == catalogue.washer("M5").pressure
        assert catalogue.washer("M8x1").diameter == catalogue.washer("M8").diameter == 16e-3
        with pytest.raises(InputError, match="bears on 17 mm, and the washer is 16 mm wide"):
            catalogue.washer("flanged M8")
    own.write_text(OWN)
    with (
        catalogue.with_own(read_own_catalogue(own)),
        pytest.raises(InputError, match=r"bolt M14: no packaged washer .* Add a \[\[washer\]\]"),
    ):
        catalogue.washer("M14")


def test_a_washer_spreads_the_force_of_ones_own_bolt(own, tmp_path):
    """By hand: d_Wa = min(28, 20.17 + 1.6 2.5) mm on the part, 900 MPa under the head."""
    out = tmp_path / "f"
    size = ["--size", "M14", "--catalogue", str(own), "--circle", "160 mm"]
    assert run(["init", "flange", "-o", str(out), *size]) == 0
    robot = out / "flange_robot.toml"
    robot.write_text(
        robot.read_text().replace(
            "circle_diameter = 0.16 }", "circle_diameter = 0.16, washer = true }"
        )
    )
    problem = load_study(out / "flange.toml").problem
    bolt = problem.elements[0].stage.element.bolt
    with catalogue.with_own(problem.robot.own):
        found = head_bearing(bolt)
        part = catalogue.clamped_material("steel").head_pressure
    below = part * math.pi / 4 * (24.17e-3**2 - 15.5e-3**2)
    above = 900e6 * math.pi / 4 * (20.17e-3**2 - 15.5e-3**2)
    assert found.capacity == pytest.approx(min(below, above), rel=1e-9)


def test_warning_beside_an_optimum_states_consequence(tmp_path, capsys):
    out = tmp_path / "f"
    assert run(["init", "flange", "-o", str(out)]) == 0
    robot = out / "flange_robot.toml"
    text = robot.read_text()
    assert "inner_radius = 0.0191" in text
    robot.write_text(text.replace("inner_radius = 0.0191", "inner_radius = 0.015"))
    capsys.readouterr()
    assert run(["preload", str(out / "flange.toml"), "-o", str(tmp_path / "r"), "--quiet"]) == 0
    said = capsys.readouterr().out
    warning = "validity of even pressure is at 132 % of its limit in flange. It does not exclude"
    assert f"Warning: {warning} the design" in said
    assert "The warning counts: take slip and opening for estimates" in said
    # What is used is a limit that counts.
    assert "132 % of validity" not in said
    assert warning in (tmp_path / "r" / "report.html").read_text()


def test_a_torque_that_is_not_plausible_is_asked_about_once(tmp_path, capsys):
    assert run(["init", "flange", "-o", str(tmp_path / "f"), "--torque", "10 MN*m"]) == 0
    assert run(["preload", str(tmp_path / "f" / "flange.toml"), "--quiet"]) == 2
    assert "joint[flange].torque_max: 1e+07 N*m is not plausible" in capsys.readouterr().err


def test_one_bolt_is_no_ring(tmp_path, capsys):
    assert run(["init", "flange", "--out", str(tmp_path / "f"), "--count", "1"]) == 2
    assert "one bolt presses one side of a ring only" in capsys.readouterr().err
    assert not (tmp_path / "f").exists()
