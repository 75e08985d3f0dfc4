"""Elastic simulation of solutions and baselines: files, comparison, messages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_arms import load

from stiffopt.baseline.baselines import baselines, slowed_quintic
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.command.simulated_solution import with_simulation
from stiffopt.command.simulation import rival_motions
from stiffopt.elastic.uncertainty import Uncertainty
from stiffopt.errors import RobotError
from stiffopt.problem.resolve import resolve
from stiffopt.report.common.text import si
from stiffopt.report.solve.wording import (
    comparison,
    difference_text,
    headline_text,
    simulation_section,
)
from stiffopt.result.store import result_document
from stiffopt.solver.solve import solve

PEAK = 'objective = "dynamic_deflection"'


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    problem = load(tmp_path_factory.mktemp("arm"), minimise=PEAK)
    return problem, solve(problem, simulate=True)


def test_the_motion_and_its_baselines_are_simulated(solved):
    problem, solution = solved
    simulation = solution.simulation
    assert {motion.name for motion in simulation.motions} >= {"optimised", "quintic", "S-curve"}
    assert simulation.measure == "peak"
    assert simulation.assumed_damping == (1, 2)
    for motion in simulation.motions:
        assert motion.planned.peak > 0.0
        assert motion.simulated.peak > 0.5 * motion.planned.peak
        assert motion.simulated.time[-1] == pytest.approx(motion.simulated.duration + 1.0)
    assert solve(problem).simulation is None


def test_headline_and_comparison_are_of_the_simulated_motion(solved):
    problem, solution = solved
    found = solution.simulation.optimised.simulated
    given = solution.compensation
    own = replace(given.optimised, excess=())
    led = replace(given, motions=(own, *given.motions[1:]))
    headline = headline_text(replace(solution, compensation=led))
    worst = own.compensated
    assert f"{si(worst.flight.worst, 'm', 3)} in flight" in headline
    assert f"{si(worst.after.worst, 'm', 3)} after arrival" in headline
    unled = headline_text(replace(solution, compensation=None))
    assert f"{si(found.peak, 'm', 3)} in flight, {si(found.peak_after, 'm', 3)}" in unled
    assert "on the same uncertain arms" in comparison(problem, solution)
    plain = replace(solution, simulation=None, compensation=None)
    assert "simulated" not in headline_text(plain) + comparison(problem, plain)
    assert difference_text(problem, plain) == ""
    said = difference_text(problem, solution)
    assert bool(said) is (abs(found.peak / solution.simulation.optimised.planned.peak - 1) > 0.1)


def test_difference_from_plan_is_attributed_to_omitted_effects(solved, tmp_path):
    problem, solution = solved
    simulation = solution.simulation
    first = simulation.optimised
    half = replace(first, planned=replace(first.planned, peak=first.simulated.peak / 2))
    motions = (half, *simulation.motions[1:])
    twice = replace(solution, simulation=replace(simulation, motions=motions))
    links = load(tmp_path, minimise='objective = "tool_deviation"')
    assert "quasi-static plan does not include" in difference_text(problem, twice)
    said = difference_text(links, twice)
    assert "quasi-static" not in said
    assert "kinks" in said
    assert "limits.jerk" in said


def test_the_ratio_is_to_the_best_rival_that_keeps_every_limit(solved):
    problem, solution = solved
    led = solution.compensation
    rivals = {each.name: each for each in led.motions[1:]}
    assert set(rivals) == {"quintic", "S-curve", "toppra"}
    worst = {
        name: each.compensated.flight.worst + each.compensated.after.worst
        for name, each in rivals.items()
        if not each.excess
    }
    assert led.best_rival.name == min(worst, key=worst.get)
    document = result_document(solution)["compensation"]
    assert document["best_rival"] == led.best_rival.name
    if led.ratios is not None:
        best, own = led.best_rival.compensated, led.optimised.compensated
        assert document["ratio_to_best_rival"]["in_flight"] == own.flight.worst / best.flight.worst
    assert led.best_rival.name in comparison(problem, solution)
    # No planned motion that is compared exceeds a limit.
    for motion in rival_motions(problem, resolve(problem), solution.duration):
        assert motion.exceeded == ()
        assert motion.time[-1] >= solution.duration * (1.0 - 1e-9)


def test_result_and_table_hold_every_motion(solved):
    _, solution = solved
    document = result_document(solution)["simulation"]
    section = simulation_section(solution.simulation)
    head, rows = section.head, section.rows
    assert list(document["motions"]) == [row[0] for row in rows]
    for row in rows:
        assert len(row) == len(head)
        own = document["motions"][row[0]]
        assert set(own) >= {"planned", "in_flight", "after_arrival", "settling_time", "counted"}
    assert document["assumed_damping"] == [1, 2]
    damping, hysteresis = section.lines[:2]
    assert "joints 1 and 2 is assumed: 2 % of critical" in damping
    # Both joints turned by 0.05 mrad, at most: the tool is at most 0.8 m from the shoulder.
    reach = document["typical_hysteresis"]
    assert 5e-5 * 0.4 < reach < 5e-5 * 1.2
    share = 100.0 * reach / solution.simulation.optimised.simulated.peak
    assert f"{share:.0f} % of the optimised peak" in hysteresis


def test_a_quintic_that_exceeds_a_limit_is_slowed_until_it_does_not(tmp_path):
    problem = load(tmp_path, minimise=PEAK, limits="velocity = [3.0, 6.0]")
    motion = resolve(problem)
    quintic = baselines(problem, motion)["quintic"]
    assert not quintic.feasible
    slowed = slowed_quintic(problem, motion)
    assert slowed.feasible(CERTIFICATE_TOLERANCE)
    # Only the velocity limit is active, which scales with one over the duration.
    excess = next(v.value for v in quintic.assessment.violations if v.limit == "velocity")
    assert slowed.duration == pytest.approx(
        0.5 * (1 + excess) / (1 + CERTIFICATE_TOLERANCE), rel=3e-3
    )


def test_damping_beyond_critical_is_refused_before_solving(tmp_path):
    problem = load(tmp_path)
    stiff = replace(problem, robot=replace(problem.robot, damping=np.array([1e4, 1.0])))
    with pytest.raises(RobotError, match="damping of shoulder must lie between 0"):
        solve(stiff, simulate=True)


def test_an_arm_that_cannot_be_simulated_keeps_its_solution_with_a_note(solved):
    problem, solution = solved
    light = problem.robot.model.copy()
    for k in (1, 2):
        light.inertias[k].mass *= 1e-9
        light.inertias[k].inertia = 1e-9 * light.inertias[k].inertia
    changed = replace(problem, robot=replace(problem.robot, model=light))
    plain = with_simulation(changed, replace(solution, simulation=None))
    assert plain.simulation is None
    assert plain.notes[-1].startswith("Not simulated on the elastic arm: a mode of")


@pytest.mark.parametrize("part", ["total", "process"])
def test_other_parts_of_the_deflection_are_simulated_too(part, tmp_path):
    force = "[tool]\nprocess_force = [5.0, 2.0, -20.0]"
    goal = f'objective = "{part}_deflection"\nmeasure = "rms"'
    # Slow enough to be nearly quasi-static.
    problem = replace(load(tmp_path, minimise=goal, extra=force), duration=(3.0, 3.0))
    solution = solve(problem, simulate=True)
    simulation = solution.simulation
    own = simulation.optimised
    assert simulation.measure == "rms"
    assert own.compared.name == part
    assert own.compared.planned.rms == pytest.approx(solution.objective.value)
    assert own.compared.simulated.rms == pytest.approx(own.compared.planned.rms, rel=0.03)
    assert "tool error" in headline_text(solution)
    saved = result_document(solution)["simulation"]["motions"]["optimised"]["minimised"]
    assert saved["part"] == part


@pytest.mark.parametrize(
    ("stage", "told"),
    [
        ("compensate", "no command.csv was written; solve again for it"),
        ("simulate_motions", "`stiffopt simulate` repeats it"),
    ],
)
def test_interruption_names_missing_results(solved, monkeypatch, stage, told):
    problem, solution = solved

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(f"stiffopt.command.simulated_solution.{stage}", interrupted)
    found = with_simulation(problem, replace(solution, simulation=None, compensation=None))
    assert found.compensation is None
    assert (found.simulation is None) == (stage == "simulate_motions")
    assert told in found.notes[-1]
    assert ("stiffopt simulate" in found.notes[-1]) == (stage == "simulate_motions")


def test_rivals_of_the_solve_are_not_searched_again(solved, monkeypatch):
    problem, solution = solved
    searched = []
    monkeypatch.setattr(
        "stiffopt.command.simulated_solution.rival_motions", lambda *_: searched.append(1) or []
    )
    plain = replace(solution, simulation=None, compensation=None)
    assert with_simulation(problem, plain, rivals=(solution.duration, [], [])).simulation
    assert not searched
    with_simulation(problem, plain, rivals=(1.1 * solution.duration, [], []))
    assert searched


def test_no_command_without_elastic_objective_or_limit(tmp_path):
    plain = load(tmp_path, duration="0.6")
    solution = solve(plain, simulate=True)
    assert solution.simulation is not None
    assert solution.compensation is None
    assert "State [uncertainty] for a command" in solution.notes[-1]
    doubted = replace(plain, uncertainty=Uncertainty(stiffness=0.1))
    assert solve(doubted, simulate=True).compensation is not None
