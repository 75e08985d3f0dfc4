"""Exchange loop: acceptance, budget, log and Ctrl-C, on numbers in place of motions."""

from types import SimpleNamespace

import pytest

from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.interrupts import until_interrupted
from stiffopt.solver.exchange import (
    Oracle,
    OutcomeOracle,
    Proposal,
    exchange,
)


class Listed(Oracle[float]):
    """Oracle whose solves give listed numbers, the lower the better."""

    step = "listed"

    def __init__(self, values, rounds=10, explores=True):
        self.values, self.rounds, self.restored = iter(values), rounds, None
        self.explores = explores

    def propose(self, last, number):
        value = next(self.values, None)
        return None if value is None else Proposal(f"round {number}", lambda: value)

    def rank(self, found):
        return (found,)

    def restore(self, best):
        self.restored = best


@pytest.fixture
def run():
    return SimpleNamespace(
        step="before",
        exchanges=[],
        homotopy=[],
        left_out=[],
        iterations=0,
        is_over=False,
        leave_out=[].append,
    )


def test_best_motion_is_kept_and_restored(run):
    oracle = Listed([3.0, 5.0, 2.0, 4.0])
    assert exchange(run, oracle, 4.0) == 2.0
    assert oracle.restored == 2.0
    assert run.step == "before"
    assert [each["accepted"] for each in run.exchanges] == [True, False, True, False]
    assert run.exchanges[0] == {
        "step": "listed",
        "reason": "round 0",
        "iterations": 0,
        "accepted": True,
        "ended": "",
    }


def test_start_is_kept_where_no_motion_is_better(run):
    assert exchange(run, Listed([5.0, 6.0]), 4.0) == 4.0


def test_oracle_without_exploration_ends_at_the_first_motion_left_out(run):
    assert exchange(run, Listed([3.0, 5.0, 2.0], explores=False), 4.0) == 3.0
    assert len(run.exchanges) == 2


@pytest.mark.parametrize("rounds", [0, 2])
def test_rounds_bound_the_work(run, rounds):
    assert exchange(run, Listed([3.0, 2.0, 1.0], rounds=rounds), 4.0) == 4.0 - rounds
    assert len(run.exchanges) == rounds


def test_time_limit_within_a_solve_ends_the_oracle(run):
    run.left_out.append("listed")
    assert exchange(run, Listed([3.0, 2.0]), 4.0) == 3.0


def test_time_limit_before_a_solve_names_the_step_left_out(run):
    run.is_over, run.leave_out = True, run.left_out.append
    assert exchange(run, Listed([3.0]), 4.0) == 4.0
    assert run.left_out == ["listed"]
    # Nothing is left out where nothing was objected to.
    run.left_out.clear()
    assert exchange(run, Listed([]), 4.0) == 4.0
    assert run.left_out == []


def test_ctrl_c_returns_what_is_kept():
    def pressed():
        raise KeyboardInterrupt

    assert until_interrupted(pressed, lambda: "kept") == "kept"
    assert until_interrupted(lambda: "done", pressed) == "done"


class RankedByExcess(OutcomeOracle):
    """Oracle of stand-ins for outcomes, ranked by their excess of a limit."""

    def rank(self, found):
        return (max(found.excess, CERTIFICATE_TOLERANCE), found.failed)


def solved_motion(excess, *, failed):
    kept = excess <= CERTIFICATE_TOLERANCE
    assessment = SimpleNamespace(feasible=lambda tolerance: kept)
    return SimpleNamespace(excess=excess, failed=failed, assessment=assessment)


def test_stalled_motion_within_all_limits_replaces_an_optimum_that_exceeds_one():
    oracle, optimum = RankedByExcess(None), solved_motion(0.0099, failed=False)
    assert oracle.accepts(solved_motion(0.0012, failed=True), optimum)
    # Its optimum is kept where a stalled one exceeds a limit too, and where both keep all.
    assert not oracle.accepts(solved_motion(0.0060, failed=True), optimum)
    assert not oracle.accepts(
        solved_motion(0.0012, failed=True), solved_motion(0.0012, failed=False)
    )
