"""How a problem is solved: its stages, and what IPOPT is told."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stiffopt.problem.formulation import smoothing_stages
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING, Smoothing
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.solver.ipopt import IpoptOptions

_LEAST_INTERVALS = 16
# Intervals of the first and the second mesh of a deflection's peak, however fine the last is.
_MOST_COARSE, _MOST_MIDDLE = 60, 100
# Iterations without a point that keeps all rows, after which it is asked whether there is any.
_PATIENCE = 100
# First barrier of a minimum duration, and so its bounds' multipliers.
_DURATION_BARRIER = 1e-3
# That of a peak on a fine mesh, from the motion of a coarse one; and to what share of the last one
# a correction of the inertia falls.
_PEAK_BARRIER, _FALL = 1e-6, 0.1
# IPOPT's names of how far a start is moved from bounds.
_PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")


@dataclass(frozen=True)
class SolveStage:
    """One NLP solve.

    Parameters
    ----------
    intervals : int
    smoothing : Smoothing
    new_mesh : bool
        Place the intervals anew, short where the controls of the stage before change.
    """

    intervals: int
    smoothing: Smoothing
    new_mesh: bool = False


def stages(
    problem: TrajectoryProblem, intervals: int, corners: float = 1.0
) -> tuple[SolveStage, ...]:
    """Stages that end at `intervals` with the narrowest smoothing the problem needs.

    `corners` is the factor on the widths of the law by which motors lead planned links.
    """
    coarse = max(intervals // 2, min(_LEAST_INTERVALS, intervals))
    widths = tuple(Smoothing(width, corners) for width in smoothing_stages(problem))
    if len(widths) == 1:
        # Smooth problems converge from the guess at once; a coarse mesh would only cost time.
        return (SolveStage(intervals, Smoothing(1.0)),)
    if problem.plans_links:
        # Long chains of integrators take a new mesh badly: one, and the narrow smoothing at once.
        return (SolveStage(coarse, widths[1]), SolveStage(intervals, widths[-1], new_mesh=True))
    if smoothing_stages(problem) == WINDUP_SMOOTHING:
        # Each mesh follows the motion before it. A middle one costs less than a second fine one,
        # and its peaks are as low. Neither has to grow with the last one.
        coarse = min(coarse, _MOST_COARSE)
        middle = max(min(2 * intervals // 3, _MOST_MIDDLE), coarse)
        between = Smoothing(float(np.sqrt(np.prod(WINDUP_SMOOTHING[-2:]))))
        return (
            SolveStage(coarse, widths[0]),
            SolveStage(middle, between, new_mesh=True),
            SolveStage(intervals, widths[-1], new_mesh=True),
        )
    first = [SolveStage(coarse, width) for width in widths[:2]]
    fine = [SolveStage(intervals, width) for width in widths[1:]]
    # On the first fine mesh the intervals follow the coarse motion.
    fine[0] = replace(fine[0], new_mesh=True)
    return (*first, *fine)


def solver_options(problem: TrajectoryProblem, *, near: bool = False) -> IpoptOptions:
    """What IPOPT is told for a problem; `near` where it begins near the optimum."""
    method = problem.method
    # A barrier that adapts takes a fifth to a half of the iterations less, and steadier ones on
    # long chains of integrators.
    extra: dict[str, object] = {"mu_strategy": "adaptive"}
    if (
        problem.plans_links
        or len(smoothing_stages(problem)) == 1
        or method.intervals > _MOST_MIDDLE
    ):
        # Splines and smooth programmes are well scaled as they are: what MUMPS does to them costs
        # steps, with a free duration half of all. On fine meshes every step takes half the time.
        extra |= {"mumps_pivot_order": 0, "mumps_permuting_scaling": 0, "mumps_scaling": 0}
    if len(smoothing_stages(problem)) == 1 and not problem.plans_links:
        # Of smooth programmes the residual of a step is small enough as it is: refined if not.
        extra["min_refinement_steps"] = 0
    fastest = any(each.name == "duration" for each in problem.objectives)
    if fastest and not problem.plans_links:
        # Beside one duration, multipliers of 1 at thousands of bounds lead far into the inside.
        extra |= {"bound_mult_init_method": "mu-based", "mu_init": _DURATION_BARRIER}
    peak = smoothing_stages(problem) == WINDUP_SMOOTHING and not fastest
    if near and peak and not problem.plans_links and method.intervals > _MOST_MIDDLE:
        # All nodes share the peak's multiplier. Of 1 each they bend the programme so much that the
        # inertia is mended by far more than is needed, and for many short steps.
        extra |= {"bound_mult_init_method": "mu-based", "mu_init": _PEAK_BARRIER}
        extra["perturb_dec_fact"] = _FALL
    if problem.plans_links and near:
        # Multipliers of a small barrier, else the motion is first led far away from where it is.
        extra |= {"bound_mult_init_method": "mu-based", "mu_init": 1e-4}
        extra |= dict.fromkeys(_PUSHES, 1e-3)
    return IpoptOptions(
        tol=method.tolerance,
        max_iterations=method.max_iterations,
        patience=0 if problem.plans_links else _PATIENCE,
        extra=extra,
    )
