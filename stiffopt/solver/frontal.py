"""IPOPT's linear systems by the frontal method (frontal.c), where the library is there already.

Unknowns of a motion follow one another in time: of a system of thousands, some dozens meet at once.
MUMPS, which knows nothing of that, takes five to ten times as long.
"""

from __future__ import annotations

import functools
from pathlib import Path

from stiffopt import compiler

_SOURCES = ("frontal_analysis.c", "frontal.c")
KIND = "frontal"


def library() -> Path | None:
    """The library; None until it is made beside other work, and where it cannot be."""
    return compiler.library(KIND, _source())


def options(made: Path) -> dict[str, str | int | float]:
    """What IPOPT is told to use it: it has the interface of HSL_MA97, which IPOPT loads by name."""
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


@functools.cache
def _source() -> str:
    each = (Path(__file__).with_name(name) for name in _SOURCES)
    return "\n".join(path.read_text(encoding="ascii") for path in each)
