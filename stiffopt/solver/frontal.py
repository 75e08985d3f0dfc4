"""IPOPT's linear systems by the frontal method (frontal.c), where the library is there already.

Unknowns of a motion follow one another in time: of a system of thousands, some dozens meet at once.
MUMPS, which knows nothing of that, takes five to ten times as long.
"""

from __future__ import annotations

from pathlib import Path

from stiffopt import compiler
from stiffopt.c_code import source

_SOURCES = tuple(Path(__file__).with_name(name) for name in ("frontal_analysis.c", "frontal.c"))


def library() -> Path | None:
    """The library; None until it is made beside other work, and where it cannot be."""
    return compiler.library("frontal", source(*_SOURCES))


def options() -> dict[str, str | int | float]:
    """What IPOPT is told: the library has the interface of HSL_MA97; without it, MUMPS."""
    made = library()
    if made is None:
        return {"linear_solver": "mumps"}
    return {
        "linear_solver": "ma97",
        "hsllib": str(made),
        # Its residuals are small as they are: refined where IPOPT finds one that is not.
        "min_refinement_steps": 0,
        # Pivots as small, relative to what they meet, as MUMPS is asked to take.
        "ma97_u": 1e-6,
        # What MA97 would do before it begins.
        "ma97_order": "amd",
        "ma97_scaling": "none",
        "linear_system_scaling": "none",
    }
