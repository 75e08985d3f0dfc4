"""Robust plans, chosen for uncertain arms where an uncertainty is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_arms import load

from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.command.compensation import commands_on_arms
from stiffopt.command.simulated_solution import with_simulation
from stiffopt.command.simulation import PlannedMotion, elastic_arm
from stiffopt.elastic.uncertainty import AssumedUncertainty, Uncertainty
from stiffopt.problem.objective import Objective
from stiffopt.problem.resolve import resolve
from stiffopt.result.status import SolveStatus
from stiffopt.solver import robust_plan
from stiffopt.solver.input_shaping import windows_for_arms
from stiffopt.solver.solve import solve, solve_with_state

DEVIATION = 'objective = "tool_deviation"'


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    """A planar arm without stated uncertainties."""
    return load(tmp_path_factory.mktemp("arm"), minimise=DEVIATION)


@pytest.fixture(scope="module")
def unsure(problem):
    """The same where as much is stated as would be assumed, and little may be given for it."""
    return replace(problem, uncertainty=Uncertainty(price=0.01))


@pytest.fixture(scope="module")
def solved(problem, unsure):
    return solve(problem), solve(unsure)


def rate(solution):
    """Mean squared rate of the planned deviation [m^2/s^2]."""
    motion = solution.assessment
    rates = np.gradient(motion.deflection["dynamic"], motion.time, axis=0)
    return np.trapezoid(np.sum(rates**2, axis=1), motion.time) / motion.duration


def at_worst(problem, solution):
    """Share of the wind-up that the command leads by; worst peaks in flight and after arrival."""
    arm = elastic_arm(problem, solution.assessment.position[0])
    own = PlannedMotion.of("optimised", solution.assessment, True)
    (made,) = commands_on_arms(problem, arm, [replace(own, motors=solution.trajectory)])
    motion = made.for_reports()
    assert motion.excess == ()
    return motion.share, motion.compensated.flight.worst, motion.compensated.after.worst


def test_objective_cost_of_a_slower_deviation_is_small(solved):
    least, found = solved
    assert found.status is SolveStatus.OPTIMAL
    assert found.assessment.feasible(CERTIFICATE_TOLERANCE)
    cost = found.objective.value / least.objective.value - 1.0
    assert -1e-3 < cost < 1e-2
    assert rate(found) < 0.97 * rate(least)
    assert any("As [uncertainty] is stated" in note for note in found.notes)
    assert not any("As [uncertainty] is stated" in note for note in least.notes)


def test_the_command_deviates_less_on_the_worst_arm(unsure, solved):
    (_, *least), (share, *found) = (at_worst(unsure, each) for each in solved)
    assert share > 1.0
    assert sum(found) < sum(least)


def test_only_given_uncertainty_counts_as_stated(problem, unsure, tmp_path):
    assert not problem.uncertainty.stated
    assert not problem.chosen_for_robustness
    assert unsure.uncertainty.stated
    assert unsure.chosen_for_robustness
    said = load(tmp_path, minimise=DEVIATION, extra="[uncertainty]\nstiffness = 0.2")
    assert said.uncertainty.stated
    assert said.uncertainty != AssumedUncertainty()
    assert replace(problem.uncertainty, payload=0.3) != AssumedUncertainty()


def test_robust_plan_needs_single_deviation_and_fixed_duration(unsure):
    for changes in (
        {"duration": (0.3, 0.6)},
        {"objectives": (*unsure.objectives, Objective(name="torque_squared"))},
        {"objectives": (Objective(name="shaped_deviation"),)},
        {"objectives": (Objective(name="dynamic_deflection"),)},
    ):
        assert not replace(unsure, **changes).chosen_for_robustness


def test_too_costly_motion_is_rejected(unsure, monkeypatch):
    monkeypatch.setattr("stiffopt.solver.solve.robust_plan", lambda run, outcome: outcome)
    _, (run, outcome) = solve_with_state(unsure)
    monkeypatch.undo()
    monkeypatch.setattr(robust_plan, "_MAX_CERTIFIED_COST", -1.0)
    bounds = outcome.solver.nlp
    assert robust_plan.robust_plan(run, outcome) is outcome
    assert outcome.solver.nlp is bounds


def test_interruption_keeps_the_optimum(unsure, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(robust_plan, "solve_again", interrupted)
    found = solve(unsure, throw=False)
    assert found.status is SolveStatus.INTERRUPTED
    assert found.assessment.feasible(CERTIFICATE_TOLERANCE)


def test_rms_objective_has_a_robust_plan(unsure):
    goal = Objective(name="tool_deviation", measure="rms")
    found = solve(replace(unsure, objectives=(goal,)))
    least = solve(replace(unsure, objectives=(goal,), uncertainty=AssumedUncertainty()))
    assert found.status is SolveStatus.OPTIMAL
    assert found.objective.value <= 1.01 * least.objective.value


@pytest.fixture(scope="module")
def averaged(problem):
    """The price exceeds the cost of a motion averaged over most of a period."""
    generous = replace(problem, uncertainty=Uncertainty(price=1.0))
    return generous, solve(generous)


def test_shaped_motion_is_used_where_its_gain_exceeds_its_cost(unsure, solved, averaged):
    least, near = solved
    problem, found = averaged
    assert found.status is SolveStatus.OPTIMAL
    assert found.objective.name == "tool_deviation"
    assert found.solver.iterations > near.solver.iterations
    assert found.assessment.feasible(CERTIFICATE_TOLERANCE)
    given = [note for note in found.notes if note.startswith("As [uncertainty] is stated, ")]
    assert len(given) == 1
    assert "residual vibration is smaller" in given[0]
    assert any(note.startswith("Averaged over") for note in found.notes)
    cost = found.objective.value / least.objective.value
    assert 1.01 < cost < 2.0
    (_, *before), (_, *after) = at_worst(unsure, near), at_worst(problem, found)
    assert sum(after) * cost < sum(before)


def test_zero_price_keeps_the_optimum(problem, solved):
    found = solve(replace(problem, uncertainty=Uncertainty(price=0.0)))
    assert found.objective.value <= (1.0 + 1e-9) * solved[0].objective.value
    assert not any("As [uncertainty] is stated" in note for note in found.notes)


def test_windows_that_cost_too_much_are_not_tried(problem):
    motion = resolve(problem)
    tried = [windows_for_arms(problem, motion, price) for price in (0.0, 0.1, 0.3, 1.0)]
    assert tried[0] == ()
    assert [len(each) for each in tried] == sorted(len(each) for each in tried)
    assert [share for share, _ in tried[-1]] == [1.0, 0.75, 0.5]


def test_interruption_of_shaping_keeps_the_solution(averaged, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("stiffopt.solver.solve.solve_shaped", interrupted)
    found = solve(averaged[0], throw=False)
    assert found.status is SolveStatus.INTERRUPTED
    assert found.assessment.feasible(CERTIFICATE_TOLERANCE)


@pytest.mark.slow
def test_fastest_motion_has_a_command_where_an_uncertainty_is_stated(tmp_path):
    """Motors that lead the motion at the limits of the plan would exceed their own."""
    fastest = load(
        tmp_path, minimise='objective = "duration"', duration="{ lower = 0.1, upper = 5.0 }"
    )
    assert not fastest.plans_links
    asked = replace(fastest, uncertainty=Uncertainty(draws=50))
    bare, led = (solve(each) for each in (fastest, asked))
    assert bare.duration < led.duration < 1.15 * bare.duration
    assert with_simulation(asked, led).compensation.command is not None
    arm = elastic_arm(asked, bare.assessment.position[0])
    planned = PlannedMotion.of("bare", bare.assessment, True)
    (refused,) = commands_on_arms(asked, arm, [planned])
    assert refused.excess[0].value > 0.1
