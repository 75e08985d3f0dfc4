"""Compiled stage functions: made beside the first solve, kept for the next.

A library depends on formula, derivatives and CasADi, besides what `stiffopt.compiler` knows.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import casadi as ca

from stiffopt import compiler
from stiffopt.transcription import node_derivatives, wide_code

# -O1 compiles one and a half times as long for no faster evaluation, -O2 more than twice.
OPTIMISE = "-Og"
# Name of what is compiled without derivatives.
VALUES = "values"
# Inputs of a numbered stage that are the same at all points: parameters and numbers.
SHARED = (1, 2)


def library(function: ca.Function) -> Path | None:
    """Find the compiled form of a numbered stage; where there is none yet, have it made.

    Parameters
    ----------
    function : casadi.Function
        Of a `NumberedStage`; or of its inputs and of this name, to be compiled by itself: `VALUES`.

    Returns
    -------
    Path or None
        None until it is made, which takes some seconds, and where it cannot be.
    """
    return library_of(function.serialize())


def library_of(formula: str) -> Path | None:
    """The same for a function's serialised form, which takes longest to make."""
    if compiler.compiler() is None:
        return None
    made_by = [Path(str(each.__file__)).read_text() for each in (node_derivatives, wide_code)]
    made_by += [ca.CasadiMeta.version(), OPTIMISE]
    return compiler.library("stage", formula, made_by, __name__)


def _code(formula: str) -> str:
    function = ca.Function.deserialize(formula)
    alone = function.name() == VALUES
    functions = (function,) if alone else node_derivatives.with_derivatives(function)
    return wide_code.wide_code(functions, SHARED)


if __name__ == "__main__":
    os.nice(5)
    compiler.make(Path(sys.argv[1]), sys.argv[2], _code, OPTIMISE)
