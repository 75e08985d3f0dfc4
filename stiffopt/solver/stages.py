"""Stages of one solve: coarse before fine, wide smoothing before narrow."""

from __future__ import annotations

from dataclasses import dataclass, replace

from stiffopt.problem.objectives import SMOOTHED
from stiffopt.problem.trajectory import TrajectoryProblem

# Reducer steps blur the tangent stiffness far more than the wind-up, so that a stiffness objective
# or floor ends with a narrower smoothing than a deflection.
_DEFLECTION_WIDTHS = (4.0, 1.0, 0.25)
_STIFFNESS_WIDTHS = (4.0, 1.0, 0.25, 0.05)
_LEAST_INTERVALS = 16


@dataclass(frozen=True)
class Stage:
    """One NLP solve.

    Parameters
    ----------
    intervals : int
    smoothing : float
        Factor on the smoothing widths of the stiffness model.
    new_mesh : bool
        Place the intervals anew, short where the controls of the stage before change.
    """

    intervals: int
    smoothing: float
    new_mesh: bool = False


def stages(problem: TrajectoryProblem, intervals: int) -> tuple[Stage, ...]:
    """Stages that end at `intervals` with the narrowest smoothing the problem needs."""
    coarse = max(intervals // 2, min(_LEAST_INTERVALS, intervals))
    widths = smoothing_widths(problem)
    if len(widths) == 1:
        # Smooth problems converge from the guess at once; a coarse mesh would only cost time.
        return (Stage(intervals, 1.0),)
    first = [Stage(coarse, width) for width in widths[:2]]
    fine = [Stage(intervals, width) for width in widths[1:]]
    # On the first fine mesh the intervals follow the coarse motion.
    fine[0] = replace(fine[0], new_mesh=True)
    if widths == _DEFLECTION_WIDTHS:
        # Placing them once more by the fine motion lowers a peak deflection by 2 %.
        fine[-1] = replace(fine[-1], new_mesh=True)
    return (*first, *fine)


def smoothing_widths(problem: TrajectoryProblem) -> tuple[float, ...]:
    """Factors on the smoothing widths, wide to narrow; (1,) where stiffness plays no part."""
    names = {objective.name for objective in problem.objectives}
    limits = problem.active_limits
    if names & {"joint_stiffness", "mean_compliance"} or limits.joint_stiffness:
        return _STIFFNESS_WIDTHS
    capped = min(limits.dynamic_deflection, limits.total_deflection) < float("inf")
    return _DEFLECTION_WIDTHS if names & set(SMOOTHED) or capped else (1.0,)
