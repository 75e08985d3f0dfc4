"""Optima of preload studies: proof by KKT residual and by grid, reasons where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from preload_studies import JACOBIAN, Ring, case, er3a, study, with_elements
from small_arms import ROOT

from stiffopt.cli import run
from stiffopt.errors import NoSolutionFound
from stiffopt.exact.chain import exact_compliance, exact_windup
from stiffopt.fastening.limits import key_pressure_limit
from stiffopt.fastening.tightening import Tightening
from stiffopt.preload import optimise
from stiffopt.preload.files import load_study
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.nlp import PreloadNlp
from stiffopt.preload.optimise import objective_levels, optimise_preloads
from stiffopt.preload.problem import PreloadProblem
from stiffopt.preload.study import preload_study
from stiffopt.preload.utilisation import utilisation_rows
from stiffopt.report.preload.page import write_preload_report
from stiffopt.result.status import SolveStatus
from stiffopt.robot.files import load_robot
from stiffopt.solver.ipopt import kkt_residual

KKT = 1e-6


class Grid:
    """Every pair of preloads of joint 2's two rings, judged without the package's model.

    Wind-ups and compliances of springs in series add, so each axis is evaluated once.
    """

    def __init__(self, problem, points=400):
        self.problem = problem
        self.needs, alpha = problem.requirements, problem.tightening.alpha
        chain = problem.robot.chains[1]
        names = [e.name for e in problem.elements]
        _, self.rest = chain.split(names)
        self.rings = [Ring(chain.elements[name]) for name in names]
        ends = [self.ends(e) for e in problem.elements]
        self.forces = [np.linspace(lower, upper, points) for lower, upper in ends]
        self.least = [
            f / alpha - e.loss for f, e in zip(self.forces, problem.elements, strict=True)
        ]

    def ends(self, element):
        by_name = {limit.name: limit for limit in element.limits}
        bolt, head = by_name["bolt utilisation"], by_name["head pressure"]
        lower = self.needs.least_preload * min(bolt.capacity, head.capacity)
        return lower, min(self.needs.bolt_utilisation * bolt.capacity, head.capacity)

    def added(self, values):
        """Sum of one value an axis over the whole grid."""
        return sum(np.meshgrid(*values, indexing="ij"))

    def stiffness(self, load):
        torque = load.torque[1]
        rest = exact_compliance(self.rest, np.array([torque]))[0]
        own = [ring.compliance(torque, f) for ring, f in zip(self.rings, self.least, strict=True)]
        return 1.0 / (rest + self.added(own))

    def deflection(self, load):
        torque = load.torque[1]
        own = [ring.windup(torque, f) for ring, f in zip(self.rings, self.least, strict=True)]
        angle = exact_windup(self.rest, np.array([torque]))[0] + self.added(own)
        others = np.zeros(3)
        for j in (0, 2, 3, 4, 5):
            chain = self.problem.robot.chains[j]
            others += load.jacobian[:, j] * exact_windup(chain, np.array([load.torque[j]]))[0]
        return np.linalg.norm(others + load.jacobian[:, 1] * angle[..., None], axis=-1)

    @property
    def feasible(self):
        loads, kept = self.problem.load_cases, []
        for ring, least in zip(self.rings, self.least, strict=True):
            largest = max(abs(load.torque[1]) for load in loads)
            kept.append(ring.slip(least) >= self.needs.slip_safety * largest)
        inside = self.added([k.astype(int) for k in kept]) == len(kept)
        if 2 in self.needs.joint_stiffness:
            for load in loads:
                inside &= self.stiffness(load) >= self.needs.joint_stiffness[2]
        if self.needs.tool_deflection is not None:
            inside &= self.worst_deflection() <= self.needs.tool_deflection
        return inside

    def worst_deflection(self):
        posed = [load for load in self.problem.load_cases if load.jacobian is not None]
        return np.max([self.deflection(load) for load in posed], axis=0)

    def objective(self):
        """To be minimised."""
        elements = self.problem.elements
        if self.problem.objective == "total_preload":
            return self.added([e.count * f for e, f in zip(elements, self.forces, strict=True)])
        if self.problem.objective == "bolt_utilisation":
            used = [
                f / min(limit.capacity for limit in e.limits)
                for e, f in zip(elements, self.forces, strict=True)
            ]
            return np.max(np.meshgrid(*used, indexing="ij"), axis=0)
        if self.problem.objective == "joint_stiffness":
            return -np.min([self.stiffness(load) for load in self.problem.load_cases], axis=0)
        return self.worst_deflection()


LOADS = (
    case("lift", JACOBIAN, j1=12.0, j2=58.0, j3=-14.0),
    case("swing", j2=-31.0),
    case("hold", JACOBIAN, j2=22.0, j3=11.0, j5=4.0),
)
NEEDS = (
    {},
    {"joint_stiffness": {2: 49640.0}, "slip_safety": 1.0},
    {"tool_deflection": 9.090e-4, "slip_safety": 1.1, "bolt_utilisation": 0.9},
)


@pytest.mark.parametrize("needs", NEEDS, ids=["slip", "stiffness", "deflection"])
@pytest.mark.parametrize("free", [("flexspline_flange",), ()], ids=["one", "two"])
@pytest.mark.parametrize(
    "objective", ["total_preload", "bolt_utilisation", "joint_stiffness", "tool_deflection"]
)
def test_no_design_of_a_dense_grid_is_better(objective, free, needs):
    problem = study(*LOADS, free=free, needs=needs, objective=objective)
    solution = optimise_preloads(problem)
    assert solution.status is SolveStatus.OPTIMAL
    assert solution.kkt_residual < KKT
    assert all(row.satisfied for row in solution.rows)
    grid = Grid(problem, points=4000 if free else 400)
    inside, values = grid.feasible, grid.objective()
    assert inside.any()
    sign = -1.0 if objective == "joint_stiffness" else 1.0
    best, span = float(values[inside].min()), float(np.ptp(values))
    found = sign * solution.objective
    assert found <= best + 1e-9 * abs(best)
    # The grid comes as close as its spacing allows, so the optimum is no number out of reach.
    assert best - found <= 0.01 * span + 1e-12


def test_requirements_of_the_grid_studies_bind():
    kinds = []
    for needs in NEEDS:
        solution = optimise_preloads(study(*LOADS, needs=needs))
        kinds.append({row.kind for row in solution.rows if row.active})
    assert kinds[0] == {"slip safety"}
    assert "joint stiffness" in kinds[1]
    assert "tool deflection" in kinds[2]


# ---- what binds


# Limits that hold the least of the objective, where only the total preload is still open.
@example(
    joint=2,
    load=0.3011975178750423,
    objective="bolt_utilisation",
    method="torque_wrench",
    embedding=3e-6,
)
@example(
    joint=3,
    load=0.48823116096802227,
    objective="bolt_utilisation",
    method="angle",
    embedding=3e-6,
)
@settings(max_examples=15, deadline=None)
@given(
    joint=st.sampled_from([1, 2, 3, 5, 6]),
    load=st.floats(0.0, 0.5),
    objective=st.sampled_from(["total_preload", "bolt_utilisation", "joint_stiffness"]),
    method=st.sampled_from(["torque_wrench", "angle", "yield"]),
    embedding=st.sampled_from([0.0, 3e-6]),
)
def test_an_optimum_touches_a_limit_and_says_which(joint, load, objective, method, embedding):
    torque = load * er3a().torque_max[joint - 1]
    problem = study(
        case(**{f"j{joint}": torque}),
        joints=(joint,),
        objective=objective,
        tightening=Tightening(method=method, embedding=embedding),
    )
    solution = optimise_preloads(problem)
    assert solution.status is SolveStatus.OPTIMAL
    assert solution.kkt_residual < KKT
    active = [row for row in solution.rows if row.active]
    assert active
    for row in active:
        assert row.kind in solution.message
        assert row.name in solution.active
    # Every single preload is held by something.
    for element in problem.elements:
        assert any(row.element == element.key for row in active)


@pytest.mark.parametrize("objective", ["total_preload", "joint_stiffness"])
def test_several_joints_get_the_preloads_of_one_by_one(objective):
    loads = (case("a", j2=58.0, j3=13.0, j6=3.0), case("b", j2=20.0, j3=-16.0))
    stiffness = {2: 30500.0}
    together = optimise_preloads(
        study(*loads, joints=(2, 3, 6), objective=objective, needs={"joint_stiffness": stiffness})
    )
    assert together.kkt_residual < KKT
    for joint in (2, 3, 6):
        needs = {"joint_stiffness": stiffness} if joint == 2 else {}
        alone = optimise_preloads(study(*loads, joints=(joint,), objective=objective, needs=needs))
        for key, force in alone.preloads.items():
            assert together.preloads[f"joint_{joint}.{key}"] == pytest.approx(force, rel=1e-5)


def test_design_without_torque_lies_at_its_floor():
    solution = optimise_preloads(study(case("rest")))
    assert {row.kind for row in solution.rows if row.active} == {"least preload"}


@pytest.mark.parametrize(("load", "floor"), [(-14.0, 0.1), (0.5, 0.9)])
def test_pins_are_never_loosened_below_what_carries_the_torque(load, floor):
    """Below that they turn on the shaft, whatever slip safety is asked for."""
    needs = {"slip_safety": None, "least_preload": floor}
    problem = study(case("turn", j3=load), case("less", j3=0.2), joints=(3,), needs=needs)
    problem = replace(problem, free=("pulley_pins",))
    model = PreloadModel(problem)
    lower, _ = PreloadNlp(model, "total_preload", objective_levels(model)).bounds()
    (element,) = model.elements
    at_floor = floor * element.capacity
    # Two tips at 90 degrees and their reaction, on a shaft of 8 mm that turns 100 times.
    unit = 0.15 * 4e-3 * (2 + np.sqrt(2)) * 100
    carries = 1.6 * (abs(load) / unit + element.loss)
    assert lower == pytest.approx(max(at_floor, carries), rel=1e-9)
    assert (carries > at_floor) == (load == -14.0)


def test_free_element_beside_others_is_optimised():
    robot = with_elements(2, group=("circular_spline_flange", "flexspline_flange"))
    problem = study(case(j2=40.0), robot=robot, free=("flexspline_flange",))
    most = optimise_preloads(replace(problem, objective="joint_stiffness"))
    assert most.kkt_residual < KKT
    needed = 0.9999 * float(most.stiffness[0, 0])
    held = replace(problem.requirements, joint_stiffness={2: needed})
    least = optimise_preloads(replace(problem, requirements=held))
    assert least.kkt_residual < KKT
    assert least.stiffness[0, 0] == pytest.approx(needed, rel=1e-6)
    assert least.total_preload < most.total_preload


# ---- studies that cannot be met


def failure(problem):
    with pytest.raises(NoSolutionFound) as caught:
        optimise_preloads(problem)
    solution = caught.value.solution
    assert solution.status is SolveStatus.INFEASIBLE
    assert str(caught.value).startswith("No preload meets this study.")
    assert solution.message in str(caught.value)
    for stop in solution.stoppers:
        assert stop.limit.casefold() in str(caught.value).casefold()
        assert stop.remedy
    return solution


def upper_ends(problem):
    return [
        min(limit.capacity for limit in element.limits if np.isfinite(limit.capacity))
        for element in problem.elements
    ]


def test_stiffness_out_of_reach_names_the_most_that_the_limits_allow():
    problem = study(case(j2=58.0), case("swing", j2=30.0), needs={"joint_stiffness": {2: 9e4}})
    (stop,) = failure(problem).stoppers
    chain = problem.robot.chains[1].with_preloads(
        {
            e.name: end / 1.6 - e.loss
            for e, end in zip(problem.elements, upper_ends(problem), strict=True)
        }
    )
    best = 1.0 / exact_compliance(chain, np.array([58.0, 30.0]))
    assert stop.best == pytest.approx(best.min(), rel=1e-9)
    assert stop.required == 9e4
    assert stop.limit == "joint stiffness, joint 2, swing"
    assert "bolt utilisation of flexspline_flange" in stop.against
    assert "stiffer reducer" in stop.remedy


def test_slip_at_every_admissible_preload_names_the_limit_and_the_best_safety():
    problem = study(case(j2=58.0), needs={"slip_safety": 2.7, "bolt_utilisation": 0.8})
    stops = failure(problem).stoppers
    assert [s.limit for s in stops] == [
        "slip safety, circular_spline_flange, peak",
        "slip safety, flexspline_flange, peak",
    ]
    for stop, element, end in zip(stops, problem.elements, upper_ends(problem), strict=True):
        ring = Ring(element.stage.element)
        least = 0.8 * end / 1.6 - element.loss
        assert stop.best == pytest.approx(ring.slip(least) / 58.0, rel=1e-9)
        assert f"bolt utilisation of {element.key} (at most {0.8 * end:.0f} N)" == stop.against
        assert "more friction" in stop.remedy


def test_deflection_out_of_reach_names_the_least():
    problem = study(*LOADS, needs={"tool_deflection": 5e-4})
    (stop,) = failure(problem).stoppers
    grid = Grid(problem, points=300)
    assert stop.best == pytest.approx(float(grid.worst_deflection().min()), rel=1e-6)
    assert stop.required == 5e-4
    assert stop.unit == "m"
    assert stop.limit == "tool deflection, hold"


def test_key_pressure_that_no_preload_changes():
    robot = with_elements(2, motor_key={"length": 4e-4})
    problem = study(case(j2=100.0), robot=robot, needs={"slip_safety": 1.0})
    (stop,) = failure(problem).stoppers
    assert stop.limit == "key pressure, motor_key, peak"
    key = robot.chains[1].elements["motor_key"]
    # Flanks of 2.5 mm in the shaft of 14 mm and of 2 mm in the hub, each with the whole torque.
    flanks = [
        (7e-3 - 1.25e-3, 2.5e-3),
        (7e-3 + 1e-3, 2e-3),
    ]
    stage = next(s for s in robot.chains[1].stages if s.element.name == "motor_key")
    pressures = [100.0 / stage.reduction / (radius * 4e-4 * height) for radius, height in flanks]
    assert stop.best == pytest.approx(max(pressures) + key.prepressure, rel=1e-9)
    assert stop.best > stop.required == 150e6
    assert "no preload changes this" in str(stop)


def test_hole_that_leaves_the_ring_stops_whatever_the_preload():
    robot = with_elements(2, flexspline_flange={"outer_radius": 0.0155})
    (stop,) = failure(study(robot=robot)).stoppers
    assert stop.limit == "hole in ring, flexspline_flange"
    assert stop.best > 1.0


def test_floor_above_the_ceiling_stops():
    needs = {"bolt_utilisation": 0.2, "slip_safety": 1.0}
    stops = failure(study(case(j2=1.0), needs=needs)).stoppers
    assert [s.limit for s in stops] == [
        "least preload, circular_spline_flange",
        "least preload, flexspline_flange",
    ]


def test_requirements_that_exclude_each_other_are_no_optimum():
    solution = optimise_preloads(
        study(case(j2=58.0), needs={"joint_stiffness": {2: 9e4}}), throw=False
    )
    assert not solution.status.usable
    # The best reachable: every preload at its end.
    assert solution.vector == pytest.approx(upper_ends(study()), rel=1e-12)
    assert solution.tightening


def test_large_residual_is_not_optimal(monkeypatch):
    monkeypatch.setattr(optimise, "kkt_residual", lambda *_: 0.0346)
    solution = optimise_preloads(study(case(j2=58.0)), throw=False)
    assert solution.status is SolveStatus.ITERATION_LIMIT
    with pytest.raises(NoSolutionFound, match="ended before the optimum"):
        optimise_preloads(study(case(j2=58.0)))


def test_residual_of_a_multiplier_at_no_bound_is_its_own_size():
    model = PreloadModel(study(case(j2=58.0)))
    nlp = PreloadNlp(model, "bolt_utilisation", objective_levels(model))
    end = optimise._exact_optimum(nlp, None)
    multipliers = end.raw.multipliers_g.copy()
    # The rows have upper bounds alone, and IPOPT may leave rounding of the other sign.
    multipliers[np.argmin(np.abs(multipliers))] = -1e-9
    raw = replace(end.raw, multipliers_g=multipliers)
    assert kkt_residual(nlp.nlp, raw, nlp.parameters(end.preloads)) < 1e-8


@pytest.mark.parametrize(("other", "steady"), [(-1e-15, True), (20.0, True), (-20.0, False)])
def test_rounding_of_a_torque_is_no_reversal(other, steady):
    model = PreloadModel(study(case(j2=58.0), case("back", j2=other)))
    allowed = {row.limit for row in utilisation_rows(model, model.design) if "key" in row.kind}
    chain = model.problem.robot.chains[1]
    keys = [e for e in chain.elements.values() if e.kind == "key"]
    assert allowed == {key_pressure_limit(key.hub_material, not steady)[0] for key in keys}


# ---- individual preloads and motions


@pytest.mark.parametrize(
    ("joint", "name", "objective", "torque", "needed"),
    [
        (6, "circular_spline_flange", "total_preload", 6.0, 4630.0),
        pytest.param(
            *(6, "circular_spline_flange", "joint_stiffness", 6.0, 4630.0),
            marks=pytest.mark.slow,
        ),
        (3, "pulley_pins", "total_preload", 15.0, None),
    ],
)
def test_individual_preloads_of_equal_bolts_come_out_equal(joint, name, objective, torque, needed):
    loads = (case(**{f"j{joint}": torque}), case("back", **{f"j{joint}": -0.4 * torque}))
    needs = {"joint_stiffness": {joint: needed} if needed else {}, "slip_safety": 1.0}
    fields = {"joints": (joint,), "free": (name,), "objective": objective, "needs": needs}
    one = optimise_preloads(study(*loads, **fields))
    each = optimise_preloads(study(*loads, individual=True, **fields))
    assert each.kkt_residual < KKT
    assert each.objective == pytest.approx(one.objective, rel=1e-6)
    assert each.preloads[name] == pytest.approx(one.preloads[name], rel=1e-5)
    own = each.individual[name]
    assert len(own) == study(**fields).elements[0].count
    assert own == pytest.approx([one.preloads[name]] * len(own), rel=1e-3)
    # The loosest and the tightest of them are judged.
    by_kind = {row.kind: row.value for row in each.rows if row.element == name}
    assert by_kind["least preload"] == min(own)
    assert set(one.active) == set(each.active)


def swinging():
    time = np.linspace(0.0, 1.0, 201)
    torque = np.zeros((201, 6))
    torque[:, 1] = 38.0 * np.sin(6.0 * time) + 21.0 * np.sin(17.0 * time)
    torque[:, 2] = 12.0 * np.cos(9.0 * time) + 4.0 * np.sin(31.0 * time)
    gravity = 0.3 * torque[::-1]
    jacobian = JACOBIAN * (1.0 + 0.3 * np.sin(5.0 * time))[:, None, None]
    return LoadHistory(
        name="swing", time=time, torque=torque, reference_torque=gravity, jacobian=jacobian
    )


@pytest.mark.parametrize("objective", ["total_preload", "joint_stiffness", "tool_deflection"])
def test_no_instant_of_a_motion_is_worse_than_those_used(objective):
    history = swinging()
    problem = replace(
        study(case("pose", JACOBIAN, j2=10.0), joints=(2, 3), objective=objective),
        histories=(history,),
    )
    solution = optimise_preloads(problem)
    assert solution.kkt_residual < KKT
    assert solution.cases[0].name == "pose"
    assert len(solution.cases) > 2
    every = PreloadModel(problem, tuple(history.at(k) for k in range(201)))
    used = PreloadModel(problem, solution.cases)
    at = solution.vector
    for row, own in zip(every.exact_stiffness(at), used.exact_stiffness(at), strict=True):
        assert row.min() >= own.min() * (1 - 1e-9)
    for joint in (2, 3):
        largest = max(abs(c.torque[joint - 1]) for c in solution.cases)
        assert np.abs(history.torque[:, joint - 1]).max() == pytest.approx(largest, rel=1e-12)
    # The instants of the motion one by one, not as the history selects them.
    sizes = np.linalg.norm(every.exact_deflection(at), axis=1)
    assert sizes.max() <= np.nanmax(solution.deflection) * (1 + 1e-9)


def test_a_requirement_holds_along_the_whole_motion():
    history = swinging()
    problem = replace(study(joints=(2, 3)), histories=(history,), load_cases=())
    free = optimise_preloads(problem)
    allowed = 0.9985 * float(np.nanmax(free.deflection))
    held = replace(problem.requirements, tool_deflection=allowed)
    solution = optimise_preloads(replace(problem, requirements=held))
    assert any(row.kind == "tool deflection" for row in solution.rows if row.active)
    every = PreloadModel(problem, tuple(history.at(k) for k in range(201)))
    sizes = np.linalg.norm(every.exact_deflection(solution.vector), axis=1)
    assert sizes.max() == pytest.approx(allowed, rel=1e-6)


def test_motion_that_slips_with_the_present_preloads_is_still_searched():
    robot = with_elements(2, flexspline_flange={"preload": 2000.0})
    problem = replace(study(joints=(2, 3), robot=robot), histories=(swinging(),), load_cases=())
    solution = optimise_preloads(problem)
    every = PreloadModel(problem, tuple(swinging().at(k) for k in range(201)))
    sizes = np.linalg.norm(every.exact_deflection(solution.vector), axis=1)
    assert np.isinf(solution.deflection_before).any()
    assert sizes.max() <= np.nanmax(solution.deflection) * (1 + 1e-9)


def test_a_joint_without_load_keeps_something_of_its_preload(tmp_path):
    """Scatter and settling took all of it, and the front and its figure found no stiffness."""
    torque = np.zeros(6)
    torque[2] = 30.0
    problem = PreloadProblem(
        robot=load_robot("er3a_c60"),
        joints=(3, 4),
        free=("pulley_pins",),
        load_cases=(LoadCase(name="only joint 3", torque=torque),),
        tightening=Tightening(method="torque_wrench"),
    )
    study = preload_study(problem, front_points=3)
    assert study.solution.status.usable
    for element in problem.elements:
        assert float(element.least(study.solution.preloads[element.key])) > 0.0
    assert np.all(study.solution.stiffness > 0.0)
    assert write_preload_report(study, tmp_path).is_file()


def test_unloaded_flange_preload_allows_low_utilisation(tmp_path):
    """Somewhat above what scatter and settling take, below two hundredths of what a bolt bears."""
    assert run(["init", "flange", "-o", str(tmp_path), "--torque", "0.001 N*m"]) == 0
    problem = load_study(tmp_path / "flange.toml").problem
    [element] = problem.elements
    allowed = element.largest(0.01 * element.capacity) / element.ends(1.0)["bolt utilisation"]
    requirements = replace(problem.requirements, bolt_utilisation=allowed, least_preload=0.1)
    solution = optimise_preloads(replace(problem, requirements=requirements))
    assert solution.status is SolveStatus.OPTIMAL
    assert float(element.least(solution.preloads[element.key])) > 0.0


SHIPPED = "problems/er3a_preload_j2_flexspline.toml"


@pytest.mark.parametrize(("torque", "share"), [(110.0, 0.98), (60.0, 0.99), (60.0, 0.97)])
def test_stiffness_required_close_to_slip_is_met(torque, share):
    """Where a connection is about to slip the exact law falls to zero within newtons."""
    load = f"load_case[1].torque=[0.0, {torque}, 0.0, 0.0, 0.0, 0.0]"
    given = [load, "require.least_preload=0.01"]
    easy = ["require.slip_safety=1.05", "require.joint_stiffness={}"]
    easier = optimise_preloads(load_study(ROOT / SHIPPED, [*given, *easy]).problem)
    needed = share * float(easier.stiffness[0, 0])
    close = ["require.slip_safety=1.0", f"require.joint_stiffness={{ 2 = {needed} }}"]
    found = optimise_preloads(load_study(ROOT / SHIPPED, [*given, *close]).problem)
    assert found.status is SolveStatus.OPTIMAL
    assert found.kkt_residual < KKT
    assert found.stiffness[0, 0] == pytest.approx(needed, rel=1e-6)
    assert found.total_preload < easier.total_preload


def test_solver_that_fails_on_a_feasible_study_calls_no_requirement_impossible():
    """Two rings about to slip: corrections do not settle, yet the largest preloads are enough."""
    needs = {"slip_safety": 1.0, "joint_stiffness": {2: 5.4e4}}
    found = optimise_preloads(study(case(j2=110.0), needs=needs), throw=False)
    assert found.status is not SolveStatus.INFEASIBLE
