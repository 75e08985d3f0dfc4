"""Code for several points at once: every operation, to the last digit, in every lane."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from stiffopt import compiler
from stiffopt.transcription import compiled, sums, wide_code
from stiffopt.transcription.operations import operations_of
from stiffopt.transcription.runs import in_runs, places
from stiffopt.transcription.sums import instructions
from stiffopt.transcription.wide_code import POINTS

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")


def made(functions: list[ca.Function], folder: Path) -> Path:
    source, library = folder / "wide.c", folder / "wide.so"
    source.write_text(wide_code.wide_code(functions, (1,)))
    compiler.build("cc", source, library, compiled.OPTIMISE)
    return library


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


def test_every_operation_is_that_of_casadi(tmp_path: Path) -> None:
    one = every_operation()
    many = ca.external("every", str(made([one], tmp_path)))
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
def test_sums_have_the_digits_of_casadi(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sums, "_KINDS", 20)
    one = random_sums(seed)
    many = ca.external("sums", str(made([one], tmp_path)))
    points = np.random.default_rng(seed).normal(size=(4, POINTS))
    slow = np.hstack([one(point, [0.3, -1.7]).full() for point in points.T])
    np.testing.assert_allclose(many(points, [0.3, -1.7]).full(), slow, rtol=1e-14, atol=0)
    found = instructions(operations_of(one), wide_code.KINDS)
    assert len({each.kind for each in found if "+" in each.kind or "-" in each.kind}) <= 20 + 8
    assert max(len(each.read) for each in found) > 4


def test_runs_read_what_has_been_computed_and_not_been_replaced() -> None:
    operations = operations_of(random_sums(1))
    listed = instructions(operations, wide_code.KINDS)
    runs = in_runs(listed)
    given = [v for v in range(len(operations.values)) if not operations.is_computed(v)]
    results = [value for _, _, value in operations.results]
    place, count = places(given, runs, results)
    held = {place[value]: value for value in given}
    for run in runs:
        assert {each.kind for each in run} == {run[0].kind}
        for each in run:
            assert [held[place[value]] for value in each.read] == list(each.read)
            held[place[each.value]] = each.value
    assert [held[place[value]] for value in results] == results
    assert len(runs) < len(listed) == sum(map(len, runs))
    assert count == max(place.values()) + 1 < len(listed)


def test_what_is_recalled_is_what_would_be_found(tmp_path: Path) -> None:
    one = random_sums(2)
    source, library = tmp_path / "wide.c", tmp_path / "wide.so"
    source.write_text(wide_code.wide_code([one], (1,), [one.name()]))
    compiler.build("cc", source, library, compiled.OPTIMISE)
    many = ca.external("sums", str(library))
    draw = np.random.default_rng(4)
    # More than are kept, each of them twice, and some again when they are gone.
    points = draw.normal(size=(wide_code.CALLS + 20, 4, POINTS))
    points[1] = points[0]
    points[1][3, -1] += 1e-9
    once = ca.external("sums", str(made([one], tmp_path)))
    expected = [once(each, [0.3, -1.7]).full() for each in points]
    for k in (0, 1, 0, *np.repeat(np.arange(len(points)), 2), *range(len(points)), 0, 1):
        np.testing.assert_array_equal(many(points[k], [0.3, -1.7]).full(), expected[k])
    assert not np.array_equal(many(points[3], [0.3, -1.6]).full(), expected[3])


def test_what_is_recalled_goes_with_its_function(tmp_path: Path) -> None:
    x, shared = ca.SX.sym("x", 2), ca.SX.sym("shared")
    one = ca.Function("many", [x, shared], [ca.vertcat(*[shared * x + k for k in range(300)])])
    source, library = tmp_path / "wide.c", tmp_path / "wide.so"
    source.write_text(wide_code.wide_code([one], (1,), [one.name()]))
    compiler.build("cc", source, library, compiled.OPTIMISE)
    # Each of fifty functions finds 10 MB.
    code = f"""
import casadi as ca, numpy as np, resource
def used():
    many = ca.external("many", {str(library)!r})
    for k in range({wide_code.CALLS}):
        many(np.full((2, {POINTS}), k), 1.0)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
first = used()
print([used() for _ in range(50)][-1] - first)
"""
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert int(told.stdout) < 100_000  # [kB]


def test_what_is_not_given_is_zero(tmp_path: Path) -> None:
    x, shared = ca.SX.sym("x"), ca.SX.sym("shared")
    library = made([ca.Function("shifted", [x, shared], [x + shared + 1.0])], tmp_path)
    wide = ca.external("shifted", str(library)).map(2)
    nothing = ca.DM(1, 2 * POINTS)
    np.testing.assert_array_equal(wide(nothing, ca.DM.zeros(1, 2)).full(), 1.0)
    buffer, evaluate = wide.buffer()
    found = np.zeros(2 * POINTS)
    buffer.set_res(0, memoryview(found))
    evaluate()
    np.testing.assert_array_equal(found, 1.0)


def test_a_compiler_that_knows_no_native_is_asked_without(tmp_path: Path) -> None:
    strict = tmp_path / "strict"
    strict.write_text("#!/bin/sh\ncase $* in *native*) exit 1;; esac\nexec cc $*\n")
    strict.chmod(0o755)
    source, library = tmp_path / "wide.c", tmp_path / "wide.so"
    source.write_text(wide_code.wide_code([every_operation()], (1,)))
    compiler.build(str(strict), source, library, compiled.OPTIMISE)
    assert library.exists()
    with pytest.raises(subprocess.CalledProcessError):
        compiler.build("false", source, library, compiled.OPTIMISE)


def test_signs_of_zeros_and_of_what_is_no_number_are_those_of_casadi(tmp_path: Path) -> None:
    x, shared = ca.SX.sym("x"), ca.SX.sym("shared")
    one = ca.Function("signs", [x, shared], [ca.sign(x)])
    points = np.resize([np.nan, 0.0, -0.0, np.inf, -np.inf, 3.0, -3.0, 5e-324], (1, POINTS))
    found = ca.external("signs", str(made([one], tmp_path)))(points, 0.0).full()
    truth = np.array([[float(one(point, 0.0)) for point in points.ravel()]])
    # A sign that hides what is no number would make a step to nowhere look good.
    np.testing.assert_array_equal(found, truth)
    is_number = ~np.isnan(truth)
    np.testing.assert_array_equal(np.signbit(found[is_number]), np.signbit(truth[is_number]))


def test_what_has_no_digits_is_named(tmp_path: Path) -> None:
    x, shared = ca.SX.sym("x"), ca.SX.sym("shared")
    bounds = ca.vertcat(x + ca.inf, x - ca.inf, x + np.nan)
    library = made([ca.Function("bounds", [x, shared], [bounds])], tmp_path)
    found = ca.external("bounds", str(library))(np.ones((1, POINTS)), 0.0).full()
    np.testing.assert_array_equal(found, np.repeat([[np.inf], [-np.inf], [np.nan]], POINTS, 1))
