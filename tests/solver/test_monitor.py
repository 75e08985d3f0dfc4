"""Stationary iterates count as an optimum after full steps only."""

import threading
import time

import pytest

from stiffopt.solver.monitor import _STATIONARY_ITERATIONS, Monitor


class _Entry:
    def __init__(self, objective, violation=0.0):
        self.objective, self.violation = objective, violation


def _monitor(steps, objectives):
    monitor = Monitor.__new__(Monitor)
    monitor.still_step = 1e-7
    monitor.steps = list(steps)
    monitor.history = [_Entry(each) for each in objectives]
    return monitor


FULL = [1.0] * 8


@pytest.mark.parametrize("length", [1.0, 1e-9])
def test_shortened_steps_are_not_stationary(length):
    monitor = _monitor([1e-12] * 8, [2e-6] * 8)
    assert monitor.is_stationary([1.0] * 3 + [length] * 5) is (length == 1.0)


def test_moving_iterates_are_not_stationary():
    still, one = [1e-12] * 8, [2e-6] * 8
    assert not _monitor([*still[:-1], 1e-3], one).is_stationary(FULL)
    assert not _monitor(still, [*one[:-1], 3e-6]).is_stationary(FULL)
    assert not _monitor(still[: _STATIONARY_ITERATIONS - 1], one).is_stationary(FULL)
    monitor = _monitor(still, one)
    monitor.history[-1].violation = 1e-3
    assert not monitor.is_stationary(FULL)


def test_shortened_step_after_full_ones_stays_stationary():
    """Rounding shortens steps of a nearly vanishing vibration."""
    rested = _monitor([1e-2, 1e-2, *[1e-9] * 8], [3.0, 2.0, 1.0, *[1.0] * 8])
    assert rested.is_stationary([1.0] * 9 + [0.5, 1.0])
    # Never five full steps in a row.
    assert not rested.is_stationary([1.0] * 6 + [0.5, 1.0, 1.0, 0.5, 1.0])
    # Led away since.
    away = _monitor([1e-2, *[1e-9] * 7, 1e-3, 1e-9], [3.0, 2.0, *[1.0] * 9])
    assert not away.is_stationary([1.0] * 11)


@pytest.mark.parametrize(
    ("step", "ended", "expected"),
    [(1e-12, True, "optimal"), (1e-12, False, ""), (1e-3, True, "")],
)
def test_solve_stops_once_only_rounding_is_left(step, ended, expected):
    """The costly check is asked for only after small steps."""
    monitor = _monitor([1e-2, *[step] * _STATIONARY_ITERATIONS], [1.0] * 7)
    monitor._record_iterate = lambda arg: None
    monitor.stopped_by, monitor.interrupt = "", threading.Event()
    monitor.started, monitor.max_seconds = time.perf_counter(), 60.0
    monitor.max_iterations, monitor.patience, monitor.best = None, 0, None
    monitor.has_ended = lambda: ended
    assert monitor._evaluate_stop([]) == float(expected == "optimal")
    assert monitor.stopped_by == expected
