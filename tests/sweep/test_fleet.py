"""`stiffopt diagnose SET...`: diagnoses of several recording sets as a sweep."""

import csv
import json
import shutil
from pathlib import Path

import pytest
from small_arms import ROOT

from stiffopt.cli import run
from stiffopt.sweep.cases import fleet_sweep

SET = ROOT / "problems" / "recordings" / "two_link_friction"


@pytest.fixture
def sets(tmp_path):
    places = [tmp_path / name for name in ("one", "other")]
    for place in places:
        shutil.copytree(SET, place)
    text = (places[1] / "recordings.toml").read_text()
    (places[1] / "recordings.toml").write_text(f'title = "The other arm"\n{text}')
    return places


def test_sets_are_cases_with_common_changes(sets):
    fleet = fleet_sweep([sets[0], sets[1] / "recordings.toml"], ["title=Arm"])
    assert fleet.kind == "recordings"
    assert [case.base for case in fleet.cases] == [each / "recordings.toml" for each in sets]
    assert all(case.settings == ("title=Arm",) for case in fleet.cases)
    # What a case is named by is all that it holds: the title is now the same.
    assert len({case.key for case in fleet_sweep(sets).cases}) == 2


def test_sets_of_equal_content_are_separate_cases(sets):
    shutil.copyfile(sets[0] / "recordings.toml", sets[1] / "recordings.toml")
    assert len({case.key for case in fleet_sweep(sets).cases}) == 2


def test_other_files_are_refused_as_with_a_single_set(sets, tmp_path, capsys):
    problem = ROOT / "problems" / "two_link.toml"
    assert run(["diagnose", str(sets[0]), str(problem)]) == 2
    said = capsys.readouterr().err
    assert f"{problem}: is no recording set, but of kind 'trajectory'" in said
    bare = tmp_path / "bare"
    bare.mkdir()
    (bare / "run.csv").write_text("t,q\n0,0\n")
    for others in ([], [str(sets[0])]):
        assert run(["diagnose", str(bare), *others]) == 2
        assert f"`stiffopt init recording {bare} --urdf ROBOT.urdf` writes one" in (
            capsys.readouterr().err
        )


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--model", "m.toml"], "--model needs a single recording set; 2 were given"),
        (["--no-report"], "--no-report needs a single recording set"),
        (["--workers", "0"], "at least 1"),
    ],
)
def test_options_of_a_single_set_are_refused(sets, capsys, arguments, named):
    assert run(["diagnose", *map(str, sets), *arguments]) == 2
    assert named in capsys.readouterr().err


def test_workers_of_one_set_and_repeated_sets_are_refused(sets, capsys):
    assert run(["diagnose", str(sets[0]), "--workers", "2"]) == 2
    assert "--workers needs several recording sets" in capsys.readouterr().err
    assert run(["diagnose", str(sets[0]), str(sets[0] / "recordings.toml")]) == 2
    assert "named twice" in capsys.readouterr().err
    problem = ROOT / "problems" / "two_link.toml"
    assert run(["diagnose", str(problem), str(ROOT / "problems" / "ur10_fixed_path.toml")]) == 2
    assert "no recording set" in capsys.readouterr().err


@pytest.mark.slow
def test_fleet_writes_a_table_and_resumes(sets, tmp_path, capsys):
    out = tmp_path / "fleet"
    command = ["diagnose", *map(str, sets), "--out", str(out), "--workers", "1", "--quiet"]
    assert run(command) == 0
    with (out / "table.csv").open() as stream:
        table = list(csv.DictReader(stream))
    assert [row["findings"] for row in table] == ["coulomb of 2"] * 2
    assert {row["base"] for row in table} == {"one", "other"}
    assert (out / "report.html").is_file()
    files = sorted((out / "cases").glob("*.json"))
    times = [each.stat().st_mtime_ns for each in files]
    # One of them is as a diagnosis of its own says.
    assert run(["diagnose", str(sets[0]), "--out", str(tmp_path / "own"), "--quiet"]) == 0
    alone = json.loads((tmp_path / "own" / "diagnosis.json").read_text())
    assert alone["findings"] in [json.loads(e.read_text())["result"]["findings"] for e in files]
    assert run(command) == 0
    assert [each.stat().st_mtime_ns for each in files] == times


def test_unreadable_file_is_reported_by_its_case(sets, monkeypatch):
    """The machine may let nobody read it, or a file that a text names may be no TOML."""
    (sets[1] / "notes.toml").write_text("x = [")
    document = sets[1] / "recordings.toml"
    document.write_text(document.read_text().replace('licence = "MIT"', 'licence = "notes.toml"'))
    opened = Path.open

    def barred(path, *arguments, **options):
        if path == sets[1] / "train_1.npz":
            raise PermissionError(13, "Permission denied", str(path))
        return opened(path, *arguments, **options)

    before = [case.key for case in fleet_sweep(sets).cases]
    monkeypatch.setattr(Path, "open", barred)
    after = [case.key for case in fleet_sweep(sets).cases]
    assert before[0] == after[0]
    assert before[1] != after[1]
