"""Timing of a path until its command keeps the limits of the motors."""

from types import SimpleNamespace

import numpy as np
import pytest

from stiffopt.baseline.rivals import quintic_law
from stiffopt.problem.limit import Limits
from stiffopt.result.assessment import DriveHistory, Violation
from stiffopt.robot.files import load_robot
from stiffopt.solver import path_command


@pytest.mark.parametrize("kept_from", [0, 1, 9])
def test_path_is_timed_again_with_less_jerk_where_the_command_exceeds_it(monkeypatch, kept_from):
    """The excess is told of the fastest timing where no back-off removes it."""
    limits, law, asked = Limits.of(load_robot("er3a_c60")), quintic_law(1.0), []
    time = np.linspace(0.0, 1.0, 501)
    rest = np.zeros((501, 6))
    history = DriveHistory(time, rest, rest, rest, rest, rest)

    def timed_path(problem, shares=None):
        along = None if shares is None else shares.of_piece(0)("jerk", law(np.array([0.5, 0.9])))
        asked.append(None if along is None else along[:, 0])
        return SimpleNamespace(number=len(asked), assessment=history), law

    def command(run, timed):
        excess = () if timed.number > kept_from else (Violation(0.2, "jerk", 2, 0.5),)
        return SimpleNamespace(excess=excess, motors=None)

    monkeypatch.setattr(path_command, "timed_path", timed_path)
    monkeypatch.setattr(path_command, "_command", command)
    monkeypatch.setattr(path_command, "drive_history", lambda *_: (history, None))
    problem = SimpleNamespace(leads_on_path=True, active_limits=limits)
    run = SimpleNamespace(problem=problem, notes=[], command=None, tell=lambda _: None)
    found = path_command.led_timing(run)
    if kept_from == 9:
        assert (found.number, run.command, run.notes) == (1, None, [])
        return
    assert found.number == kept_from + 1
    assert run.command is not None
    assert len(run.notes) == kept_from
    if kept_from:
        np.testing.assert_allclose(asked[1], [0.99 / 1.2, 1.0], rtol=1e-3)


def test_interrupted_search_of_a_command_keeps_the_timing(monkeypatch):
    timed = SimpleNamespace(assessment=None)

    def command(run, timed):
        raise KeyboardInterrupt

    monkeypatch.setattr(path_command, "timed_path", lambda problem: (timed, None))
    monkeypatch.setattr(path_command, "_command", command)
    problem = SimpleNamespace(leads_on_path=True)
    run = SimpleNamespace(problem=problem, notes=[], command=None, tell=lambda _: None)
    assert path_command.led_timing(run) is timed
    assert run.interrupted
    assert "interrupted" in run.notes[0]
