"""Replays: the recipe of a result, solved again and compared."""

import json

import pytest
from small_arms import write_problem

from stiffopt.cli import run
from stiffopt.errors import InputFileError
from stiffopt.folders import MANIFEST
from stiffopt.recipe.replay import replay
from stiffopt.recipe.stored_result import STATE_FILE, read_state
from stiffopt.result.store import RESULT_FILE
from stiffopt.solver.family import WarmStart

PIECES = {"method": "intervals = 20"}


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Problem file and result folder of a solve without a report."""
    folder = tmp_path_factory.mktemp("stored")
    path = write_problem(folder, "planar", **PIECES)
    assert run(["solve", str(path), "--out", str(folder / "one"), "--no-report", "--quiet"]) == 0
    return path, folder / "one"


def test_without_a_report_there_is_no_page(stored):
    assert not (stored[1] / "report.html").exists()
    assert isinstance(read_state(stored[1]), WarmStart)


def test_a_result_is_reproduced(stored):
    found = replay(stored[1])
    assert found.differences == ()
    document = json.loads((stored[1] / RESULT_FILE).read_text())
    assert found.solution.objective.value == pytest.approx(document["objective"]["value"], rel=1e-9)


def test_the_first_stage_that_differs_is_named(stored, monkeypatch):
    from stiffopt.recipe import replay as module

    plain = module.read_document

    def changed(path):
        document = plain(path)
        document["solver"]["homotopy"][0]["objective"] *= 1.001
        return document

    monkeypatch.setattr(module, "read_document", changed)
    (difference,) = replay(stored[1]).differences
    assert difference.startswith("stage 1: objective ")


def test_a_changed_problem_is_refused(stored, tmp_path):
    path, folder = stored
    text = path.read_text()
    path.write_text(text.replace("intervals = 20", "intervals = 24"))
    try:
        with pytest.raises(InputFileError, match="differs from the problem solved"):
            replay(folder)
    finally:
        path.write_text(text)


def test_a_page_is_drawn_when_asked(stored):
    assert run(["report", str(stored[1]), "--quiet"]) == 0
    assert (stored[1] / "report.html").is_file()
    listed = json.loads((stored[1] / MANIFEST).read_text())["files"]
    assert listed["report.html"]["by"] == "report"
    assert listed["report.html"]["of"] == "solve"


def test_a_guess_starts_from_the_solved_state(stored):
    path, folder = stored
    other = folder.parent / "two"
    longer = ["--set", "motion.duration='0.515 s'", "--no-report", "--quiet"]
    assert run(["solve", str(path), "--guess", str(folder), "--out", str(other), *longer]) == 0
    solver = json.loads((other / RESULT_FILE).read_text())["solver"]
    before = json.loads((folder / RESULT_FILE).read_text())["solver"]
    # One programme, from the state.
    assert len(solver["homotopy"]) == 1
    assert solver["iterations"] < before["iterations"]
    assert replay(other).differences == ()


def test_a_state_that_is_cut_off_is_no_start(stored, tmp_path):
    content = (stored[1] / STATE_FILE).read_bytes()
    assert WarmStart.from_bytes(content[:-8]) is None
