"""Compiled stage functions: the same numbers, one library for many problems, safe to share."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from stiffopt import compiler
from stiffopt.transcription import compiled
from stiffopt.transcription.node_derivatives import NAMES, numbered, with_derivatives
from stiffopt.transcription.stage_function import StageFunction
from stiffopt.transcription.wide_code import POINTS

pytestmark = pytest.mark.skipif(compiler.shutil.which("cc") is None, reason="needs a C compiler")


def stage(payload: float) -> tuple[ca.Function, ca.Function]:
    """A small stage whose rows go through a torque, and that torque."""
    x, u, z, p = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("z"), ca.SX.sym("p")
    torque = payload * (u * ca.cos(x[0]) + 9.81 * ca.sin(x[0]) * x[1] ** 2)
    rows = ca.vertcat(torque**3 / (p + torque**2), z - ca.tanh(torque * x[1]), x[0] * u)
    return (
        ca.Function("stage", [x, u, z, p], [torque**2, rows]),
        ca.Function("through", [x, u, z, p], [torque]),
    )


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("STIFFOPT_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("STIFFOPT_COMPILE", raising=False)
    compiler._started.clear()
    return tmp_path / "cache"


def made(function: ca.Function) -> Path:
    """The library, after waiting for it."""
    assert compiled.library(function) is None
    compiler.wait()
    path = compiled.library(function)
    assert path is not None
    return path


def test_derivatives_are_those_of_casadi() -> None:
    function, through = stage(3.7)
    taken = numbered(function, through)
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
    taken = numbered(
        ca.Function("stage", [x, u, z, p], [ca.sumsqr(through), rows]),
        ca.Function("through", [x, u, z, p], [through]),
    )
    w, weights = ca.vertcat(x, u, z), ca.SX.sym("weights", 3)
    values = ca.vertcat(ca.sumsqr(through), rows)
    truth = ca.Function("h", [w, weights], [ca.hessian(ca.dot(weights, values), w)[0]])
    point, factors = np.array([0.3, -0.7, 1.1, 0.2]), np.array([0.5, -1.0, 2.0])
    ours = with_derivatives(taken.function)[2](point, 0.5, taken.numbers, factors)
    np.testing.assert_allclose(ours.full(), truth(point, factors).full(), rtol=1e-12)


def fast(name: str, path: Path, *inputs: object) -> np.ndarray:
    """Output of a compiled function for one point, which stands in every lane."""
    function = ca.external(name, str(path))
    given = [
        each if k in compiled.SHARED else ca.repmat(ca.DM(each), 1, POINTS)
        for k, each in enumerate(inputs)
    ]
    found = np.asarray(function(*given).full())
    lanes = np.split(found, POINTS, axis=1)
    for each in lanes[1:]:
        np.testing.assert_array_equal(each, lanes[0])
    return lanes[0]


def test_two_payloads_are_one_library(cache: Path) -> None:
    light, heavy = (numbered(*stage(payload)) for payload in (3.7, 5.1))
    path = made(light.function)
    assert compiled.library(heavy.function) == path
    point = np.array([0.3, -0.7, 1.1, 0.2])
    for each in (light, heavy):
        slow = with_derivatives(each.function)[0](point, 0.5, each.numbers)
        ours = fast(NAMES[0], path, point, 0.5, each.numbers)
        np.testing.assert_allclose(ours, slow.full(), rtol=1e-14)
    assert not np.allclose(light.numbers, heavy.numbers)


def test_compiled_derivatives_are_the_interpreted_ones(cache: Path) -> None:
    taken = numbered(*stage(2.3))
    path = made(taken.function)
    rng = np.random.default_rng(2)
    for name, slow in zip(NAMES, with_derivatives(taken.function), strict=True):
        inputs = [rng.normal(size=slow.size_in(k)) for k in range(slow.n_in())]
        np.testing.assert_allclose(fast(name, path, *inputs), slow(*inputs).full(), rtol=1e-13)


def test_the_larger_of_two_is_that_of_the_c_library(cache: Path) -> None:
    a, b = ca.SX.sym("a", 8), ca.SX.sym("b", 8)
    both = ca.vertcat(ca.fmax(a, b), ca.fmin(a, b))
    function = ca.Function(compiled.VALUES, [ca.vertcat(a, b), ca.SX(0, 1), ca.SX(0, 1)], [both])
    first = np.array([1.0, 2.0, np.nan, 1.0, np.inf, -np.inf, -1.0, np.nan])
    second = np.array([2.0, 1.0, 1.0, np.nan, 1.0, 1.0, -2.0, np.nan])
    assert compiled.library(function) is None
    compiler.wait()
    path = compiled.library(function)
    assert path is not None
    found = fast(compiled.VALUES, path, np.append(first, second), [], [])
    expected = np.append(np.fmax(first, second), np.fmin(first, second))
    np.testing.assert_array_equal(found.ravel(), expected)


def test_no_compiler_no_library(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    assert compiled.library(numbered(*stage(2.3)).function) is None
    assert not cache.exists()
    monkeypatch.delenv("CC")
    monkeypatch.setenv("STIFFOPT_COMPILE", "never")
    assert compiled.library(numbered(*stage(2.3)).function) is None


def test_a_cache_that_cannot_be_written_only_costs_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cache: Path
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("STIFFOPT_CACHE", str(tmp_path / "file" / "cache"))
    assert compiled.library(numbered(*stage(2.3)).function) is None


def test_a_killed_compile_is_done_again(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = cache.parent / "slow-cc"
    slow.write_text('#!/bin/sh\nsleep 30\nexec cc "$@"\n')
    slow.chmod(0o755)
    monkeypatch.setenv("CC", str(slow))
    function = numbered(*stage(2.3)).function
    assert compiled.library(function) is None
    (process,) = compiler._started.values()
    deadline = time.monotonic() + 20.0
    while not list(cache.glob("stage-*.parts-*/code.c")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert compiler.libraries() == []
    # Another process, or this one later, finds the lock free; what was left is swept away.
    compiler._started.clear()
    slow.write_text('#!/bin/sh\nexec cc "$@"\n')
    made(function)
    assert list(cache.glob("stage-*.parts-*")) == []


@pytest.mark.parametrize("left", [0, 7, 4096])
def test_a_damaged_library_is_made_again(cache: Path, left: int) -> None:
    function = numbered(*stage(2.3)).function
    path = made(function)
    whole = path.stat().st_size
    # As a disk leaves it that lost its power. Not in place: this process has it open.
    part = path.with_suffix(".part")
    part.write_bytes(path.read_bytes()[:left])
    part.replace(path)
    compiler._started.clear()
    assert made(function) == path
    assert path.stat().st_size == whole


def test_nothing_is_left_of_a_compiler_that_fails(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "false")
    assert compiled.library(numbered(*stage(2.3)).function) is None
    compiler.wait()
    assert [each.suffix for each in cache.iterdir()] == [".lock"]
    (cache / "stage-killed.given").write_text("")
    assert compiler.clear() == 0
    assert list(cache.iterdir()) == []


def test_many_processes_may_ask_at_once(cache: Path) -> None:
    function = numbered(*stage(2.3)).function
    assert compiled.library(function) is None
    (path,) = compiler._started
    asking = [
        subprocess.Popen([sys.executable, "-m", compiled.__name__, str(path), "cc"])
        for _ in range(3)
    ]
    assert [each.wait() for each in asking] == [0, 0, 0]
    compiler.wait()
    assert compiled.library(function) == path
    assert compiler.clear() == 1
    assert compiler.libraries() == []


def test_a_programme_may_have_any_number_of_points(cache: Path) -> None:
    taken = numbered(*stage(2.3))
    count = POINTS + 3
    slow = StageFunction(taken, count, 1)
    compiler.wait()
    quick = StageFunction(taken, count, 1)
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


@pytest.mark.parametrize("what", ["folder", "library"])
def test_what_others_can_write_is_not_loaded(cache: Path, capsys, what: str) -> None:
    light = numbered(*stage(3.7)).function
    path = made(light)
    assert not (cache.stat().st_mode | path.stat().st_mode) & 0o022
    compiler._is_private.cache_clear()
    (cache if what == "folder" else path).chmod(0o777)
    assert compiled.library(light) is None
    assert compiled.library(light) is None
    assert capsys.readouterr().err.count("is not used: others may have written it") == 1
