"""What compiling a problem's formulas costs, and how much faster they are then.

CPU seconds of all formulas of a problem that no library has been made of before.
"""

from __future__ import annotations

import resource
import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from unittest import mock

import casadi as ca
import numpy as np
from common import HERE, Row, main

from stiffopt import compiler
from stiffopt.problem.files import load_problem
from stiffopt.solver.solve import solve
from stiffopt.symbolic import BufferedFunction
from stiffopt.transcription import compiled, node_derivatives

TITLE = "Compiling"
PROBLEMS = (
    "ur10_torque_squared",
    "er3a_pick_and_place",
    "ur10_tool_deviation",
    "er3a_tool_deviation",
)
# Of the compiler [s].
MOST = 10.0
ROUNDS = 20


def run() -> list[Row]:
    """Compile the formulas of some shipped problems."""
    if not compiled.is_possible():
        return [Row("a C compiler", "none")]
    return [row for name in PROBLEMS for row in of_problem(name)]


def of_problem(name: str) -> list[Row]:
    """Time to compile, and of an evaluation beside CasADi's."""
    texts = formulas(name)
    written = built = 0.0
    with tempfile.TemporaryDirectory() as folder:
        libraries = []
        for k, text in enumerate(texts):
            source, made = Path(folder) / f"{k}.c", Path(folder) / f"{k}.so"
            begin = time.process_time()
            source.write_text(compiled.code_of(text))
            middle, used = time.process_time(), children()
            compiler.build(str(shutil.which("cc")), source, made, compiled.OPTIMISE)
            written, built = written + middle - begin, built + children() - used
            libraries.append(made)
        hessian = node_derivatives.NAMES[-1]
        made_of = zip(texts, libraries, strict=True)
        slow, fast = next(
            microseconds(function, library)
            for text, library in made_of
            if (function := compiled.functions_of(text)[-1]).name() == hessian
        )
    what = f"{name}, {len(texts)} formulas"
    return [
        Row(f"{what}: C compiler", f"{built:.1f} s", "", f"{MOST:.0f} s at most", built <= MOST),
        Row(f"{what}: writing the code", f"{written:.1f} s"),
        Row(
            f"{name}: second derivatives of a point, CasADi's interpreter / compiled",
            f"{slow:.0f} us / {fast:.1f} us = {slow / fast:.0f}",
        ),
    ]


def formulas(name: str) -> list[str]:
    """All that a solve of the problem would have compiled; they do not depend on its mesh."""
    problem = load_problem(HERE.parent / "problems" / f"{name}.toml").problem
    found: dict[str, None] = {}
    with mock.patch.object(compiled, "library_of", lambda text: found.setdefault(text)):
        solve(replace(problem, method=replace(problem.method, intervals=8)), throw=False)
    return list(found)


def children() -> float:
    """CPU seconds of processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def microseconds(slow: ca.Function, library: Path) -> tuple[float, float]:
    """Least time of a point by CasADi and by the library, in turn."""
    fast = ca.external(slow.name(), str(library))
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
