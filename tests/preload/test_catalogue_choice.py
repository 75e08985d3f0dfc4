"""Best catalogue designs against trying every combination through the study's own rows."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from preload_studies import JACOBIAN, case, er3a, study, with_elements

from stiffopt.errors import InputError, ProblemError
from stiffopt.fastening.limits import workshop_torque
from stiffopt.fastening.tightening import Tightening
from stiffopt.preload.catalogue_choice import choose_design
from stiffopt.preload.catalogue_designs import catalogue_designs
from stiffopt.preload.catalogue_search import CombinationSearch
from stiffopt.preload.load_case import LoadHistory
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.problem import Choice
from stiffopt.preload.solution import largest_utilisation
from stiffopt.preload.utilisation import utilisation_rows
from stiffopt.result.status import SolveStatus

OF_ISSUE = Choice(sizes=("M4", "M5", "M6"), grades=("10.9", "12.9"), counts=(6, 8, 9, 12))
SIZES = {"M3": 3, "M4": 4, "M5": 5, "M6": 6}


def everything(problem, choose):
    """Best of all combinations: bolts put into the robot, then the rows of the study."""
    flanges = [(e.joint, e.stage.element) for e in problem.elements]
    menu = list(itertools.product(choose.sizes, choose.grades, choose.counts, choose.torques))
    best = (math.inf, math.inf)
    feasible = 0
    for designs in itertools.product(menu, repeat=len(flanges)):
        robot, preloads = problem.robot, []
        for (joint, flange), (size, grade, count, torque) in zip(flanges, designs, strict=True):
            bolt = replace(flange.bolt, size=size, grade=grade)
            lever = workshop_torque(replace(flange, bolt=bolt), 1.0, problem.tightening).nominal
            preloads.append(torque / lever)
            changes = {flange.name: {"bolt": bolt, "bolt_count": count, "preload": preloads[-1]}}
            robot = with_elements(joint, robot, **changes)
        model = PreloadModel(replace(problem, robot=robot))
        preloads = np.array(preloads)
        least = [f / 1.6 - e.loss for f, e in zip(preloads, model.elements, strict=True)]
        if min(least) <= 0 or not all(row.satisfied for row in utilisation_rows(model, preloads)):
            continue
        feasible += 1
        bolts = sum(design[2] for design in designs)
        sizes = sum(SIZES[design[0]] for design in designs)
        best = min(best, (round(objective(model, preloads), 12), bolts, sizes)[:3])
    return best, feasible


def accounted(proof):
    """Combinations that are excluded, evaluated or left open."""
    return sum(proof.excluded.values()) + proof.evaluated + proof.unvisited


def objective(model, preloads):
    """What is minimised."""
    if model.problem.objective == "total_preload":
        return sum(e.count * f for e, f in zip(model.elements, preloads, strict=True))
    if model.problem.objective == "bolt_utilisation":
        return largest_utilisation(model, preloads)
    if model.problem.objective == "joint_stiffness":
        return -float(model.exact_stiffness(preloads).min())
    return float(np.nanmax(np.linalg.norm(model.exact_deflection(preloads), axis=1)))


@pytest.mark.parametrize(
    ("name", "needs"),
    [
        ("total_preload", {"joint_stiffness": {2: 56_400.0}}),
        ("bolt_utilisation", {"joint_stiffness": {2: 56_400.0}}),
        ("joint_stiffness", {}),
        ("tool_deflection", {}),
        ("total_preload", {"tool_deflection": 1.2402e-3}),
    ],
)
def test_no_combination_of_two_flanges_is_better(name, needs):
    choose = Choice(sizes=("M3", "M5"), grades=("12.9",), counts=(9, 12), torques=(2.24, 9.0, 10.0))
    pulls = case("pull", j2=100.0, jacobian=JACOBIAN), case("push", j1=5.0, j2=-70.0)
    problem = study(*pulls, needs=needs, objective=name, choose=choose)
    choice = choose_design(problem)
    best, feasible = everything(problem, choose)
    assert feasible > 3
    assert choice.status is SolveStatus.OPTIMAL
    assert objective(PreloadModel(choice.problem), choice.solution.vector) == pytest.approx(
        best[0], rel=1e-9
    )
    designs = choice.designs.values()
    assert sum(d.count for d in designs) == best[1]
    assert sum(SIZES[d.size] for d in designs) == best[2]
    assert choice.proof.combinations == 12**2 == accounted(choice.proof)
    assert choice.proof.complete
    for proof in choice.tie_proofs:
        assert accounted(proof) == proof.combinations


def test_a_binding_stiffness_costs_preload():
    choose = Choice(sizes=("M3", "M5"), grades=("12.9",), counts=(9, 12))
    loads = case(j2=100.0)
    free = choose_design(study(loads, choose=choose))
    needs = {"joint_stiffness": {2: 56_450.0}}
    stiff = choose_design(study(loads, choose=choose, needs=needs))
    assert free.solution.stiffness.min() < 56_450.0 <= stiff.solution.stiffness.min()
    assert stiff.objective > free.objective
    assert any("joint stiffness, joint 2" in reason for reason in stiff.proof.excluded)
    assert stiff.continuous.objective <= stiff.objective
    assert stiff.gap == pytest.approx(stiff.objective / stiff.continuous.objective - 1)


@pytest.fixture(scope="module")
def j2():
    needs = {"joint_stiffness": {2: 5.4e4}}
    return choose_design(
        study(case(j2=110.0), needs=needs, free=("flexspline_flange",), choose=OF_ISSUE)
    )


def test_flexspline_of_joint_2(j2):
    design = j2.designs["flexspline_flange"]
    assert (design.bolts, design.torque) == ("8 x M6 10.9", 12.5)
    assert design.least_preload < design.preload / 1.6
    assert design.utilisations["slip safety"] <= 1.0
    assert 0.0 <= j2.gap < 0.12  # one step of the R20 numbers
    # Sum of what each limit excludes, and the combinations that were looked at.
    assert sum(j2.proof.excluded.values()) + j2.proof.evaluated == j2.proof.combinations
    every = catalogue_designs(
        study(case(j2=110.0), free=("flexspline_flange",), choose=OF_ISSUE),
        study(case(j2=110.0), free=("flexspline_flange",)).elements[0],
        (case(j2=110.0),),
    )
    assert j2.proof.combinations == len(every)
    cheaper = [d for d in every if d.feasible and d.total_preload < design.total_preload]
    assert cheaper == []


def test_table_has_every_kind_of_bolts_with_limit(j2):
    assert len(j2.table) == 3 * 2 * 4
    assert sum(row.torques for row in j2.table) == j2.proof.combinations
    (chosen,) = [row for row in j2.table if row.chosen]
    assert chosen.design is j2.designs["flexspline_flange"]
    assert chosen.objective == pytest.approx(j2.objective)
    for row in j2.table:
        if row.stopper:
            assert row.utilisation > 1.0
            assert row.design.utilisations[row.stopper] == row.utilisation
        else:
            assert row.utilisation <= 1.0
            assert row.objective >= j2.objective * (1 - 1e-12)
    by_bolts = {row.design.bolts: row.stopper for row in j2.table}
    assert by_bolts["12 x M6 12.9"] == "bolt spacing"
    assert by_bolts["6 x M4 10.9"] == "slip safety"


def test_torques_beyond_the_preferred_numbers_of_the_search_are_infeasible():
    problem = study(case(j2=60.0), free=("flexspline_flange",), choose=Choice(sizes=("M5",)))
    (element,) = problem.elements
    own = catalogue_designs(problem, element, problem.load_cases)
    torques = [d.torque for d in own]
    beyond = replace(problem, choose=Choice(sizes=("M5",), torques=(min(torques) / 1.13, 25.0)))
    outside = catalogue_designs(beyond, element, problem.load_cases)
    assert "least preload" in outside[0].exceeded
    assert "bolt utilisation" in outside[1].exceeded


@pytest.mark.parametrize(
    ("needs", "limit", "unit"),
    [
        ({"slip_safety": 4.0}, "slip safety, flexspline_flange", ""),
        ({"joint_stiffness": {2: 6e4}}, "joint stiffness, joint 2, peak", "N m/rad"),
        ({"tool_deflection": 1e-4}, "tool deflection, peak", "m"),
    ],
)
def test_empty_catalogue_names_the_limit(needs, limit, unit):
    problem = study(
        case(j2=110.0, jacobian=JACOBIAN),
        needs=needs,
        free=("flexspline_flange",),
        choose=OF_ISSUE,
    )
    choice = choose_design(problem)
    assert choice.status is SolveStatus.INFEASIBLE
    assert choice.designs == {}
    assert accounted(choice.proof) == choice.proof.combinations
    (stop,) = choice.stoppers
    assert (stop.limit, stop.unit) == (limit, unit)
    if unit == "m":
        assert stop.best > stop.required
    else:
        assert stop.best < stop.required
    assert limit.casefold() in choice.message.casefold()
    assert len(choice.table) == 24


def test_best_reachable_stiffness_is_that_of_the_stiffest_design():
    problem = study(case(j2=110.0), free=("flexspline_flange",), choose=OF_ISSUE)
    stiffest = choose_design(replace(problem, objective="joint_stiffness"))
    needs = replace(problem.requirements, joint_stiffness={2: 6e4})
    (stop,) = choose_design(replace(problem, requirements=needs)).stoppers
    assert stop.best == pytest.approx(stiffest.objective, rel=1e-12)


def test_several_joints_with_pins_are_each_as_stiff_as_alone():
    loads = (case(j2=60.0, j3=-20.0),)
    choose = Choice(sizes=("M3", "M4", "M5"), counts=(8, 12))
    both = choose_design(study(*loads, joints=(2, 3), objective="joint_stiffness", choose=choose))
    for row, joint in enumerate((2, 3)):
        alone = choose_design(
            study(*loads, joints=(joint,), objective="joint_stiffness", choose=choose)
        )
        assert both.solution.stiffness[row] == pytest.approx(alone.solution.stiffness[0], rel=1e-9)
    pins = both.designs["joint_3.pulley_pins"]
    assert (pins.size, pins.grade, pins.count) == ("M4", "", 2)


def test_a_flange_beside_other_elements_counts_with_them():
    group = ("circular_spline_flange", "motor_key")
    robot = with_elements(2, group=group)
    choose = Choice(sizes=("M3",), grades=("12.9",), counts=(9, 12), torques=(1.8, 2.0))
    problem = study(
        case(j2=100.0),
        robot=robot,
        free=("circular_spline_flange",),
        choose=choose,
        objective="joint_stiffness",
    )
    choice = choose_design(problem)
    best, feasible = everything(problem, choose)
    assert feasible > 1
    assert -choice.objective == pytest.approx(best[0], rel=1e-9)


def test_two_parallel_flanges_are_refused():
    robot = with_elements(2, group=("circular_spline_flange", "flexspline_flange"))
    problem = study(case(j2=30.0), robot=robot, choose=Choice())
    with pytest.raises(ProblemError, match="parallel to each other"):
        choose_design(problem)


def test_worst_instants_of_a_motion_are_kept():
    time = np.linspace(0.0, 1.0, 21)
    torque = np.zeros((21, 6))
    torque[:, 1] = 110.0 * np.sin(np.pi * time)
    history = LoadHistory(name="swing", time=time, torque=torque)
    problem = study(
        case(j2=1.0), histories=(history,), choose=OF_ISSUE, free=("flexspline_flange",)
    )
    choice = choose_design(problem)
    assert "swing at 0.500 s" in [c.name for c in choice.solution.cases]
    assert choice.designs["flexspline_flange"].label == "8 x M6 10.9, 12.5 N m"


def test_bolts_of_the_whole_robot_for_several_motions():
    """All flanges and pins at once; each joint as if it were chosen alone, for the larger load."""
    time = np.linspace(0.0, 1.0, 21)
    peaks = np.array([57.0, 110.0, 38.0, 16.0, 16.0, 13.0])
    shares = {"lift": [0.2, 0.7, 0.6, 0.3, 0.5, 0.2], "sweep": [0.7, 0.3, 0.2, 0.6, 0.2, 0.6]}
    motions = [
        LoadHistory(name=name, time=time, torque=np.outer(np.sin(np.pi * time), share * peaks))
        for name, share in shares.items()
    ]
    choose = Choice(sizes=("M3", "M4", "M5", "M6"), counts=(6, 9, 12))

    def chosen(joints, histories):
        return choose_design(
            study(case(j2=1.0), joints=joints, histories=tuple(histories), choose=choose)
        )

    whole = chosen((1, 2, 3, 4, 5, 6), motions)
    assert len(whole.designs) == 15
    assert all(row.satisfied for row in whole.solution.rows)
    instants = {each.name for each in whole.solution.cases}
    assert {"lift at 0.500 s", "sweep at 0.500 s"} <= instants
    for joint in range(1, 7):
        own = chosen((joint,), [max(motions, key=lambda m: m.torque[10, joint - 1])])
        for key, design in own.designs.items():
            full = key if "." in key else f"joint_{joint}.{key}"
            assert whole.designs[full].label == design.label
    # One motion alone asks for less of joint 1.
    light = chosen((1, 2), motions[:1])
    assert any(whole.designs[key].label != each.label for key, each in light.designs.items())


def test_choosing_needs_a_catalogue_and_known_sizes():
    with pytest.raises(ProblemError, match=r"Add \[choose\]"):
        choose_design(study())
    with pytest.raises(InputError, match="M55"):
        choose_design(study(choose=Choice(sizes=("M55",))))


def test_scatter_free_tightening_needs_less():
    problem = study(case(j2=110.0), free=("flexspline_flange",), choose=OF_ISSUE)
    exact = replace(problem, tightening=Tightening(scatter=1.0))
    assert choose_design(exact).objective < choose_design(problem).objective
    assert er3a().chains[1].elements["flexspline_flange"].bolt.size == "M5"


@pytest.mark.parametrize(("found", "status"), [(False, "iteration_limit"), (True, "acceptable")])
def test_interrupted_search_is_reported(monkeypatch, found, status):
    solved = CombinationSearch._solve_programme

    def cut_short(search, goal):
        """Time is up with the first solve, which has not shown that there is nothing better."""
        step = solved(search, goal)
        search._deadline = 0.0
        return replace(step, picks=step.picks if found else None, bound=0.9 * step.bound)

    needs = {"joint_stiffness": {2: 56_450.0}}
    choose = Choice(sizes=("M3", "M4", "M5"), counts=(8, 9, 12))
    problem = study(case(j2=100.0), needs=needs, choose=choose)
    best = choose_design(problem)
    monkeypatch.setattr(CombinationSearch, "_solve_programme", cut_short)
    choice = choose_design(problem)
    assert choice.status == status
    assert not choice.proof.complete
    assert accounted(choice.proof) == choice.proof.combinations
    assert "ended" in choice.message
    if choice.designs:
        assert all(row.satisfied for row in choice.solution.rows)
        assert choice.proof.bound <= best.objective <= choice.objective


# ---- how to tighten


def test_tightening_method_is_chosen_with_the_bolts():
    choose = Choice(methods=("torque_wrench", "angle"), coatings=("oiled", "MoS2"), washers=True)
    problem = study(
        case(j2=80.0),
        free=("flexspline_flange",),
        tightening=Tightening(embedding=3e-6),
        choose=choose,
    )
    found = choose_design(problem)
    assert [(w.method, w.friction, w.friction_highest) for w in found.ways] == [
        ("torque_wrench", 0.08, 0.16),
        ("torque_wrench", 0.08, 0.12),
        ("angle", 0.08, 0.16),
        ("angle", 0.08, 0.12),
    ]
    assert [way.coating for way in found.ways] == ["oiled", "MoS2", "oiled", "MoS2"]
    alone = []
    for way in found.ways:
        tightening = Tightening(
            method=way.method,
            thread_friction=way.friction,
            head_friction=way.friction,
            friction_highest=way.friction_highest,
            embedding=3e-6,
        )
        plain = replace(choose, methods=(), coatings=())
        one = choose_design(replace(problem, tightening=tightening, choose=plain))
        assert not one.ways
        assert way.objective == pytest.approx(one.objective, nan_ok=True)
        alone.append(one.objective)
    # Friction that varies little and a method that hardly cares need the least preload.
    assert found.objective == pytest.approx(np.nanmin(alone))
    assert found.problem.tightening.method == "angle"
    assert found.problem.tightening.friction_highest == 0.12
    assert "Tightened by angle, bolts MoS2" in found.message
    labels = {row.design.bolts for row in found.table}
    assert labels == {"9 x M5 12.9", "9 x M5 12.9 with washers"}
    with pytest.raises(ProblemError, match="Did you mean 'angle'"):
        Choice(methods=("angel",))


def test_empty_catalogue_shows_least_preload_within_limits():
    """The stiffness is out of reach, though each flange alone could be tightened."""
    choose = Choice(sizes=("M4", "M5"), counts=(8, 12))
    problem = study(
        case(j2=40.0),
        free=("flexspline_flange",),
        choose=choose,
        needs={"joint_stiffness": {2: 1e9}},
    )
    choice = choose_design(problem)
    assert choice.status is SolveStatus.INFEASIBLE
    model = PreloadModel(problem)
    shown = {row.design.bolts: row.design for row in choice.table}
    several = 0
    for bolts, design in shown.items():
        same = [
            d
            for d in catalogue_designs(problem, model.elements[0], problem.load_cases)
            if d.bolts == bolts and d.feasible
        ]
        several += len(same) > 1
        if same:
            assert design.total_preload == min(d.total_preload for d in same)
    assert several
