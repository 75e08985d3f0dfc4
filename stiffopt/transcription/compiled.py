"""Compiled stage functions: made beside the first solve, kept for the next.

A library depends on formula, derivatives and CasADi, besides what `stiffopt.compiler` knows.
"""

from __future__ import annotations

import functools
import json
import os
import sys
from dataclasses import asdict
from pathlib import Path

import casadi as ca

from stiffopt import c_code, compiler
from stiffopt.transcription import (
    along_splines,
    node_derivatives,
    operations,
    runs,
    sums,
    wide_code,
)
from stiffopt.transcription.along_splines import AlongSplines

OPTIMISE = "-O2"
# Name of what is compiled without derivatives.
VALUES = "values"
# Inputs of a numbered stage that are the same at all points: parameters and numbers.
SHARED = (1, 2)


def library(function: ca.Function, along: AlongSplines | None = None) -> Path | None:
    """Find the compiled form of a numbered stage; where there is none yet, have it made.

    Parameters
    ----------
    function : casadi.Function
        Of a `NumberedStage`; or of its inputs and of this name, to be compiled by itself: `VALUES`.
    along : AlongSplines, optional
        Of the `NumberedStage`.

    Returns
    -------
    Path or None
        None until it is made, which takes some seconds, and where it cannot be.
    """
    return library_of(text_of(function, along))


def text_of(function: ca.Function, along: AlongSplines | None = None) -> str:
    """All that a library is made of, which takes longest to tell."""
    known = None if along is None else asdict(along)
    return f"{json.dumps(known)}\n{function.serialize()}"


def is_possible() -> bool:
    """Return whether stages may be compiled; STIFFOPT_COMPILE=package leaves them uncompiled."""
    return os.environ.get("STIFFOPT_COMPILE") != "package" and compiler.compiler() is not None


def library_of(text: str) -> Path | None:
    """As `library`, of what `text_of` has told."""
    if not is_possible():
        return None
    return compiler.library("stage", text, _made_by(), __name__)


@functools.cache
def _made_by() -> tuple[str, ...]:
    makers = (node_derivatives, along_splines, operations, sums, runs, wide_code, c_code)
    texts = (Path(str(each.__file__)).read_text() for each in makers)
    return (*texts, ca.CasadiMeta.version(), OPTIMISE)


def functions_of(text: str) -> tuple[ca.Function, ...]:
    """The functions that a library of `text_of` holds, by CasADi."""
    known, formula = text.split("\n", 1)
    along, function = json.loads(known), ca.Function.deserialize(formula)
    functions: tuple[ca.Function, ...] = (function,)
    if function.name() != VALUES:
        functions = node_derivatives.with_derivatives(function)
    if along is not None:
        functions = AlongSplines(**along).of_stage(functions)
    return functions


def code_of(text: str) -> str:
    """C code of a library."""
    return wide_code.wide_code(functions_of(text), SHARED, node_derivatives.NAMES[:2])


if __name__ == "__main__":
    compiler.make(Path(sys.argv[1]), sys.argv[2], code_of, OPTIMISE)
