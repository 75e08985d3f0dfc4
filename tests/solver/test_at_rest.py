"""When iterates that no longer move are an optimum: full steps alone say so."""

import pytest

from stiffopt.solver.monitor import _RESTING, Monitor


class _Entry:
    def __init__(self, objective, violation=0.0):
        self.objective, self.violation = objective, violation


def _monitor(steps, objectives):
    monitor = Monitor.__new__(Monitor)
    monitor.steps = list(steps)
    monitor.history = [_Entry(each) for each in objectives]
    return monitor


FULL = [1.0] * 8


@pytest.mark.parametrize("length", [1.0, 1e-9])
def test_steps_that_a_line_search_cuts_are_no_rest(length):
    monitor = _monitor([1e-12] * 8, [2e-6] * 8)
    assert monitor.at_rest(1e-7, [1.0] * 3 + [length] * 5) is (length == 1.0)


def test_what_moves_or_changes_is_not_at_rest():
    still, one = [1e-12] * 8, [2e-6] * 8
    assert not _monitor([*still[:-1], 1e-3], one).at_rest(1e-7, FULL)
    assert not _monitor(still, [*one[:-1], 3e-6]).at_rest(1e-7, FULL)
    assert not _monitor(still[: _RESTING - 1], one).at_rest(1e-7, FULL)
    monitor = _monitor(still, one)
    monitor.history[-1].violation = 1e-3
    assert not monitor.at_rest(1e-7, FULL)
