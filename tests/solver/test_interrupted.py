"""Ctrl-C between the solver's runs: the best result so far is kept and reported."""

import json
import signal
from dataclasses import replace

import numpy as np
import pytest
from small_arms import write_problem

from stiffopt.cli import run
from stiffopt.problem import files
from stiffopt.problem.files import load_problem
from stiffopt.report.solve.wording import comparison
from stiffopt.result.status import SolveStatus
from stiffopt.solver import solve as solving
from stiffopt.solver import stages


@pytest.fixture(scope="module")
def stated(tmp_path_factory):
    path = write_problem(
        tmp_path_factory.mktemp("interrupted"),
        minimise='objective = "dynamic_deflection"\nmeasure = "peak"',
        method="intervals = 16",
    )
    return load_problem(path).problem


def interrupted_at(monkeypatch, number):
    """Ctrl-C while the programme of that number is built, from 1."""
    plain, count = stages.build_programme, iter(range(1, 100))

    def make(*arguments, **named):
        if next(count) == number:
            raise KeyboardInterrupt
        return plain(*arguments, **named)

    monkeypatch.setattr(stages, "build_programme", make)


def test_before_the_first_stage_the_better_baseline_is_kept(stated, monkeypatch):
    interrupted_at(monkeypatch, 1)
    kept = solving.solve(stated)
    assert kept.status is SolveStatus.INTERRUPTED
    assert kept.message.startswith("Stopped by the user before the optimiser had a motion")
    names = [name for name, each in kept.baselines.items() if f"the {name} motion" in kept.message]
    (name,) = names
    assert kept.assessment is kept.baselines[name].assessment
    assert kept.objective.value == kept.baselines[name].objective
    assert kept.trajectory.duration == pytest.approx(0.5)
    assert "keeps all limits" in kept.message
    assert "stopped before its comparison" in comparison(stated, kept)


def test_where_no_baseline_keeps_every_limit_the_one_that_exceeds_least_is_kept(
    stated, monkeypatch
):
    """At 400 rad/s^3 the quintic motion exceeds its jerk a little, the time-optimal one jumps."""
    interrupted_at(monkeypatch, 1)
    limits = replace(stated.limits, jerk=np.full(stated.robot.n, 400.0))
    kept = solving.solve(replace(stated, limits=limits))
    excess = [each.assessment.worst_violation.value for each in kept.baselines.values()]
    assert kept.assessment.worst_violation.value == min(excess)
    assert min(excess) < 0.5 * max(excess)


def test_between_stages_the_last_one_is_kept(stated, monkeypatch):
    interrupted_at(monkeypatch, 2)
    kept = solving.solve(stated)
    assert kept.status is SolveStatus.INTERRUPTED
    assert "the best motion so far is kept" in kept.message
    assert kept.solver.iterations > 0
    assert kept.objective.value < min(b.objective for b in kept.baselines.values())


def test_interruption_before_any_motion_is_raised(stated, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(solving, "baselines", interrupted)
    with pytest.raises(KeyboardInterrupt):
        solving.solve(stated)


def test_command_interrupted_early_returns_a_motion(tmp_path, monkeypatch, capsys):
    path, out = write_problem(tmp_path), tmp_path / "out"
    plain = files.load_problem

    def pressed(*arguments, **options):
        signal.raise_signal(signal.SIGINT)
        return plain(*arguments, **options)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        monkeypatch.setattr(files, "load_problem", pressed)
        assert run(["solve", str(path), "--out", str(out), "--quiet"]) == 130
        assert capsys.readouterr().out.startswith("interrupted: Stopped by the user before")
        assert json.loads((out / "result.json").read_text())["status"] == "interrupted"
        # An earlier result is better than a baseline.
        earlier = {each.name: each.read_bytes() for each in out.iterdir() if each.is_file()}
        assert run(["solve", str(path), "--out", str(out), "--quiet"]) == 130
        assert "the earlier result" in capsys.readouterr().err
        assert earlier == {each.name: each.read_bytes() for each in out.iterdir() if each.is_file()}
    finally:
        signal.signal(signal.SIGINT, before)
