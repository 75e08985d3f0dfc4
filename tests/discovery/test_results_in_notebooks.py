"""Results in Python and notebooks, changes on the command line, two answers side by side."""

from __future__ import annotations

import json

import numpy as np
import pytest
from simulated_sets import COULOMB, diagnosed
from small_arms import ROOT
from synthetic_solution import solution as synthetic

from stiffopt.cli import run
from stiffopt.errors import InputError, InputFileError
from stiffopt.files import apply_changes
from stiffopt.problem.files import load_problem
from stiffopt.report.compare import compare_results
from stiffopt.solver.solve import solve

TWO_LINK = ROOT / "problems" / "two_link.toml"


@pytest.fixture(scope="module")
def solution():
    return solve(load_problem(TWO_LINK))


def test_a_solution_is_one_line_and_a_small_table(solution):
    text = repr(solution)
    assert text.startswith("<Solution optimal, torque_squared 0.1055 s, 1 s")
    assert len(text) < 200
    page = solution._repr_html_()
    assert "<th" in page
    assert "optimal" in page


def test_a_solution_is_a_data_frame(solution):
    pytest.importorskip("pandas")
    frame = solution.to_dataframe()
    assert {"t", "q1", "qd2", "tau1", "tool_x", "deflection_total"} <= set(frame.columns)
    assert frame["t"].iloc[-1] == pytest.approx(1.0)
    assert frame["q2"].iloc[-1] == pytest.approx(0.5)


def test_a_solution_is_a_figure(solution):
    figure = solution.plot()
    assert len(figure.axes) == 4
    drawn = figure.axes[0].lines[0].get_ydata()
    assert np.asarray(drawn) == pytest.approx(solution.assessment.position[:, 0])


def test_without_a_motion_it_says_so():
    lost = synthetic(1, assessment=None, objective=None, trajectory=None)
    assert repr(lost).startswith("<Solution ")
    with pytest.raises(InputError, match="there is no motion"):
        lost.to_dataframe()
    with pytest.raises(InputError, match="there is no motion"):
        lost.plot()


def test_a_diagnosis_shows_itself():
    pytest.importorskip("pandas")
    diagnosis = diagnosed(COULOMB)
    assert "named, coulomb of joint 2, test" in repr(diagnosis)
    assert "<table>" in diagnosis._repr_html_()
    frame = diagnosis.to_dataframe()
    assert list(frame["effect"]) == ["coulomb"]
    assert list(frame["parameter"]) == ["dFc"]
    assert diagnosis.plot().axes


@pytest.mark.parametrize(
    ("change", "place", "value"),
    [
        ("motion.duration=0.5 s", ("motion", "duration"), "0.5 s"),
        ("minimise[1].weight=2", ("minimise", 0, "weight"), 2),
        ("limits.scale.velocity=0.5", ("limits", "scale", "velocity"), 0.5),
        ("list[2]=[1, 2]", ("list", 1), [1, 2]),
    ],
)
def test_changes_of_a_file(change, place, value):
    data = {"motion": {"duration": 1.0}, "minimise": [{}], "list": [0, 0]}
    held = apply_changes(data, [change], "p.toml")
    for key in place:
        held = held[key]
    assert held == value


@pytest.mark.parametrize("change", ["duration", "=3", "minimise[4].weight=2", "motion[1]=2"])
def test_changes_that_have_no_place(change):
    with pytest.raises(InputFileError, match="--set"):
        apply_changes({"motion": {}, "minimise": [{}]}, [change], "p.toml")


def test_one_entry_changed_for_a_run_and_the_answers_compared(tmp_path, capsys):
    one, two = tmp_path / "one", tmp_path / "two"
    assert run(["solve", str(TWO_LINK), "--out", str(one), "--quiet"]) == 0
    changed = ["--set", "motion.duration=2 s"]
    assert run(["solve", str(TWO_LINK), "--out", str(two), "--quiet", *changed]) == 0
    values = [json.loads((f / "result.json").read_text())["objective"]["value"] for f in (one, two)]
    # The integral of the squared torque falls with the third power of the duration.
    assert values[0] / values[1] == pytest.approx(8.0, rel=1e-5)
    capsys.readouterr()
    assert run(["compare", str(one), str(two)]) == 0
    said = capsys.readouterr().out
    assert "objective, value" in said
    assert "objective.value" not in said
    assert "-87.5 %" in said
    assert run(["compare", str(one), str(one)]) == 0
    assert "no differences" in capsys.readouterr().out
    assert run(["compare", str(one), str(tmp_path)]) == 2
    assert run(["solve", str(TWO_LINK), "--set", "motion.durration=1 s"]) == 2
    assert "Did you mean 'duration'?" in capsys.readouterr().err


def test_another_joint_is_no_percentage(tmp_path):
    for name, joint, time in (("one", 6, 1.0), ("two", 4, 1.5)):
        (tmp_path / name).mkdir()
        answer = {"worst": {"joint": joint, "time": time}}
        (tmp_path / name / "result.json").write_text(json.dumps(answer))
    _, rows = compare_results(tmp_path / "one", tmp_path / "two")
    assert rows == [("worst, joint", "6", "4", ""), ("worst, time", "1 s", "1.5 s", "+50 %")]


def test_values_of_different_objectives_have_no_relative_change(tmp_path):
    for name, objective, measure, value in (
        ("one", "deflection", "peak", 1e-3),
        ("two", "deflection", "rms", 5e-4),
        ("three", "torque_squared", None, 8.0),
        ("four", "deflection", "peak", 2e-3),
    ):
        (tmp_path / name).mkdir()
        answer = {
            "objective": {"name": objective, "measure": measure, "value": value},
            "baselines": {"quintic": {"objective": 2.0 * value, "duration": 1.0 + value}},
        }
        (tmp_path / name / "result.json").write_text(json.dumps(answer))
    for other in ("two", "three"):
        _, rows = compare_results(tmp_path / "one", tmp_path / other)
        changes = {name: change for name, _, _, change in rows}
        assert changes["objective, value"] == "different objectives"
        assert changes["baselines, quintic, objective"] == "different objectives"
        assert changes["baselines, quintic, duration"].endswith("%") or other == "three"
    _, rows = compare_results(tmp_path / "one", tmp_path / "four")
    assert {name: change for name, _, _, change in rows}["objective, value"] == "+100 %"


def test_the_report_opens_where_it_is_asked_for(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert run(["solve", str(TWO_LINK), "--out", str(tmp_path), "--quiet", "--open"]) == 0
    assert opened == [(tmp_path / "report.html").resolve().as_uri()]
