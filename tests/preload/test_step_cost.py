"""Designs by what they cost in steps, and bolts on another pitch circle."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from preload_studies import case, study, with_elements
from small_studies import write_study

from stiffopt.errors import InputError
from stiffopt.fastening.tightening import Tightening
from stiffopt.preload.catalogue_choice import choose_design
from stiffopt.preload.catalogue_designs import catalogue_designs, design_cost
from stiffopt.preload.files import load_study
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.problem import Choice, StepCost

COST = StepCost(bolt=1.0, size=0.4, grade=0.3, washer=0.2, circle=5.0, method=2.0, coating=1.0)
MENU = Choice(sizes=("M4", "M5", "M6"), grades=("10.9", "12.9"), counts=(6, 8, 9, 12), cost=COST)


def by_hand(design):
    place = {"M4": 0, "M5": 1, "M6": 2}[design.size]
    return design.count * (1.0 + 0.4 * place + 0.3 * (design.grade == "12.9"))


@pytest.fixture(scope="module")
def problem():
    return study(case(j2=110.0), free=("flexspline_flange",), choose=MENU)


def test_cheapest_of_all_designs_that_hold(problem):
    every = catalogue_designs(problem, problem.elements[0], problem.load_cases)
    assert [d.cost for d in every] == pytest.approx([by_hand(d) for d in every])
    able = [d for d in every if d.feasible]
    found = choose_design(problem)
    design = found.designs["flexspline_flange"]
    cheapest = min(d.cost for d in able)
    assert found.cost == design.cost == pytest.approx(cheapest)
    # Of the cheapest the one with the least preload, as the study's own aim asks.
    least = min(d.total_preload for d in able if d.cost == cheapest)
    assert design.total_preload == pytest.approx(least)


def test_cost_precedes_objective():
    plain = study(case(j2=90.0), free=("flexspline_flange",), choose=replace(MENU, cost=None))
    aim = choose_design(plain)
    assert aim.cost == 0.0
    assert aim.designs["flexspline_flange"].size == "M6"
    dear = StepCost(bolt=0.1, size=1.0)
    cheap = choose_design(replace(plain, choose=replace(MENU, cost=dear)))
    assert cheap.designs["flexspline_flange"].size == "M4"
    assert cheap.objective > aim.objective


def test_two_flanges_are_cheapest_together():
    menu = replace(MENU, sizes=("M4", "M5"), counts=(8, 12), torques=(3.15, 6.3, 10.0))
    loads = case(j1=30.0, j2=80.0)
    both = study(loads, joints=(1, 2), free=("flexspline_flange",), choose=menu)
    found = choose_design(both)
    able = [
        [d for d in catalogue_designs(both, e, both.load_cases) if d.feasible]
        for e in both.elements
    ]
    pairs = itertools.product(*able)
    assert found.cost == pytest.approx(min(sum(d.cost for d in pair) for pair in pairs))


def test_methods_and_coatings_cost_by_their_places():
    # A dear method is taken only where the others hold nothing; both coatings begin at 0.08.
    menu = Choice(methods=("torque_wrench", "angle"), coatings=("MoS2", "oiled"), cost=COST)
    wanted = study(
        case(j2=80.0),
        free=("flexspline_flange",),
        tightening=Tightening(embedding=3e-6),
        choose=menu,
    )
    found = choose_design(wanted)
    costs = {(w.method, w.friction_highest): w.cost for w in found.ways if w.status.usable}
    assert costs[("angle", 0.12)] == pytest.approx(9 * 1.0 + 2.0)
    assert costs[("angle", 0.16)] == pytest.approx(9 * 1.0 + 2.0 + 1.0)
    free = choose_design(replace(wanted, choose=replace(menu, cost=None)))
    assert {w.cost for w in free.ways if w.status.usable} == {0.0}
    assert found.cost == min(costs.values())
    light = choose_design(replace(wanted, load_cases=(case(j2=20.0),)))
    assert light.problem.tightening.method == "torque_wrench"
    assert light.cost == pytest.approx(9.0)


def tilted(**changes):
    wrench = np.zeros((6, 6))
    wrench[1] = [0, 0, 0, 45.0, 0, 15.0]
    load = LoadCase(name="tilt", torque=wrench[:, 5], wrench=wrench)
    flange = {"bearing": "none", "inner_radius": 10e-3, "outer_radius": 26e-3} | changes
    robot = with_elements(2, flexspline_flange=flange)
    return study(load, robot=robot, free=("flexspline_flange",))


CIRCLES = (30e-3, 36e-3, 42e-3)


def test_a_larger_circle_bears_tilting_with_less_preload():
    problem = replace(tilted(), choose=Choice(circles=CIRCLES))
    found = choose_design(problem)
    design = found.designs["flexspline_flange"]
    assert design.circle == 42e-3
    assert found.problem.elements[0].stage.element.circle_diameter == 42e-3
    assert design.bolts.endswith("on 42 mm")
    assert {row.design.circle for row in found.table} == set(CIRCLES)
    needed = {
        circle: min(
            (d.total_preload for d in every if d.feasible and d.circle == circle), default=np.inf
        )
        for every in [catalogue_designs(problem, problem.elements[0], problem.load_cases)]
        for circle in CIRCLES
    }
    assert needed[42e-3] <= needed[36e-3] <= needed[30e-3]
    # Drilling anew costs more than it saves where preload is free of charge.
    dear = replace(problem, choose=Choice(circles=CIRCLES, cost=StepCost(circle=5.0)))
    assert choose_design(dear).designs["flexspline_flange"].circle == 30e-3


def test_a_circle_outside_the_ring_is_refused():
    problem = replace(tilted(), choose=Choice(circles=(30e-3, 60e-3)))
    every = catalogue_designs(problem, problem.elements[0], problem.load_cases)
    outside = [d for d in every if d.circle == 60e-3]
    assert outside
    assert all("hole in ring" in d.exceeded for d in outside)


def test_holes_of_a_purchased_part_stay():
    menu = Choice(sizes=("M4", "M5"), counts=(8, 9), circles=CIRCLES, grades=("10.9", "12.9"))
    bought = replace(tilted(fixed_pattern=True), choose=menu)
    every = catalogue_designs(bought, bought.elements[0], bought.load_cases)
    assert {(d.size, d.count, d.circle) for d in every} == {("M5", 9, 30e-3)}
    assert {d.grade for d in every} == {"10.9", "12.9"}
    told = replace(bought, choose=replace(menu, redrill=True))
    drilled = catalogue_designs(told, told.elements[0], told.load_cases)
    assert {(d.size, d.count, d.circle) for d in drilled} == set(
        itertools.product(("M4", "M5"), (8, 9), CIRCLES)
    )


def test_washers_cost_each():
    problem = replace(tilted(), choose=Choice(washers=True, cost=COST))
    stages = {
        d.stage.element.bolt.washer: d
        for d in catalogue_designs(problem, problem.elements[0], problem.load_cases)
    }
    assert stages[True].cost - stages[False].cost == pytest.approx(9 * 0.2)
    assert design_cost(Choice(), stages[True].stage, stages[False].stage) == 0.0


def test_costs_and_circles_in_a_file(tmp_path):
    path = write_study(
        tmp_path,
        more='[choose]\ncircles = ["32 mm"]\ncost = { bolt = 1.5, method = 3 }',
    )
    choose = load_study(path).problem.choose
    assert choose.circles == (32e-3,)
    assert choose.cost == StepCost(bolt=1.5, method=3.0)
    with pytest.raises(InputError, match="bolt"):
        StepCost(bolt=-1.0)
