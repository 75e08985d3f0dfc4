"""Stages of a solve with their meshes, and IPOPT's options."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stiffopt.problem.formulation import smoothing_stages
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING, Smoothing
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.joint_path import JointPath
from stiffopt.solver.ipopt import WARM_BARRIER, IpoptOptions
from stiffopt.transcription.mesh import Mesh, refine_mesh, split_counts, uniform_mesh
from stiffopt.transcription.ocp import Guess, OptimalControlProblem
from stiffopt.transcription.transcription import Transcription

_MIN_INTERVALS = 16
# Most intervals of the first and the second mesh where a deflection peak is minimised.
_MAX_COARSE_INTERVALS, _MAX_MIDDLE_INTERVALS = 60, 100
# Intervals of a phase below which no last mesh goes, nor a peak's coarse and middle one: with fewer
# a phase has hardly a motion that keeps its limits.
_MIN_PHASE_INTERVALS, _MIDDLE_PHASE_INTERVALS = 6, 10
# Phases from which on a coarse mesh or a correction replaces work on a fine mesh, and intervals a
# phase of a smooth problem's coarse mesh: an iteration of 31 phases takes a fifth there.
MANY_PHASES, _COARSE_START_PHASE_INTERVALS = 8, 5
# Factors on the smoothing width of dry friction, and on that of an objective's kink at zero, before
# the last stage: from a wide one, most joints reverse where the exact law is best, in a third of
# the iterations.
_FRICTION_WIDENINGS = (16.0, 4.0)
_KINK_WIDENINGS = (64.0, *_FRICTION_WIDENINGS)
# And those with many phases on the fine mesh. Second derivatives are exact in the last stage only:
# they have negative curvature wherever a joint is about to reverse, and the inertia correction for
# one of a hundred phases shortens the steps of all. Tolerance of the stages before, over the number
# of phases, each of which has that share of the objective: below it they converge linearly.
_FINE_FRICTION_WIDENINGS, _CONVEX_STAGE_TOLERANCE = (2.0, 1.0), 1e-3
# Initial barrier parameter of a smooth problem, or one of planned links, that starts near its
# optimum; least distance from bounds of the latter's start and that of a correction.
_INITIAL_NEAR_BARRIER, NEAR_BOUND_PUSH = 1e-4, 1e-3
# Phases for which the iteration limit of a problem holds; more phases have proportionally more.
_ITERATION_LIMIT_PHASES = 10
# Iterations without a nearly feasible point, after which infeasibility is analysed.
_INFEASIBLE_ITERATIONS = 100
# Initial barrier parameter, and so bound multipliers, of one duration or one peak of many phases
# from a guess. On a fine mesh, from the motion of a coarse one, a peak has that of a warm start and
# this decrease of IPOPT's inertia correction; with many phases this largest barrier, which else
# adapts so far upwards that the motion is forgotten.
_INITIAL_BARRIER, _INERTIA_CORRECTION_DECREASE, _MAX_NEAR_PEAK_BARRIER = 1e-3, 0.1, 1e-5
# Tolerances of a peak of many phases before the last mesh, whose digits are those of another mesh,
# and on it, where a correction of its rows follows.
_PEAK_TOLERANCES = (1e-4, 1e-5)
# IPOPT's options of the least distance of a start from bounds.
_BOUND_PUSH_OPTIONS = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
# Intervals per piece of a fixed path's spline, at whose ends the rate of curvature jumps: with
# fewer, limits are exceeded between the nodes.
_INTERVALS_PER_PATH_PIECE = 3
# Samples that locate a motion on a path; least time of a piece of a path, as a share of the
# average, where the guess is at rest.
PATH_SAMPLES, _MIN_PIECE_SHARE = 20001, 1e-2


@dataclass(frozen=True)
class SolveStage:
    """One NLP solve."""

    intervals: int
    smoothing: Smoothing
    # New distribution of the intervals, short where the controls of the stage before change.
    new_mesh: bool = False
    tolerance: float | None = None  # of the solver; that of the problem if left out


def plan_stages(
    problem: TrajectoryProblem, intervals: int, corners: float = 1.0
) -> tuple[SolveStage, ...]:
    """Return stages that end at `intervals` with the narrowest smoothing the problem needs.

    `corners` is the factor on the smoothing widths of the motor law.
    """
    phases = len(problem.vias) + 1
    intervals = max(intervals, _MIN_PHASE_INTERVALS * phases)
    coarse = max(intervals // 2, min(_MIN_INTERVALS, intervals))
    widths = tuple(Smoothing(width, corners) for width in smoothing_stages(problem))
    if len(widths) == 1:
        # Smooth problems converge directly from the guess; a coarse mesh would only cost time.
        start = min(_COARSE_START_PHASE_INTERVALS * phases, intervals)
        kinked = any(objective.kind.has_kink for objective in problem.objectives)
        widenings: tuple[float, ...] = _FRICTION_WIDENINGS if problem.charges_dry_friction else ()
        if kinked:
            widenings = _KINK_WIDENINGS
        exact = SolveStage(intervals, Smoothing(1.0))
        if phases < MANY_PHASES or start == intervals:
            wide = (replace(exact, smoothing=Smoothing(1.0, kinks=each)) for each in widenings)
            return (*wide, exact)
        if not widenings:
            return (replace(exact, intervals=start), replace(exact, new_mesh=True))
        convex = [
            SolveStage(
                count,
                Smoothing(1.0, kinks=each, convexity=1.0),
                tolerance=_CONVEX_STAGE_TOLERANCE / phases,
            )
            for count, wide in ((start, widenings), (intervals, _FINE_FRICTION_WIDENINGS))
            for each in wide
        ]
        convex[len(widenings)] = replace(convex[len(widenings)], new_mesh=True)
        return (*convex, exact)
    if problem.plans_links:
        # Long chains of integrators converge poorly on a new mesh: one change of mesh, directly
        # with the narrow smoothing.
        return (SolveStage(coarse, widths[1]), SolveStage(intervals, widths[-1], new_mesh=True))
    if smoothing_stages(problem) == WINDUP_SMOOTHING:
        # Each mesh is adapted to the motion before it. A middle one costs less than a second fine
        # one, and its peaks are as low. Neither has to grow with the last one, but with the phases.
        coarse = min(coarse, max(_MAX_COARSE_INTERVALS, _MIN_PHASE_INTERVALS * phases))
        most = max(_MAX_MIDDLE_INTERVALS, _MIDDLE_PHASE_INTERVALS * phases)
        middle = max(min(2 * intervals // 3, most), coarse)
        between = Smoothing(float(np.sqrt(np.prod(WINDUP_SMOOTHING[-2:]))))
        early, late = _PEAK_TOLERANCES if phases >= MANY_PHASES else (None, None)
        return (
            SolveStage(coarse, widths[0], tolerance=early),
            SolveStage(middle, between, new_mesh=True, tolerance=early),
            SolveStage(intervals, widths[-1], new_mesh=True, tolerance=late),
        )
    first = [SolveStage(coarse, width) for width in widths[:2]]
    fine = [SolveStage(intervals, width) for width in widths[1:]]
    # On the first fine mesh the intervals follow the coarse motion.
    fine[0] = replace(fine[0], new_mesh=True)
    return (*first, *fine)


def solver_options(problem: TrajectoryProblem, *, near: bool = False) -> IpoptOptions:
    """Return IPOPT's options for a problem; `near` where it starts near the optimum."""
    method, phases = problem.method, len(problem.vias) + 1
    # A barrier that adapts takes a fifth to a half of the iterations less, and steadier ones on
    # long chains of integrators.
    extra: dict[str, object] = {"mu_strategy": "adaptive"}
    if (
        problem.plans_links
        or len(smoothing_stages(problem)) == 1
        or method.intervals > _MAX_MIDDLE_INTERVALS
    ):
        # Splines and smooth programmes are well scaled: MUMPS' scaling costs iterations, with a
        # free duration half of all. On fine meshes every iteration takes half the time.
        extra |= {"mumps_pivot_order": 0, "mumps_permuting_scaling": 0, "mumps_scaling": 0}
    if len(smoothing_stages(problem)) == 1 and not problem.plans_links:
        # Steps of smooth programmes have a small residual without iterative refinement.
        extra["min_refinement_steps"] = 0
        if near:
            # All phases have a barrier, each has its share of the objective.
            barrier = _INITIAL_NEAR_BARRIER * min(1.0, _ITERATION_LIMIT_PHASES / phases)
            extra |= {"bound_mult_init_method": "mu-based", "mu_init": barrier}
    fastest = any(each.name == "duration" for each in problem.objectives)
    if fastest and not problem.plans_links:
        # Beside one duration, multipliers of 1 at thousands of bounds lead far into the interior.
        extra |= {"bound_mult_init_method": "mu-based", "mu_init": _INITIAL_BARRIER}
    peak = smoothing_stages(problem) == WINDUP_SMOOTHING and not fastest
    if peak and not problem.plans_links and method.intervals > _MAX_MIDDLE_INTERVALS:
        many = phases >= MANY_PHASES
        if near or many:
            # All nodes share the peak's multiplier. Multipliers of 1 each distort the Hessian so
            # much that the inertia correction is far too large, which takes many short steps.
            barrier = WARM_BARRIER if near else _INITIAL_BARRIER
            extra |= {"bound_mult_init_method": "mu-based", "mu_init": barrier}
        if near:
            extra["perturb_dec_fact"] = _INERTIA_CORRECTION_DECREASE
            extra |= {"mu_max": _MAX_NEAR_PEAK_BARRIER} if many else {}
    if problem.plans_links and near:
        # Multipliers of a small barrier, else the first steps lead far away from the start.
        extra |= {"bound_mult_init_method": "mu-based", "mu_init": _INITIAL_NEAR_BARRIER}
        extra |= dict.fromkeys(_BOUND_PUSH_OPTIONS, NEAR_BOUND_PUSH)
    return IpoptOptions(
        tol=method.tolerance,
        max_iterations=int(
            np.ceil(method.max_iterations * max(1.0, phases / _ITERATION_LIMIT_PHASES))
        ),
        patience=0 if problem.plans_links else _INFEASIBLE_ITERATIONS,
        extra=extra,
    )


def initial_mesh(
    problem: TrajectoryProblem, ocp: OptimalControlProblem, stage: SolveStage, guess: Guess
) -> Mesh:
    """Return equal intervals within each phase, or within each piece of a fixed path."""
    if problem.path is not None:
        return _mesh_along_path(problem.path, guess, resolving_intervals(problem, stage))
    return uniform_mesh(stage.intervals, ocp.phases, tuple(guess.phase_fractions))


def finer_mesh(
    problem: TrajectoryProblem, before: Transcription, x: np.ndarray, intervals: int
) -> Mesh:
    """Return a mesh for the motion `x`: short where controls change, on a path by its waypoints."""
    if problem.path is not None:
        return _mesh_along_path(problem.path, before.guess_from(x), intervals)
    return refine_mesh(before, x, intervals)


def _mesh_along_path(path: JointPath, guess: Guess, intervals: int) -> Mesh:
    """Return a mesh with nodes at the waypoints, where the rate of the path's curvature jumps.

    The guess is of the path coordinate and its speed.
    """
    at = np.linspace(0.0, 1.0, PATH_SAMPLES)
    shares = np.diff(np.interp(path.knots, guess.states(at)[:, 0], at))
    shares = np.maximum(shares, _MIN_PIECE_SHARE / len(shares))
    shares /= shares.sum()
    counts = split_counts(intervals, shares, _INTERVALS_PER_PATH_PIECE)
    return [np.repeat(shares / counts, counts)]


def resolving_intervals(problem: TrajectoryProblem, stage: SolveStage) -> int:
    """Return the intervals of a stage, enough to resolve the pieces of a fixed path."""
    pieces = 0 if problem.path is None else len(problem.path.knots) - 1
    return max(stage.intervals, _INTERVALS_PER_PATH_PIECE * pieces)
