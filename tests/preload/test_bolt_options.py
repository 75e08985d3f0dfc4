"""Studies of through-bolted stainless flanges: choice, files, page."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from stiffopt.cli import run

STUDY = Path(__file__).parents[2] / "problems" / "stainless_flange.toml"


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    out = tmp_path_factory.mktemp("stainless")
    assert run(["preload", str(STUDY), "-o", str(out), "--quiet"]) == 0
    return out


def test_safety_factors_in_the_study_file(solved):
    study = json.loads((solved / "study.json").read_text(encoding="utf-8"))
    own = study["bolts"]["flange"]["safety_factors"]
    # Torque alone: nothing alternates in the bolt, and there is no S_D.
    assert list(own) == ["S_F", "S_P", "S_G", "S_A"]
    assert own["S_G"]["value"] == pytest.approx(1.2)
    assert own["S_G"]["equation"] == "R12/4"
    assert own["S_F"]["formula"] == "R_p0.2 / σ_red,B"
    rows = {row["kind"]: row for row in study["rows"]}
    assert own["S_F"]["value"] == pytest.approx(450e6 / rows["working stress"]["value"])
    assert rows["working stress"]["safety"]["symbol"] == "S_F"
    assert rows["least preload"]["safety"] is None


def test_safety_factors_over_the_preload_in_the_table(solved):
    lines = list(csv.DictReader((solved / "study.csv").read_text(encoding="utf-8").splitlines()))
    preload, s_f, s_g = (
        [float(line[name]) for line in lines] for name in ("preload [N]", "S_F", "S_G")
    )
    assert preload == sorted(preload)
    assert s_f == sorted(s_f, reverse=True)
    assert s_g == sorted(s_g)
    assert s_g == pytest.approx([float(line["slip safety"]) for line in lines], abs=1e-9)


def test_page_names_the_factors_and_no_present_preload(solved):
    page = (solved / "report.html").read_text(encoding="utf-8")
    for letter in "FPGA":
        assert f"S<sub>{letter}</sub>" in page
    assert "present preload" not in page
    assert "8 × M8 A2-70 with nuts" in page
    assert "From the present to the recommended preload" not in page
    assert "bolts A2-70 gall in dry threads" in page


def test_nuts_and_stainless_grades_are_chosen_from(tmp_path):
    out = tmp_path / "r"
    choose = ["--set", "choose.nuts=true", "--set", 'choose.grades=["A2-70","A4-80"]']
    assert run(["preload", str(STUDY), "-o", str(out), "--quiet", *choose]) == 0
    choice = json.loads((out / "study.json").read_text(encoding="utf-8"))["choice"]
    tried = {(row["design"]["grade"], row["design"]["size"]) for row in choice["table"]}
    assert tried == {("A2-70", "M8"), ("A4-80", "M8")}
    assert len(choice["table"]) == 4


def test_a_flange_with_nuts_is_begun_by_command(tmp_path, capsys):
    bolts = ["--size", "M8", "--grade", "A2-70", "--count", "8", "--circle", "90 mm", "--nut"]
    assert run(["init", "flange", "-o", str(tmp_path / "f"), "--torque", "100 N*m", *bolts]) == 0
    capsys.readouterr()
    study = tmp_path / "f" / "flange.toml"
    assert run(["preload", str(study), "-o", str(tmp_path / "r"), "--quiet"]) == 0
    assert "M8 A2-70 with nuts" in capsys.readouterr().out
    assert "present preload" not in (tmp_path / "r" / "report.html").read_text(encoding="utf-8")
    # Twelve M8 have room for socket heads on this circle, but not for their nuts.
    tight = ["--size", "M8", "--count", "12", "--circle", "52 mm"]
    assert run(["init", "flange", "-o", str(tmp_path / "s"), *tight]) == 0
    assert run(["init", "flange", "-o", str(tmp_path / "n"), *tight, "--nut"]) == 2
    assert "12 nuts of 14.38 mm do not fit" in capsys.readouterr().err
