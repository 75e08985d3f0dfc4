"""Stiffness, wind-up and slip over the preloads: smooth against exact law, rings and sectors."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from preload_studies import JACOBIAN, Ring, case, er3a, study, with_elements

from stiffopt.errors import ProblemError
from stiffopt.exact import chain
from stiffopt.exact.chain import exact_compliance, exact_windup, stage_windup, torque_shares
from stiffopt.fastening.tightening import Tightening
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.nlp import PreloadNlp
from stiffopt.preload.optimise import objective_levels
from stiffopt.preload.utilisation import utilisation_rows

CASES = (case("lift", j2=60.0), case("rest"), case("back", j2=-25.0))
ELEMENTS = (
    (2, "circular_spline_flange"),
    (2, "flexspline_flange"),
    (3, "pulley_pins"),
    (4, "flexspline_flange"),
    (6, "circular_spline_flange"),
)


def single(joint, name, torque, **fields):
    return PreloadModel(
        study(case(**{f"j{joint}": torque}), joints=(joint,), free=(name,), **fields)
    )


def test_ring_stiffness_and_slip_are_those_of_physics():
    model = PreloadModel(study(*CASES))
    preloads = np.array([3000.0, 9000.0])
    expected = np.zeros(3)
    for element, force, index in zip(model.elements, preloads, (0, 1), strict=True):
        ring = Ring(element.stage.element)
        least = force / 1.6 - element.loss
        assert model.slip_torque(preloads, index) == pytest.approx(ring.slip(least), rel=1e-12)
        expected += [float(ring.compliance(c.torque[1], least)) for c in CASES]
    torques = np.array([c.torque[1] for c in CASES])
    found = model.exact_compliance(preloads, 2, torques) - model.rest_compliance(2, torques)
    assert found == pytest.approx(expected, rel=1e-9)


def test_wind_up_of_rings_is_the_closed_form():
    model = PreloadModel(study(*CASES))
    preloads = np.array([3000.0, 9000.0])
    torques = np.array([60.0, 0.0, -25.0])
    expected = sum(
        Ring(e.stage.element).windup(torques, force / 1.6 - e.loss)
        for e, force in zip(model.elements, preloads, strict=True)
    )
    found = model.exact_windup(preloads, 2, torques) - model.rest_windup(2, torques)
    assert found == pytest.approx(expected, rel=1e-8, abs=1e-18)


@pytest.mark.parametrize(("joint", "name"), ELEMENTS)
def test_smooth_law_follows_the_exact_one(joint, name):
    torque = 0.4 * er3a().torque_max[joint - 1]
    model = single(joint, name, torque)
    ceiling = model.elements[0].capacity
    for share in (0.5, 0.7, 1.0):
        preloads = np.array([share * ceiling])
        at = np.array([torque])
        exact = model.exact_compliance(preloads, joint, at) - model.rest_compliance(joint, at)
        smooth = model.compliances(preloads, joint)[0]
        assert smooth == pytest.approx(float(exact[0]), rel=0.02)
        angle = model.exact_windup(preloads, joint, at) - model.rest_windup(joint, at)
        assert model.windups(preloads, joint)[0] == pytest.approx(float(angle[0]), rel=0.02)


def test_drivetrain_holds_the_least_preloads_from_motor_to_link():
    model = PreloadModel(study(*CASES))
    preloads = np.array([3000.0, 9000.0])
    chain = model.drivetrain(preloads, 2)
    assert list(chain.elements) == list(er3a().chains[1].elements)
    for element, force in zip(model.elements, preloads, strict=True):
        own = chain.elements[element.name].preload
        assert own == pytest.approx(force / 1.6 - element.loss)
    torques = np.array([60.0, 0.0, -25.0])
    whole = model.exact_compliance(preloads, 2, torques)
    assert exact_compliance(chain, torques) == pytest.approx(whole, rel=1e-12)


@settings(max_examples=60, deadline=None)
@given(
    which=st.sampled_from(ELEMENTS),
    shares=st.lists(st.floats(0.3, 1.0), min_size=3, max_size=3, unique=True),
    load=st.floats(0.0, 0.79),
    scatter=st.sampled_from([1.2, 1.6]),
)
def test_stiffness_is_concave_and_increasing_in_preload(which, shares, load, scatter):
    joint, name = which
    model = single(joint, name, 1.0, tightening=Tightening(scatter=scatter, embedding=3e-6))
    forces = np.sort(shares) * model.elements[0].capacity
    if np.min(np.diff(forces)) < 1e-3 * forces[-1]:
        return
    # Away from slip even with the lowest of the three preloads.
    torque = np.array([load * float(model.slip_torque(forces[:1], 0))])
    stiffness = np.array(
        [1.0 / model.exact_compliance(np.array([f]), joint, torque)[0] for f in forces]
    )
    gains = np.diff(stiffness) / np.diff(forces)
    assert (gains >= 0.0).all()
    assert gains[1] <= gains[0] * (1 + 1e-6) + 1e-9 * stiffness[0] / forces[0]


# ---- rows


FULL = {
    "joint_stiffness": {2: 4e4, 3: 9e3},
    "tool_deflection": 1e-3,
    "slip_safety": 1.3,
    "bolt_utilisation": 0.9,
}
TWO_JOINTS = (
    case("hold", JACOBIAN, reference=np.full(6, 4.0), j1=9.0, j2=50.0, j3=-17.0),
    case("swing", j2=-35.0, j3=8.0),
    case("rest", JACOBIAN),
)


def exercised(objective, individual=False):
    joints = (3,) if individual else (2, 3)
    cases = TWO_JOINTS[:2] if individual else TWO_JOINTS
    needs = {**FULL, "joint_stiffness": {3: 9e3}} if individual else FULL
    problem = study(
        *cases,
        joints=joints,
        needs=needs,
        objective=objective,
        individual=individual,
        free=("pulley_pins",) if individual else (),
    )
    model = PreloadModel(problem)
    ceiling = ("bolt_utilisation", 0.9) if objective == "total_preload" else None
    return PreloadNlp(model, objective, objective_levels(model), ceiling=ceiling)


@pytest.mark.parametrize(
    ("objective", "individual"),
    [
        ("total_preload", False),
        ("bolt_utilisation", False),
        ("joint_stiffness", False),
        ("tool_deflection", False),
        ("joint_stiffness", True),
    ],
)
def test_derivative_of_every_row_agrees_with_differences(objective, individual):
    problem = exercised(objective, individual)
    nlp, size = problem.nlp, problem.model.size
    shares = np.linspace(0.6, 0.9, size)
    parameters = problem.parameters(shares * problem.scale)
    point = np.concatenate([shares, np.full(nlp.x.numel() - size, 1.7)])
    both = ca.vertcat(nlp.f, nlp.g)
    value = ca.Function("value", [nlp.x, nlp.p], [both])
    slope = ca.Function("slope", [nlp.x, nlp.p], [ca.densify(ca.jacobian(both, nlp.x))])
    found = np.asarray(slope(point, parameters))
    step = 1e-5
    for column in range(len(point)):
        shift = step * np.eye(len(point))[column]
        ahead, behind = (np.asarray(value(point + s, parameters)).ravel() for s in (shift, -shift))
        difference = (ahead - behind) / (2 * step)
        assert found[:, column] == pytest.approx(difference, rel=1e-6, abs=1e-8)


def test_rows_of_the_programme_are_exact_where_the_law_was_shifted():
    problem = exercised("total_preload")
    model, nlp = problem.model, problem.nlp
    preloads = 0.8 * problem.scale
    values = ca.Function("rows", [nlp.x, nlp.p], [nlp.g])(
        np.full(nlp.x.numel(), 0.8), problem.parameters(preloads)
    )
    labels = [f"{b.rows.name}, {label}" for b in nlp.rows.items for label in b.rows.labels]
    by_name = dict(zip(labels, np.asarray(values).ravel(), strict=True))
    exact = {row.name: row.utilisation for row in utilisation_rows(model, preloads)}
    compared = 0
    for name, value in by_name.items():
        if name.startswith("joint stiffness"):
            assert value == pytest.approx(exact[name], rel=1e-10)
        elif name.startswith("tool deflection"):
            assert np.sqrt(value) == pytest.approx(exact[name], rel=1e-8, abs=1e-9)
        elif name.startswith("slip safety"):
            # The programme's row is linear in the preload: 2 - 1/utilisation.
            assert 1.0 / (2.0 - value) == pytest.approx(exact[name], rel=1e-12)
        else:
            continue
        compared += 1
    # Joint 2 in three cases, joint 3 in three, two poses; slip of rings is in the bounds.
    assert compared == 8


def test_stiffness_slopes_of_the_smooth_law_agree_with_differences_of_the_exact_one():
    model = PreloadModel(study(case(j2=50.0)))
    symbol = ca.SX.sym("f", 2)
    slope = ca.Function("slope", [symbol], [ca.jacobian(model.compliances(symbol, 2), symbol)])
    preloads = 0.9 * model.spread([e.capacity for e in model.elements])
    found = np.asarray(slope(preloads)).ravel()
    for column, step in enumerate(1e-4 * preloads):
        shift = step * np.eye(2)[column]
        ahead, behind = (
            model.exact_compliance(preloads + s, 2, np.array([50.0]))[0] for s in (shift, -shift)
        )
        assert found[column] == pytest.approx((ahead - behind) / (2 * step), rel=0.02)


# ---- one preload a bolt or pin


@pytest.mark.parametrize("joint", [2, 3])
def test_sectors_of_equal_preload_sum_to_the_ring(joint):
    cases = (case("turn", **{f"j{joint}": 16.0}), case("rest"))
    equal = PreloadModel(study(*cases, joints=(joint,)))
    single = PreloadModel(study(*cases, joints=(joint,), individual=True))
    shares = [0.6 * e.capacity for e in equal.elements]
    together, apart = equal.spread(shares), single.spread(shares)
    assert single.size == sum(e.count for e in equal.elements)
    torques = np.array([16.0, 0.0, -9.0])
    assert single.exact_compliance(apart, joint, torques) == pytest.approx(
        equal.exact_compliance(together, joint, torques), rel=1e-9
    )
    assert single.exact_windup(apart, joint, torques) == pytest.approx(
        equal.exact_windup(together, joint, torques), rel=1e-8
    )
    assert single.compliances(apart, joint) == pytest.approx(
        equal.compliances(together, joint), rel=1e-6
    )
    for index in range(len(shares)):
        assert single.slip_torque(apart, index) == pytest.approx(
            equal.slip_torque(together, index), rel=1e-12
        )


def test_equal_sectors_share_one_curve(monkeypatch):
    model = PreloadModel(study(case(j2=60.0), free=("circular_spline_flange",), individual=True))
    rounded = 3511.0 * (1.0 + 1e-14 * np.arange(12))
    preloads = model.without_rounding(rounded)
    assert np.ptp(preloads) == 0.0
    assert np.ptp(model.without_rounding(rounded * np.r_[1.0, 1.001, np.ones(10)])) > 3.0
    built = []
    make = chain.antiderivative
    monkeypatch.setattr(
        chain, "antiderivative", lambda *given: built.append(given[1]) or make(*given)
    )
    (whole,) = 1.0 / model.exact_compliance(preloads, 2, np.array([60.0]))
    assert len(built) == 1
    preloads[5] *= 1.001
    (other,) = 1.0 / model.exact_compliance(preloads, 2, np.array([60.0]))
    # Two kinds of sector, each with curves up to four octaves of torque.
    assert len(built) <= 8
    assert other > whole


def test_sectors_of_unequal_preload_turn_together_also_when_one_slips():
    model = PreloadModel(study(case(j2=60.0), free=("circular_spline_flange",), individual=True))
    preloads = np.full(12, 3500.0)
    preloads[4] = 900.0
    stages = [s for s in model.drivetrain(preloads, 2).stages if s.group is not None]
    torque = np.array([0.97 * float(model.slip_torque(preloads, 0))])
    parts = [share * torque for share in torque_shares(stages, torque, None)]
    assert float(np.sum(parts)) == pytest.approx(torque[0], rel=1e-12)
    used = [float(t[0]) / s.slip_torque() for s, t in zip(stages, parts, strict=True)]
    assert used[4] == pytest.approx(1.0, abs=1e-9)
    loose = stages.pop(4), parts.pop(4)
    assert max(used[:4] + used[5:]) < 0.98
    angles = [float(stage_windup(s, t, None)[0]) for s, t in zip(stages, parts, strict=True)]
    assert angles == pytest.approx([angles[0]] * 11, rel=1e-9)
    # Just before it slips, the loose one has turned no further than the others.
    assert stage_windup(loose[0], (1 - 1e-9) * loose[1], None)[0] < angles[0]


def test_uneven_preloads_never_beat_even_ones():
    model = PreloadModel(study(case(j2=40.0), free=("flexspline_flange",), individual=True))
    even = np.full(9, 9000.0)
    best = model.exact_stiffness(even)[0, 0]
    rng = np.random.default_rng(3)
    for _ in range(3):
        shift = rng.uniform(-2500.0, 2500.0, 9)
        assert model.exact_stiffness(even + shift - shift.mean())[0, 0] < best


def test_individual_preloads_are_for_elements_in_series():
    robot = with_elements(2, group=("circular_spline_flange", "flexspline_flange"))
    with pytest.raises(ProblemError, match="in parallel with other elements"):
        PreloadModel(study(robot=robot, individual=True))


# ---- groups and zero torque


def test_free_element_beside_others_counts_as_in_the_whole_chain():
    robot = with_elements(2, group=("circular_spline_flange", "flexspline_flange"))
    model = PreloadModel(study(*CASES, robot=robot, free=("flexspline_flange",)))
    preloads, torques = np.array([8000.0]), np.array([60.0, 0.0, -25.0])
    least = 8000.0 / 1.6 - model.elements[0].loss
    chain = robot.chains[1].with_preloads({"flexspline_flange": least})
    assert model.exact_compliance(preloads, 2, torques) == pytest.approx(
        exact_compliance(chain, torques), rel=1e-12
    )
    assert model.exact_windup(preloads, 2, torques) == pytest.approx(
        exact_windup(chain, torques), rel=1e-12
    )


def test_without_torque_nothing_slips_and_nothing_winds_up():
    model = PreloadModel(study(case("rest", JACOBIAN)))
    assert np.isfinite(model.exact_stiffness(model.design)).all()
    assert model.exact_deflection(model.design) == pytest.approx(np.zeros((1, 3)), abs=1e-15)
    slip = [r for r in utilisation_rows(model, model.design) if r.kind == "slip safety"]
    assert [row.utilisation for row in slip] == [0.0, 0.0]
    assert [row.value for row in slip] == [np.inf, np.inf]


def test_preload_below_embedding_loss_has_no_slip_torque():
    robot = with_elements(2, flexspline_flange={"preload": 100.0})
    model = PreloadModel(study(robot=robot))
    assert model.exact_stiffness(model.design)[0, 0] == 0.0
    rows = {row.name: row for row in utilisation_rows(model, model.design)}
    assert rows["slip safety, flexspline_flange, peak"].utilisation == np.inf
    assert not rows["least preload, flexspline_flange"].satisfied


@pytest.mark.filterwarnings("error")
def test_sectors_below_the_embedding_loss_all_slip():
    model = PreloadModel(study(case(j2=60.0), free=("flexspline_flange",), individual=True))
    loose = np.full(9, 100.0)
    assert model.exact_compliance(loose, 2, np.array([60.0, 0.0])).tolist() == [np.inf, np.inf]
    assert model.exact_windup(loose, 2, np.array([60.0]))[0] == np.inf


def test_reference_torque_does_not_count_in_the_deflection():
    gravity = np.array([0.0, 30.0, 0.0, 0.0, 0.0, 0.0])
    loaded = case("move", JACOBIAN, reference=gravity, j2=60.0)
    model = PreloadModel(study(loaded))
    same = PreloadModel(study(replace(loaded, torque=gravity)))
    assert same.exact_deflection(same.design) == pytest.approx(np.zeros((1, 3)), abs=1e-15)
    angles = model.exact_windup(model.design, 2, np.array([60.0, 30.0]))
    expected = -JACOBIAN[:, 1] * (angles[0] - angles[1])
    assert model.exact_deflection(model.design)[0] == pytest.approx(expected, rel=1e-12)


def test_slip_gives_infinite_deflection_not_nan():
    slipping = case("over", JACOBIAN, j2=300.0)
    flat = case("flat", np.zeros((3, 6)), reference=np.full(6, 300.0), j2=300.0)
    model = PreloadModel(
        study(slipping, case("unposed", j2=1.0), flat, needs={"tool_deflection": 1})
    )
    deflection = model.exact_deflection(model.design)
    assert np.isinf(deflection[[0, 2]]).all()
    assert np.isnan(deflection[1]).all()
    rows = {row.name: row for row in utilisation_rows(model, model.design)}
    assert rows["tool deflection, over"].utilisation == np.inf
    assert "tool deflection, unposed" not in rows
