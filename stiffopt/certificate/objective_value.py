"""Certified value of an objective: the number that is reported and compared."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import ObjectiveValue

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem


def objective_value(problem: TrajectoryProblem, motion: Assessment) -> ObjectiveValue:
    """Return the problem's objective on an assessed motion.

    A single objective keeps its own unit and sign (the minimum stiffness is reported as it is). A
    weighted sum is reported as the sum that was minimised, in mixed SI units.
    """
    terms = problem.objectives
    values = [term.kind.certified_value(term, motion) for term in terms]
    if len(terms) == 1:
        term = terms[0]
        return ObjectiveValue(
            name=term.name, measure=term.shown_measure, value=values[0], unit=term.unit
        )
    signs = [-1.0 if term.maximised else 1.0 for term in terms]
    total = float(np.dot(signs, [t.weight * v for t, v in zip(terms, values, strict=True)]))
    return ObjectiveValue(
        name="weighted_sum",
        measure="",
        value=total,
        unit="",
        terms={
            f"{t.name} {t.shown_measure}".strip(): v for t, v in zip(terms, values, strict=True)
        },
    )


def is_maximised(problem: TrajectoryProblem) -> bool:
    """Return True where a larger objective is better: the minimum stiffness as only objective."""
    return len(problem.objectives) == 1 and bool(problem.objectives[0].maximised)


def improvement(problem: TrajectoryProblem, value: float, baseline: float) -> float | None:
    """Return the ratio to a baseline's objective; below one is better, also when maximising.

    None where a ratio has no meaning: values that are not positive and finite.
    """
    if not (0.0 < value < np.inf and 0.0 < baseline < np.inf):
        return None
    return baseline / value if is_maximised(problem) else value / baseline
