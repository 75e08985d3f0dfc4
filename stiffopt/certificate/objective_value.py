"""Value of an objective on an assessed motion: the number that is reported and compared."""

from __future__ import annotations

from typing import Any

import numpy as np

from stiffopt.problem.objectives import DEFLECTIONS, Objective
from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import ObjectiveValue


def term_value(objective: Objective, motion: Assessment, joints: int) -> float:
    """One objective in its SI unit, from the fine grid of an assessment."""
    if objective.name in DEFLECTIONS:
        part = motion.deflection_summary()[objective.name.removesuffix("_deflection")]
        return float(getattr(part, objective.measure))
    if objective.name == "duration":
        return motion.duration
    numbers = objective.joints or tuple(range(1, joints + 1))
    if objective.name == "joint_stiffness":
        return min(motion.lowest_stiffness[j - 1].value / objective.weight_of(j) for j in numbers)
    return float(sum(motion.integrals[f"{objective.name}_{j}"] for j in numbers))


def objective_value(problem: Any, motion: Assessment) -> ObjectiveValue:
    """The problem's whole objective on an assessed motion.

    A single objective keeps its own unit and sign (the minimum stiffness is reported as it is). A
    weighted sum is reported as the sum that was minimised, in mixed SI units.
    """
    terms = problem.objectives
    values = [term_value(term, motion, problem.joints) for term in terms]
    if len(terms) == 1:
        term = terms[0]
        measure = term.measure if term.name in DEFLECTIONS else ""
        return ObjectiveValue(name=term.name, measure=measure, value=values[0], unit=term.unit)
    signs = [-1.0 if term.maximised else 1.0 for term in terms]
    total = float(np.dot(signs, [t.weight * v for t, v in zip(terms, values, strict=True)]))
    return ObjectiveValue(
        name="weighted_sum",
        measure="",
        value=total,
        unit="",
        terms={
            " ".join(filter(None, (t.name, t.measure if t.name in DEFLECTIONS else ""))): v
            for t, v in zip(terms, values, strict=True)
        },
    )


def is_maximised(problem: Any) -> bool:
    """Whether a larger objective is better: only for the minimum stiffness on its own."""
    return len(problem.objectives) == 1 and bool(problem.objectives[0].maximised)


def improvement(problem: Any, value: float, baseline: float) -> float | None:
    """Ratio to a baseline's objective: below one is better, for maximised objectives too.

    None where a ratio has no meaning: values that are not positive and finite.
    """
    if not (0.0 < value < np.inf and 0.0 < baseline < np.inf):
        return None
    return baseline / value if is_maximised(problem) else value / baseline
