"""Cost of preparing a problem's formulas for the interpreter, and its speed beside CasADi's."""

from __future__ import annotations

import time
from dataclasses import replace
from unittest import mock

import casadi as ca
import numpy as np
from common import HERE, Row, main

from stiffopt import native
from stiffopt.interpreter.batched import read_batch
from stiffopt.problem.files import load_problem
from stiffopt.solver.solve import solve
from stiffopt.symbolic import BufferedFunction
from stiffopt.transcription import point_function

TITLE = "Interpreter"
PROBLEMS = (
    "ur10_torque_squared",
    "er3a_pick_and_place",
    "ur10_tool_deviation",
    "er3a_tool_deviation",
)
ROUNDS = 20


def run() -> list[Row]:
    """Prepare and evaluate the formulas of some shipped problems."""
    if native.library() is None:
        return [Row("compiled core", "none")]
    return [row for name in PROBLEMS for row in of_problem(name)]


def of_problem(name: str) -> list[Row]:
    """Time to prepare all formulas, and of an evaluation of the Hessian beside CasADi's."""
    functions, library = formulas(name), native.library()
    assert library is not None
    begin = time.process_time()
    made = [read_batch(each, (1, 2)).load(library) for each in functions]
    prepared = time.process_time() - begin
    slow, fast = max(
        zip(functions, made, strict=True), key=lambda pair: int(pair[0].n_instructions())
    )
    assert fast is not None
    own, quick = microseconds(slow, fast)
    return [
        Row(f"{name}, {len(functions)} functions: preparing them", f"{prepared:.1f} s"),
        Row(
            f"{name}: second derivatives of a point, CasADi / batched instructions",
            f"{own:.0f} us / {quick:.1f} us = {own / quick:.0f}",
        ),
    ]


def formulas(name: str) -> list[ca.Function]:
    """All functions that a solve of the problem evaluates; they do not depend on its mesh."""
    problem = load_problem(HERE.parent / "problems" / f"{name}.toml").problem
    found: list[ca.Function] = []
    with (
        mock.patch.object(
            point_function, "batched", lambda _, each, *__, **___: found.append(each)
        ),
        mock.patch.dict(point_function.kept_functions, clear=True),
        mock.patch.dict(point_function.kept_batches, clear=True),
    ):
        solve(replace(problem, method=replace(problem.method, intervals=8)), throw=False)
    return found


def microseconds(slow: ca.Function, fast: ca.Function) -> tuple[float, float]:
    """Least time of a point by CasADi and by the interpreter, in turn."""
    draw = np.random.default_rng(5)
    least = [np.inf, np.inf]
    for _ in range(ROUNDS):
        for k, each in enumerate((slow, fast)):
            given = [draw.uniform(0.5, 1.5, each.nnz_in(i)) for i in range(each.n_in())]
            points = each.size2_in(0)
            evaluate = BufferedFunction(each)
            begin = time.perf_counter()
            evaluate(*given)
            least[k] = min(least[k], 1e6 * (time.perf_counter() - begin) / points)
    return least[0], least[1]


if __name__ == "__main__":
    main(TITLE, run)
