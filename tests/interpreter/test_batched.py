"""The interpreter of batched instructions: every operation, to the last digit, at every point."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest

from stiffopt import native
from stiffopt.interpreter.batched import POINTS, kind_names, read_batch

# Calls that interpreter.c recalls.
CALLS = 128

pytestmark = pytest.mark.skipif(native.library() is None, reason="needs the compiled core")


def many_of(function: ca.Function, *, recalled: bool = False) -> ca.Function:
    """The function at several points; its second input is the same at all of them."""
    found = read_batch(function, (1,), recalled=recalled).load(native.library())
    assert found is not None
    return found


def every_operation() -> ca.Function:
    a, b, shared = ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("shared", 2)
    inside = ca.fabs(a) / (1.0 + ca.fabs(a))
    values = [
        *(a + b, a - b, a * b, a / b, -a, a**2, 2 * a, 1 / a, a + 0.1, shared[0] * a),
        *(a < b, a <= a, a == b, a != b, ca.logic_not(a), ca.logic_and(a, b - b)),
        *(ca.logic_or(a, b - b), ca.sign(a), ca.sign(b - b), ca.fabs(a)),
        *(ca.if_else(a < 0, b, shared[1]), ca.fmin(a, b), ca.fmax(a, b), ca.fmod(a, b)),
        *(ca.exp(a), ca.log(ca.fabs(a)), ca.sqrt(ca.fabs(a)), ca.sin(a), ca.cos(a), ca.tan(a)),
        *(ca.asin(inside), ca.acos(inside), ca.atan(a), ca.sinh(a), ca.cosh(a), ca.tanh(a)),
        *(ca.asinh(a), ca.acosh(1 + inside), ca.atanh(inside), ca.floor(a), ca.ceil(a)),
        *(ca.erf(a), ca.log1p(inside), ca.expm1(a), ca.fabs(a) ** b, ca.fabs(a) ** 1.7),
        *(ca.atan2(a, b), ca.hypot(a, b), ca.copysign(a, b), ca.remainder(a, b)),
    ]
    # Not dense: zeros that nobody computes.
    pattern = ca.diagcat(*values[:4], ca.vertcat(*values[4:]))
    return ca.Function("every", [ca.vertcat(a, b), shared], [pattern])


def test_every_operation_is_that_of_casadi() -> None:
    one = every_operation()
    many = many_of(one)
    points = np.random.default_rng(3).normal(size=(2, 3 * POINTS))
    shared = [0.3, -1.7]
    slow = np.hstack([one(point, shared).full() for point in points.T])
    found = many.map(3)(points, ca.repmat(ca.DM(shared), 1, 3))
    assert found.nnz() == 3 * POINTS * one.nnz_out(0)
    np.testing.assert_allclose(found.full(), slow, rtol=1e-15, atol=0)


def random_sums(seed: int) -> ca.Function:
    """Sums of products of sums, of all lengths, some of them read twice."""
    draw = np.random.default_rng(seed)
    x, shared = ca.SX.sym("x", 4), ca.SX.sym("shared", 2)
    values = [*ca.vertsplit(x), *ca.vertsplit(shared)]
    for _ in range(60):
        total = values[draw.integers(len(values))]
        for _ in range(draw.integers(1, 12)):
            factors = [values[k] for k in draw.integers(len(values), size=draw.integers(1, 3))]
            term = factors[0] if len(factors) == 1 else factors[0] * factors[1]
            signs = (lambda a, b: a + b, lambda a, b: a - b, lambda a, b: b - a)
            total = signs[draw.integers(3)](total, term)
        values.append(ca.sin(total) if draw.random() < 0.3 else total / 7)
    return ca.Function("sums", [x, shared], [ca.vertcat(*values[-20:])])


@pytest.mark.parametrize("seed", range(3))
def test_sums_have_the_digits_of_casadi(seed: int) -> None:
    one = random_sums(seed)
    many = many_of(one)
    points = np.random.default_rng(seed).normal(size=(4, POINTS))
    slow = np.hstack([one(point, [0.3, -1.7]).full() for point in points.T])
    np.testing.assert_allclose(many(points, [0.3, -1.7]).full(), slow, rtol=1e-14, atol=0)


def test_all_sums_of_two_terms_are_kinds_and_none_is_longer_than_six() -> None:
    sums = [kind for kind in kind_names(native.library()) if kind.startswith("x")]
    assert {f"{a}{sign}{b}" for sign in "+-" for a, b in (("x0", "x1"), ("x0", "x1*x2"))} <= set(
        sums
    )
    assert {f"x0*x1{sign}{b}" for sign in "+-" for b in ("x2", "x2*x3")} <= set(sums)
    assert max(kind.count("+") + kind.count("-") for kind in sums) < 6


def test_outputs_may_be_inputs_constants_and_each_other() -> None:
    x, shared = ca.SX.sym("x", 2), ca.SX.sym("shared")
    total = x[0] - shared
    outputs = [ca.vertcat(x[1], 2.5, total, -total, total + total * x[1]), total, ca.SX(0, 1)]
    one = ca.Function("outputs", [x, shared, ca.SX.sym("unused", 3)], outputs)
    points = np.random.default_rng(1).normal(size=(2, POINTS))
    unused = np.zeros((3, POINTS))
    for k, found in enumerate(many_of(one)(points, 0.7, unused)):
        slow = [one(point, 0.7, np.zeros(3))[k].full() for point in points.T]
        np.testing.assert_array_equal(found.full(), np.hstack(slow))


def test_operations_without_an_instruction_are_refused() -> None:
    x, shared = ca.SX.sym("x"), ca.SX.sym("shared")
    printed = ca.Function("printed", [x, shared], [x.printme(shared)])
    with pytest.raises(ValueError, match="no instruction for CasADi's operations"):
        many_of(printed)


def test_recalled_values_are_those_computed_anew() -> None:
    one = random_sums(2)
    many, once = many_of(one, recalled=True), many_of(one)
    draw = np.random.default_rng(4)
    # More than are kept, each of them twice, and some again when they are gone.
    points = draw.normal(size=(CALLS + 20, 4, POINTS))
    points[1] = points[0]
    points[1][3, -1] += 1e-9
    expected = [once(each, [0.3, -1.7]).full() for each in points]
    for k in (0, 1, 0, *np.repeat(np.arange(len(points)), 2), *range(len(points)), 0, 1):
        np.testing.assert_array_equal(many(points[k], [0.3, -1.7]).full(), expected[k])
    assert not np.array_equal(many(points[3], [0.3, -1.6]).full(), expected[3])


def test_recalled_values_are_freed_with_their_function() -> None:
    # Each of fifty functions finds 10 MB.
    code = f"""
import casadi as ca, numpy as np, resource
from stiffopt import native
from stiffopt.interpreter.batched import read_batch
x, shared = ca.SX.sym("x", 2), ca.SX.sym("shared")
one = ca.Function("many", [x, shared], [ca.vertcat(*[shared * x + k for k in range(300)])])
def used():
    many = read_batch(one, (1,), recalled=True).load(native.library())
    for k in range({CALLS}):
        many(np.full((2, {POINTS}), k), 1.0)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
first = used()
print([used() for _ in range(50)][-1] - first)
"""
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert int(told.stdout) < 100_000  # [kB]


def test_functions_in_use_are_limited_and_their_places_are_used_again() -> None:
    x, shared = ca.SX.sym("x"), ca.SX.sym("shared")
    one = ca.Function("shifted", [x, shared], [x + shared])
    kept: list[ca.Function | None] = []
    while len(kept) < 1000 and None not in kept:
        kept.append(read_batch(one, (1,)).load(native.library()))
    assert 400 < len(kept) < 1000
    many = kept[-2]
    assert many is not None
    np.testing.assert_array_equal(many(np.arange(POINTS)[None], 2.0), np.arange(POINTS)[None] + 2.0)
    # A function that is built on it holds it as well.
    twice = many.map(2)
    del many
    kept.clear()
    np.testing.assert_array_equal(twice(np.ones((1, 2 * POINTS)), np.ones((1, 2))), 2.0)
    assert read_batch(one, (1,)).load(native.library()) is not None


def test_threads_that_share_a_function_do_not_disturb_each_other() -> None:
    one = random_sums(5)
    many = many_of(one, recalled=True)
    points = np.random.default_rng(6).normal(size=(40, 4, POINTS))
    expected = [many(each, [0.3, -1.7]).full() for each in points]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            found = list(pool.map(lambda each: many(each, [0.3, -1.7]).full(), points))
            np.testing.assert_array_equal(found, expected)


def test_inputs_that_are_not_given_are_zero() -> None:
    x, shared = ca.SX.sym("x"), ca.SX.sym("shared")
    wide = many_of(ca.Function("shifted", [x, shared], [x + shared + 1.0])).map(2)
    nothing = ca.DM(1, 2 * POINTS)
    np.testing.assert_array_equal(wide(nothing, ca.DM.zeros(1, 2)).full(), 1.0)
    buffer, evaluate = wide.buffer()
    found = np.zeros(2 * POINTS)
    buffer.set_res(0, memoryview(found))
    evaluate()
    np.testing.assert_array_equal(found, 1.0)


def test_signs_of_zeros_and_of_nan_are_those_of_casadi() -> None:
    x, shared = ca.SX.sym("x"), ca.SX.sym("shared")
    one = ca.Function("signs", [x, shared], [ca.sign(x)])
    points = np.resize([np.nan, 0.0, -0.0, np.inf, -np.inf, 3.0, -3.0, 5e-324], (1, POINTS))
    found = many_of(one)(points, 0.0).full()
    truth = np.array([[float(one(point, 0.0)) for point in points.ravel()]])
    # A sign that hides what is no number would make a step to nowhere look good.
    np.testing.assert_array_equal(found, truth)
    is_number = ~np.isnan(truth)
    np.testing.assert_array_equal(np.signbit(found[is_number]), np.signbit(truth[is_number]))


def test_infinite_and_undefined_constants() -> None:
    x, shared = ca.SX.sym("x"), ca.SX.sym("shared")
    bounds = ca.vertcat(x + ca.inf, x - ca.inf, x + np.nan)
    found = many_of(ca.Function("bounds", [x, shared], [bounds]))(np.ones((1, POINTS)), 0.0).full()
    np.testing.assert_array_equal(found, np.repeat([[np.inf], [-np.inf], [np.nan]], POINTS, 1))


def test_the_larger_of_two_is_that_of_the_c_library() -> None:
    a, b = ca.SX.sym("a", 8), ca.SX.sym("b", 8)
    both = ca.vertcat(ca.fmax(a, b), ca.fmin(a, b))
    one = ca.Function("both", [ca.vertcat(a, b), ca.SX(0, 1)], [both])
    first = np.array([1.0, 2.0, np.nan, 1.0, np.inf, -np.inf, -1.0, np.nan])
    second = np.array([2.0, 1.0, 1.0, np.nan, 1.0, 1.0, -2.0, np.nan])
    points = np.repeat(np.append(first, second)[:, None], POINTS, axis=1)
    expected = np.append(np.fmax(first, second), np.fmin(first, second))
    found = many_of(one)(points, ca.DM(0, 1)).full()
    np.testing.assert_array_equal(found, np.repeat(expected[:, None], POINTS, axis=1))
