"""Derivatives of numbered stages, evaluated by the compiled core and by CasADi."""

from __future__ import annotations

from collections import OrderedDict

import casadi as ca
import numpy as np
import pytest

from stiffopt import native
from stiffopt.interpreter.batched import POINTS, Batch
from stiffopt.transcription import point_function
from stiffopt.transcription.node_derivatives import extract_numbers, with_derivatives
from stiffopt.transcription.point_function import StageFunction, stage_functions


def stage(payload: float) -> tuple[ca.Function, ca.Function]:
    """A small stage whose rows go through a torque, and that torque."""
    x, u, z, p = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("z"), ca.SX.sym("p")
    torque = payload * (u * ca.cos(x[0]) + 9.81 * ca.sin(x[0]) * x[1] ** 2)
    rows = ca.vertcat(torque**3 / (p + torque**2), z - ca.tanh(torque * x[1]), x[0] * u)
    return (
        ca.Function("stage", [x, u, z, p], [torque**2, rows]),
        ca.Function("through", [x, u, z, p], [torque]),
    )


def test_derivatives_agree_with_casadi() -> None:
    function, through = stage(3.7)
    taken = extract_numbers(function, through)
    w = ca.SX.sym("w", 4)
    p, weights = ca.SX.sym("p"), ca.SX.sym("weights", 4)
    values = ca.vertcat(*function(w[:2], w[2], w[3], p))
    truth = (
        ca.Function("v", [w, p], [values]),
        ca.Function("j", [w, p], [ca.jacobian(values, w)]),
        ca.Function("h", [w, p, weights], [ca.hessian(ca.dot(weights, values), w)[0]]),
    )
    rng = np.random.default_rng(1)
    for _ in range(20):
        point, factors = rng.normal(size=4), rng.normal(size=4)
        for found, true in zip(with_derivatives(taken.function), truth, strict=True):
            more = [factors] if true.n_in() == 3 else []
            ours = found(point, 0.8, taken.numbers, *more)
            theirs = true(point, 0.8, *more)
            np.testing.assert_allclose(ours.full(), theirs.full(), rtol=1e-12, atol=1e-12)


def test_an_intermediate_may_be_computed_from_another() -> None:
    x, u, z, p = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("z"), ca.SX.sym("p")
    gravity = ca.sin(x[0]) * x[1]
    through = ca.vertcat(gravity, gravity + u * ca.cos(x[1]))
    rows = ca.vertcat(through[1] ** 2 * through[0], z)
    taken = extract_numbers(
        ca.Function("stage", [x, u, z, p], [ca.sumsqr(through), rows]),
        ca.Function("through", [x, u, z, p], [through]),
    )
    w, weights = ca.vertcat(x, u, z), ca.SX.sym("weights", 3)
    values = ca.vertcat(ca.sumsqr(through), rows)
    truth = ca.Function("h", [w, weights], [ca.hessian(ca.dot(weights, values), w)[0]])
    point, factors = np.array([0.3, -0.7, 1.1, 0.2]), np.array([0.5, -1.0, 2.0])
    ours = with_derivatives(taken.function)[2](point, 0.5, taken.numbers, factors)
    np.testing.assert_allclose(ours.full(), truth(point, factors).full(), rtol=1e-12)


def test_two_payloads_share_one_formula() -> None:
    light, heavy = (extract_numbers(*stage(payload)) for payload in (3.7, 5.1))
    assert stage_functions(light) is stage_functions(heavy)
    assert not np.allclose(light.numbers, heavy.numbers)


def test_least_recently_used_functions_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(point_function, "MAX_KEPT", 2)
    point_function.kept_functions.clear()
    x, p, empty = ca.SX.sym("x"), ca.SX.sym("p"), ca.SX(0, 1)

    def use(power: int) -> None:
        values = ca.Function("values", [x, empty, empty, p], [x**power])
        point_function.PointFunction(values)

    use(2)
    (first,) = point_function.kept_functions.values()
    use(3)
    use(2)
    assert list(point_function.kept_functions.values())[-1] is first
    use(4)
    use(2)
    assert list(point_function.kept_functions.values())[-1] is first
    assert len(point_function.kept_functions) == 2
    # What a result folder stores of them are those in use.
    formulas = {formula for formula, _ in point_function.kept_functions}
    assert set(point_function.kept_batches) <= formulas


@pytest.mark.skipif(native.library() is None, reason="needs the compiled core")
def test_stage_that_is_partly_not_batched_is_evaluated_by_casadi(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken = extract_numbers(*stage(2.3))
    monkeypatch.setattr(point_function, "kept_functions", OrderedDict())
    inner = Batch.load
    monkeypatch.setattr(
        Batch, "load", lambda own, library: inner(own, library) if own.shape[2] else None
    )
    assert [each.size2_in(0) for each in stage_functions(taken)] == [1, 1, 1]


@pytest.mark.skipif(native.library() is None, reason="needs the compiled core")
def test_interpreter_derivatives_agree_with_casadi() -> None:
    taken = extract_numbers(*stage(2.3))
    rng = np.random.default_rng(2)
    for fast, slow in zip(stage_functions(taken), with_derivatives(taken.function), strict=True):
        inputs = [rng.normal(size=slow.size_in(k)) for k in range(slow.n_in())]
        given = [
            each if k in (1, 2) else ca.repmat(ca.DM(each), 1, POINTS)
            for k, each in enumerate(inputs)
        ]
        expected = ca.repmat(slow(*inputs), 1, POINTS)
        np.testing.assert_allclose(fast(*given).full(), expected.full(), rtol=1e-13)


def test_a_programme_may_have_any_number_of_points(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = extract_numbers(*stage(2.3))
    count = POINTS + 3
    quick = StageFunction(taken, count, 1)
    monkeypatch.setattr(native, "library", lambda: None)
    slow = StageFunction(taken, count, 1)
    rng = np.random.default_rng(5)
    variables, p = ca.MX.sym("w", 4, count), ca.MX.sym("p", 1 + len(taken.numbers))
    weights = ca.MX.sym("weights", 4, count)
    given = (rng.normal(size=(4, count)), [0.7, *taken.numbers], rng.normal(size=(4, count)))
    found = []
    for each in (slow, quick):
        values = each.values(variables, p)
        slopes, bends = each.jacobian(variables, p), each.hessian(variables, p, weights)
        found.append(ca.Function("all", [variables, p, weights], [values, slopes, bends])(*given))
    for one, other in zip(*found, strict=True):
        assert one.sparsity() == other.sparsity()
        np.testing.assert_allclose(one.full(), other.full(), rtol=1e-13)
