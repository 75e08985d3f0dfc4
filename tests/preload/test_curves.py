"""Curves over one preload: stiffness, slip safety, utilisation and where each limit binds."""

import numpy as np
import pytest
from preload_studies import Ring, case, study

from stiffopt.errors import ProblemError
from stiffopt.preload.curves import curve_rows, preload_curves
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.optimise import optimise_preloads

LOADS = (case("lift", j2=40.0, j3=-12.0), case("rest"))


def drawn(points=20, **fields):
    model = PreloadModel(study(*LOADS, **{"joints": (2, 3), **fields}))
    preloads = 0.8 * model.spread([e.capacity for e in model.elements])
    return model, preloads, preload_curves(model, preloads, points)


def test_every_element_has_its_softest_case_and_that_of_largest_torque():
    model, preloads, curves = drawn()
    cases = {(c.key, c.case) for c in curves}
    assert cases == {(e.key, name) for e in model.elements for name in ("lift", "rest")}
    for curve in curves:
        index = [e.key for e in model.elements].index(curve.key)
        assert curve.design == preloads[index]
        assert curve.preload[-1] == pytest.approx(1.1 * model.elements[index].capacity)
        assert (np.diff(curve.preload) > 0.0).all()
    # The same case twice is drawn once.
    model = PreloadModel(study(case("only", j2=40.0)))
    assert [c.case for c in preload_curves(model, model.design, 5)] == ["only", "only"]


def test_stiffness_and_band_are_the_exact_law_at_both_ends_of_the_scatter():
    _, _, curves = drawn(joints=(2,))
    model, preloads, _ = drawn(points=2, joints=(2,))
    for curve in curves:
        index = [e.key for e in model.elements].index(curve.key)
        element, ring = model.elements[index], Ring(model.elements[index].stage.element)
        other = model.elements[1 - index]
        others = 1.0 / model.exact_stiffness(preloads)[0, 0 if curve.case == "lift" else 1]
        others -= Ring(element.stage.element).compliance(
            curve.torque, element.least(preloads[index])
        )
        for forces, found in (
            (curve.preload / 1.6 - element.loss, curve.stiffness),
            (curve.preload, curve.stiffness_high),
        ):
            held = np.abs(curve.torque) < ring.slip(forces)
            expected = 1.0 / (others + ring.compliance(curve.torque, forces[held]))
            assert found[held] == pytest.approx(expected, rel=1e-9)
            assert (found[~held] == 0.0).all()
        assert (curve.stiffness_high >= curve.stiffness).all()
        assert other.key != curve.key


def test_slip_safety_and_utilisation():
    model, _, curves = drawn(joints=(2,))
    for curve in curves:
        element = next(e for e in model.elements if e.key == curve.key)
        least = curve.preload / 1.6 - element.loss
        slip = Ring(element.stage.element).slip(least)
        if curve.case == "rest":
            assert np.isinf(curve.slip_safety).all()
        else:
            assert curve.slip_safety == pytest.approx(slip / 40.0, rel=1e-9)
        assert set(curve.utilisation) == {"bolt utilisation", "head pressure"}
        for limit in element.limits:
            if limit.name in curve.utilisation:
                expected = curve.preload / limit.capacity
                assert curve.utilisation[limit.name] == pytest.approx(expected, rel=1e-12)


def test_each_limit_binds_at_the_preload_named():
    needs = {"slip_safety": 1.4, "bolt_utilisation": 0.9, "least_preload": 0.25}
    model, preloads, curves = drawn(needs=needs)
    for curve in curves:
        if curve.case != "lift":
            continue
        index = [e.key for e in model.elements].index(curve.key)
        element = model.elements[index]

        def safety(force, index=index, joint=curve.joint):
            changed = preloads.copy()
            changed[index] = force
            return model.slip_torque(changed, index) / abs(LOADS[0].torque[joint - 1])

        assert safety(curve.limits["slip"]) == pytest.approx(1.0, rel=1e-12)
        assert safety(curve.limits["slip safety"]) == pytest.approx(1.4, rel=1e-12)
        assert curve.limits["least preload"] == pytest.approx(0.25 * element.capacity)
        for limit in element.limits:
            if limit.name in curve.limits:
                allowed = 0.9 if limit.name == "bolt utilisation" else 1.0
                assert limit.utilisation(curve.limits[limit.name]) == pytest.approx(allowed)


def test_the_optimum_lies_where_its_limit_is_drawn():
    problem = study(case(j2=58.0))
    solution = optimise_preloads(problem)
    model = PreloadModel(problem, solution.cases)
    for curve in preload_curves(model, solution.vector, 5):
        assert curve.design == pytest.approx(curve.limits["slip safety"], rel=1e-6)


def test_table_has_a_line_a_preload_and_nan_for_limits_of_others():
    _, _, curves = drawn(points=7)
    columns, rows = curve_rows(curves)
    assert len(rows) == 7 * len(curves)
    assert all(len(row) == len(columns) for row in rows)
    table = [dict(zip(columns, row, strict=True)) for row in rows]
    pins = [line for line in table if line["element"] == "joint_3.pulley_pins"]
    assert pins
    assert all(np.isnan(line["bolt utilisation"]) for line in pins)
    assert all(line["tip indentation"] > 0.0 for line in pins)
    first = curves[0]
    assert [line["preload [N]"] for line in table[:7]] == list(first.preload)
    assert [line["stiffness [N m/rad]"] for line in table[:7]] == list(first.stiffness)


def test_one_point_is_no_curve():
    model = PreloadModel(study())
    with pytest.raises(ProblemError, match="must be 2 or above"):
        preload_curves(model, model.design, 1)
