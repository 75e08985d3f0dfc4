"""A simulator of recordings that shares nothing with what is tested against it.

Two masses a joint, dry friction as a set, tabulated elasticity, a drive controller on counted
encoders, and a true robot that differs from the nominal one by its tolerances in every case.
"""

from .case import build_world, simulate
from .effects import EFFECTS
from .other_machines import ROBOTS
from .spec import Case, CaseSpec, RunRecord, Trace
from .writing import truth_text, write_case, write_truth

__all__ = [
    "EFFECTS",
    "ROBOTS",
    "Case",
    "CaseSpec",
    "RunRecord",
    "Trace",
    "build_world",
    "simulate",
    "truth_text",
    "write_case",
    "write_truth",
]
