"""Replays: the recipe of a result, solved again and compared."""

import hmac
import json
from collections import OrderedDict
from dataclasses import replace

import numpy as np
import pytest
from small_arms import write_problem

from stiffopt import native
from stiffopt.cli import run
from stiffopt.elastic.uncertainty import Uncertainty
from stiffopt.errors import InputFileError
from stiffopt.folders import MANIFEST
from stiffopt.problem.files import load_problem
from stiffopt.recipe.replay import replay
from stiffopt.recipe.stored_result import PREPARED_FILE, STATE_FILE, read_state
from stiffopt.report.solve.page import write_solve_report
from stiffopt.result.archive import ARCHIVE_FILE, read_archive, write_archive
from stiffopt.result.store import RESULT_FILE
from stiffopt.solver.family import ProblemFamily, WarmStart
from stiffopt.solver.solve import complete_comparison, solve

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


def test_a_page_is_drawn_when_asked_without_a_solve(stored, monkeypatch):
    from stiffopt.solver.ipopt import IpoptSolver

    monkeypatch.setattr(IpoptSolver, "solve", None)
    assert run(["report", str(stored[1])]) == 0
    assert (stored[1] / "report.html").is_file()
    listed = json.loads((stored[1] / MANIFEST).read_text())["files"]
    assert listed["report.html"]["by"] == "report"
    assert listed["report.html"]["of"] == "solve"


def test_an_archived_solution_is_the_same(tmp_path):
    """With its simulation and command, which are most of it."""
    problem = load_problem(write_problem(tmp_path, "planar", **PIECES)).problem
    solution = solve(problem, simulate=True)
    assert solution.simulation is not None
    write_archive(solution, tmp_path)
    again = read_archive(tmp_path)
    one, other = tmp_path / "one", tmp_path / "other"
    for folder, each in ((one, solution), (other, again)):
        folder.mkdir()
        write_solve_report(problem, each, folder)
    assert (one / "report.html").read_bytes() == (other / "report.html").read_bytes()
    assert again.trajectory(0.1).tolist() == solution.trajectory(0.1).tolist()


def test_rivals_are_simulated_when_the_page_is_drawn(tmp_path):
    problem = load_problem(write_problem(tmp_path, "planar", **PIECES)).problem
    problem = replace(problem, uncertainty=Uncertainty(draws=50))
    whole, family = solve(problem, simulate=True), ProblemFamily()
    alone, state = family.solve(problem, simulate=True, beside_rivals=False)
    again, _ = family.solve(problem, state, simulate=True, beside_rivals=False)
    assert [each.name for each in alone.simulation.motions] == ["optimised"]
    assert not again.baselines
    # What the page completes is no part of the message.
    assert "baseline" not in again.message
    assert "no baseline" in whole.message
    for each in (alone, again):
        found = complete_comparison(problem, each)
        assert [each.name for each in found.simulation.motions] == [
            each.name for each in whole.simulation.motions
        ]
        rival, other = (each.compensation.best_rival for each in (found, whole))
        assert rival.compensated.worst_case == pytest.approx(other.compensated.worst_case)
        assert found.ratio_to_better_baseline == pytest.approx(
            whole.ratio_to_better_baseline, rel=1e-6
        )


def test_a_damaged_archive_is_refused(stored, tmp_path):
    content = (stored[1] / ARCHIVE_FILE).read_bytes()
    (tmp_path / ARCHIVE_FILE).write_bytes(content[:1000])
    with pytest.raises(InputFileError, match="cannot be read"):
        read_archive(tmp_path)
    np.savez(tmp_path / ARCHIVE_FILE, structure=np.array('{"class": "os:popen", "fields": {}}'))
    with pytest.raises(InputFileError, match="no module of results"):
        read_archive(tmp_path)


def test_a_solve_that_drew_its_page_cannot_draw_it_again(stored, tmp_path, capsys):
    for name in (RESULT_FILE, "trajectory.csv"):
        (tmp_path / name).write_bytes((stored[1] / name).read_bytes())
    assert run(["report", str(tmp_path)]) == 2
    assert "--no-report" in capsys.readouterr().err


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


def test_functions_of_an_earlier_process_are_not_prepared_again(stored, tmp_path, monkeypatch):
    from stiffopt.transcription import node_derivatives, point_function, prepared

    kept = (
        (node_derivatives, "kept_formulas"),
        (point_function, "kept_functions"),
        (point_function, "kept_batches"),
    )
    for module, name in kept:
        monkeypatch.setattr(module, name, OrderedDict())
        if hasattr(prepared, name):
            monkeypatch.setattr(prepared, name, getattr(module, name))
    # What cannot be read, or was written by another user, is prepared again.
    other, content = tmp_path / PREPARED_FILE, (stored[1] / PREPARED_FILE).read_bytes()
    for written in (
        b"",
        content[:-100],
        content[:-32] + hmac.digest(bytes(32), content[:-32], "sha256"),
    ):
        other.write_bytes(written)
        prepared.read_prepared(other)
        assert not node_derivatives.kept_formulas
    state = read_state(stored[1])
    assert node_derivatives.kept_formulas
    monkeypatch.setattr(node_derivatives, "_without_numbers", None)
    if native.library() is not None:
        monkeypatch.setattr(node_derivatives, "with_derivatives", None)
    problem = load_problem(stored[0]).problem
    solution, _ = ProblemFamily().solve(replace(problem, duration=(0.515, 0.515)), state)
    assert solution.status.usable
    assert len(solution.solver.homotopy) == 1


def test_a_state_that_is_cut_off_is_no_start(stored, tmp_path):
    content = (stored[1] / STATE_FILE).read_bytes()
    assert WarmStart.from_bytes(content[:-8]) is None
    head, _, numbers = content.partition(b"\n")
    for key, value in (("scales", None), ("scales", {"torque_squared": "x"}), ("smoothing", ["a"])):
        forged = json.dumps({**json.loads(head), key: value}).encode()
        assert WarmStart.from_bytes(forged + b"\n" + numbers) is None
    for factor in (np.nan, 0.0, 1e300):
        forged = (factor * np.frombuffer(numbers, "<f8")).tobytes()
        assert WarmStart.from_bytes(head + b"\n" + forged) is None
