"""`stiffopt preload` and `verify` of studies: files, exit codes, and what they print."""

import csv
import json

import numpy as np
import pytest
from small_studies import FLANGE, write_flanged, write_study

from stiffopt.cli import run
from stiffopt.errors import NoSolutionFound
from stiffopt.preload.files import load_study
from stiffopt.preload.store import study_document
from stiffopt.preload.study import named_values, preload_study, value_units
from stiffopt.report.common.progress import StudyProgress
from stiffopt.result.status import SolveProgress
from stiffopt.solver.monitor import Progress

MORE = """[pareto]
points = 3
[choose]
sizes = ["M5"]
torques = ["8 N*m", "9 N*m"]
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Exit code and folder of one study."""
    folder = tmp_path_factory.mktemp("preload")
    path = write_study(folder, require="joint_stiffness = { 1 = 1.5e4 }", more=MORE)
    code = run(["preload", str(path), "--out", str(folder / "out"), "--quiet"])
    return code, folder / "out", path


@pytest.fixture(scope="module")
def document(done):
    return json.loads((done[1] / "study.json").read_text())


def test_preload_writes_its_files(done):
    code, out, _ = done
    assert code == 0
    names = {path.name for path in out.iterdir()}
    assert {"study.json", "study.csv", "report.html"} <= names
    assert {path.suffix for path in out.iterdir()} <= {".json", ".csv", ".html", ".svg", ".png"}


def test_study_file(document):
    assert document["schema"] == 1
    assert document["status"] == "optimal"
    assert document["message"].endswith(".")
    assert document["objective"]["name"] == "total_preload"
    assert document["objective"]["value"] == pytest.approx(9 * document["preloads"]["ring"])
    torque = document["tightening_torques"]["ring"]
    assert 0 < torque["lower"] < torque["nominal"] <= torque["upper"]
    # Slip of an evenly pressed ring of 12 to 18 mm under 60 N m.
    lever = 2 / 3 * (0.018**3 - 0.012**3) / (0.018**2 - 0.012**2)
    least = 1.2 * 60.0 / (0.15 * 9 * lever)
    assert document["least_preloads"]["ring"] == pytest.approx(least, rel=1e-8)
    assert document["active_limits"] == ["slip safety, ring, peak"]
    assert document["utilisations"]["slip safety, ring, peak"] == pytest.approx(1.0)
    rows = {row["name"]: row for row in document["rows"]}
    assert set(rows) == set(document["utilisations"])
    assert max(document["utilisations"].values()) <= 1 + 1e-6
    assert document["stiffness"]["1"] == document["stiffness_by_case"]["1"]["peak"]
    assert document["stiffness"]["1"] == pytest.approx(
        1.5e4 / rows["joint stiffness, joint 1, peak"]["utilisation"]
    )
    assert document["kkt_residual"] < 1e-8
    assert len(document["front"]["points"]) >= 3
    assert document["choice"]["designs"]["ring"]["torque"] in (8.0, 9.0)
    assert document["motion"] is None
    assert len(document["inputs_hash"]) == 64
    assert {"stiffopt", "casadi", "numpy"} <= set(document["versions"])


def test_values_of_a_study_are_those_announced(done, document):
    problem = load_study(done[2]).problem
    units = value_units(problem)
    assert set(document["values"]) == set(units)
    assert document["values"]["preload_ring"] == document["preloads"]["ring"]
    assert all(value is not None for value in document["values"].values())


def test_curves_file(done, document):
    with (done[1] / "study.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    preload = np.array([float(row["preload [N]"]) for row in rows])
    stiffness = np.array([float(row["stiffness [N m/rad]"]) for row in rows])
    assert {row["element"] for row in rows} == {"ring"}
    assert np.all(np.diff(preload) > 0)
    assert np.all(np.diff(stiffness) >= 0)
    at_design = np.interp(document["preloads"]["ring"], preload, stiffness)
    assert at_design == pytest.approx(document["stiffness"]["1"], rel=1e-3)


def test_preload_command_prints_summary(tmp_path, capsys):
    path = write_study(tmp_path, more="[pareto]\npoints = 0")
    out = tmp_path / "out"
    assert run(["preload", str(path), "--out", str(out)]) == 0
    streams = capsys.readouterr()
    assert streams.out.startswith("optimal: Tighten the 9 bolts of the ring to ")
    for part in ("N m", "slip safety", "9 × M5 12.9", str(out / "report.html")):
        assert part in streams.out
    # Quick studies need no progress.
    assert streams.err == ""


def test_a_study_that_cannot_be_met(tmp_path, capsys):
    path = write_study(tmp_path, require="joint_stiffness = { 1 = 9e4 }")
    out = tmp_path / "out"
    assert run(["preload", str(path), "--out", str(out), "--quiet"]) == 3
    text = capsys.readouterr().out
    assert text.startswith("infeasible: No preload meets this study.")
    document = json.loads((out / "study.json").read_text())
    stop = document["stoppers"][0]
    assert stop["limit"] == "joint stiffness, joint 1, peak"
    assert stop["required"] == 9e4
    assert stop["best"] < 9e4
    assert stop["remedy"]
    assert document["front"] is None
    assert document["kkt_residual"] is None
    assert (out / "report.html").exists()


def test_individual_preloads_are_named(tmp_path):
    path = write_study(tmp_path, load="torque = [10.0]", top="individual = true")
    write_flanged(tmp_path, flange=FLANGE.replace("count = 9", "count = 2"))
    loaded = load_study(path)
    study = preload_study(loaded.problem, front_points=0)
    values = named_values(study)
    own = [values[f"preload_ring_{i}"][0] for i in (1, 2)]
    assert np.mean(own) == pytest.approx(values["preload_ring"][0])
    assert study_document(study)["individual"]["ring"] == pytest.approx(own)


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["preload", "nothing.toml"], "nothing.toml"),
        (["preload", "study.toml", "--outt", "x"], "outt"),
        (["preload", "pendulum.toml"], 'kind = "preload"'),
        (["solve", "study.toml"], 'kind = "trajectory"'),
    ],
)
def test_wrong_command_line(arguments, part, tmp_path, capsys, monkeypatch):
    write_study(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("stiffopt: ")
    assert part in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("raised", "code", "text"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (NoSolutionFound("No motion was found."), 3, "No motion was found."),
    ],
)
def test_failed_study_writes_no_files(raised, code, text, tmp_path, capsys, monkeypatch):
    def broken(*_, **__):
        raise raised

    monkeypatch.setattr("stiffopt.preload.study.preload_study", broken)
    out = tmp_path / "out" / "deep"
    arguments = ["preload", str(write_study(tmp_path)), "--out", str(out), "--quiet"]
    assert run(arguments) == code
    assert text in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_ctrl_c_after_the_optimum_is_said(tmp_path, capsys, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("stiffopt.preload.study.pareto_front", stopped)
    out = tmp_path / "out"
    assert run(["preload", str(write_study(tmp_path)), "--out", str(out), "--quiet"]) == 130
    said = " ".join(capsys.readouterr().out.split())
    assert "Note: Stopped by the user: the preloads are those of the finished optimisation" in said
    assert json.loads((out / "study.json").read_text())["notes"][0].startswith("Stopped by the")
    assert "Stopped by the user" in (out / "report.html").read_text()


def expected(name, value, unit):
    head = "[pareto]\npoints = 0\n"
    return head + (
        f'[expected.values.{name}]\nvalue = {value}\nunit = "{unit}"\n'
        'rtol = 1e-6\nsource = "slip of an even ring"'
    )


LEAST = 1.2 * 60.0 / (0.15 * 9 * 2 / 3 * (0.018**3 - 0.012**3) / (0.018**2 - 0.012**2))


def test_verify_of_a_study(tmp_path, capsys):
    for value, code, word in ((LEAST / 1e3, 0, "ok"), (LEAST / 1e3 * 1.01, 1, "OFF")):
        path = write_study(tmp_path, more=expected("least_preload_ring", value, "kN"))
        assert run(["verify", str(path), "--quiet"]) == code
        text = capsys.readouterr().out
        assert "least_preload_ring" in text
        assert word in text


def test_verify_of_a_folder_takes_problems_and_studies(tmp_path, capsys):
    from small_arms import problem_text, write_robot

    write_robot(tmp_path, "swivel")
    write_study(tmp_path, more=expected("least_preload_ring", LEAST, "N"))
    exact = (
        f"[expected]\nobjective = {12.0 / 0.8**3}\n"
        'unit = "rad^2/s^3"\nrtol = 1e-3\nsource = "exact: 12 d^2 / T^3"\n'
    )
    (tmp_path / "motion.toml").write_text(
        problem_text(
            "swivel",
            duration="0.8",
            minimise='objective = "acceleration_squared"',
            motion='boundary_acceleration = "free"',
            limits=exact,
        )
    )
    assert run(["verify", str(tmp_path), "--quiet"]) == 0
    text = capsys.readouterr().out
    for part in ("motion", "objective", "study", "least_preload_ring"):
        assert part in text


def test_verify_reads_every_file_before_it_solves_one(tmp_path, capsys):
    write_study(tmp_path, name="a.toml", more=expected("least_preload_ring", LEAST, "N"))
    write_study(tmp_path, name="b.toml", minimise='objective = "preload"')
    assert run(["verify", str(tmp_path), "--quiet"]) == 2
    streams = capsys.readouterr()
    assert "b.toml" in streams.err
    assert streams.out == ""


def test_study_without_expected_values_is_not_verified(tmp_path, capsys):
    path = write_study(tmp_path, more="[pareto]\npoints = 0")
    assert run(["verify", str(path), "--quiet"]) == 1
    assert "[expected.values]" in capsys.readouterr().out


def test_schema_of_a_study(capsys):
    assert run(["schema", "preload"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {"schema", "kind", "robot", "load_case", "tightening"} <= set(document["properties"])


def test_progress_waits_and_counts_the_time_of_all_solves():
    seen, now = [], [0.0]
    progress = StudyProgress(seen.append, clock=lambda: now[0])
    event = Progress(iteration=3, objective=1.0, violation=0.0, row="", elapsed=0.1)
    progress(event)
    assert not seen
    now[0] = 5.0
    progress(event)
    assert (seen[0].stage, seen[0].iteration, seen[0].elapsed) == ("preloads", 2, 5.0)
    staged = SolveProgress(**vars(event), stage="motion")
    now[0] = 0.0
    progress(staged)
    assert seen[1] is staged
