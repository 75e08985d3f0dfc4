"""A linear solver that IPOPT loads: the frontal method, for unknowns ordered in time.

Of a system of thousands of unknowns of a motion, some dozens meet at once. MUMPS, which knows
nothing of that, takes five to ten times as long.
"""

from __future__ import annotations

from pathlib import Path


def ipopt_options(library: Path | None) -> dict[str, str | int | float]:
    """Return IPOPT's options for the linear solver.

    frontal.c is part of the `library`, with the interface of HSL_MA97; MUMPS where there is none.
    """
    if library is None:
        return {"linear_solver": "mumps"}
    return {
        "linear_solver": "ma97",
        "hsllib": str(library),
        # Its residuals are small as they are: refined where IPOPT finds one that is not.
        "min_refinement_steps": 0,
        # Smallest pivots relative to what they meet; where residuals are large, those that MUMPS is
        # asked to take. With larger ones, delayed pivots double the time of many phases.
        "ma97_u": 1e-8,
        "ma97_umax": 1e-6,
        # Orderings and scalings that MA97 would compute first.
        "ma97_order": "amd",
        "ma97_scaling": "none",
        "linear_system_scaling": "none",
    }
