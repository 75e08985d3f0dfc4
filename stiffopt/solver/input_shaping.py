"""Input shaping: motions averaged over a period of the arm's lowest mode, robust to model errors.

The quasi-static optimum for a duration shorter by one period of the lowest mode is averaged over
that period (a box filter, whose spectrum is zero at that frequency). An average keeps every bound
on position and its derivatives; it cuts corners at vias, whose tolerances are backed off by as
much, like limits that the motors exceed in leading the links. The lead by the wind-up leaves no
residual vibration on the arm as modelled; a model error leaves the wind-up's share in it, which the
filter has made slow.

Source: Singer, Seering (1990), "Preshaping command inputs to reduce system vibration".
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.baseline.baselines import better_baseline, strict_baseline
from stiffopt.certificate.assess import assess, drive_violations
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.objective_value import improvement, objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE, DRIVE_LIMITS
from stiffopt.command.smoothing_width import (
    KINK_EXCESS,
    KNOT_SPACINGS,
    motors_with_sufficient_smoothing,
)
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.elastic.smooth_motion import AveragedMotion, smooth_motion
from stiffopt.errors import ProblemError
from stiffopt.problem.bounds import shortest_duration
from stiffopt.problem.input_checks import clearance_at_poses
from stiffopt.problem.limit import Limits
from stiffopt.problem.motor_model import MotorLaw
from stiffopt.problem.objective import Objective
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.solution import Baseline, Solution
from stiffopt.result.status import SolveStatus
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.exchange import Oracle, Proposal, exchange
from stiffopt.solver.solve_run import MIN_SOLVE_TIME, SolveRun

_MAX_BACK_OFF_ROUNDS = 5
# Shares of limits and via tolerances that remain at least.
_MIN_LIMIT_SHARE = 0.1
# Back-off over the excess.
_BACK_OFF_FACTOR = 1.1
# Averaging windows in periods of the lowest mode: where a baseline that keeps all limits is better,
# a whole period leaves too little of the time for the motion.
_DEFAULT_WINDOWS = ((1.0, "a period"), (0.5, "half a period"), (0.25, "a quarter of a period"))
# Windows for uncertain arms, and their objective over the estimate from the remaining time.
_WINDOWS_FOR_ARMS = (
    (1.0, "a period"),
    (0.75, "three quarters of a period"),
    (0.5, "half a period"),
)
_COST_SAFETY_FACTOR = 1.6

Solve = Callable[[TrajectoryProblem], Solution]
Window = tuple[float, str]


def solve_shaped(
    run: SolveRun,
    compared: dict[str, Baseline],
    notes: tuple[str, ...],
    solve: Solve,
    windows: Sequence[Window] = _DEFAULT_WINDOWS,
) -> Solution:
    """Solve a problem whose objective is `shaped_deviation`.

    Its duration is fixed. `solve` raises nothing where no motion is found. Of the `windows`, in
    periods of the lowest mode with their names, the first one whose motion is no worse than the
    baselines is used, else the one of the best motion. Raises `ProblemError` where no time is left
    beside the shortest window.
    """
    problem, motion = run.problem, run.motion
    period = _lowest_mode_period(problem, motion)
    strict = strict_baseline(problem, motion, compared)
    rival = None if strict is None or not strict.feasible else strict.assessment
    clock = _TimedSolver(solve, time.perf_counter() + problem.method.time_limit)
    kept: tuple[Solution, tuple[Trajectory, Assessment] | None, str] | None = None
    for share, named in windows:
        window = share * period
        over = f"{1e3 * window:.0f} ms, {named}"
        inner = _shortened_problem(problem, motion, window)
        if inner is None:
            continue
        made, averaged = _solve_averaged(run, inner, window, clock.solve)
        stopped = made.status is SolveStatus.INTERRUPTED
        behind = averaged is not None and _rival_is_better(problem, rival, averaged[1])
        if kept is None or (
            (made.status.usable or not kept[0].status.usable)
            and (not behind or _is_better_shaped(problem, averaged, kept[1]))
        ):
            kept = made, averaged, over
        elif stopped:
            kept = mark_solution_interrupted(kept[0]), *kept[1:]
        if not behind or stopped or clock.left <= 0.0:
            break
    if kept is None:
        raise _too_short_error(problem, motion, window, named)
    found, shaped, over = kept
    solution = replace(
        found,
        baselines=compared,
        notes=(
            *dict.fromkeys((*notes, *found.notes)),
            f"Averaged over {over} of the arm's lowest mode.",
        ),
        inputs_hash=inputs_hash(problem),
        solver=replace(found.solver, exchanges=(*found.solver.exchanges, *run.exchanges)),
    )
    if shaped is None:
        return replace(solution, strict_baseline=None, ratio_to_strict_baseline=None)
    status, message = found.status, found.message
    if status.usable and strict is not None and _rival_is_better(problem, rival, shaped[1]):
        status = SolveStatus.ACCEPTABLE
        message = (
            f"{message} But the {strict.name} motion has a better objective and keeps all limits "
            "as well: allow a longer duration, or minimise tool_deviation."
        )
    trajectory, assessment = shaped
    if status.usable and not assessment.feasible(CERTIFICATE_TOLERANCE):
        status = SolveStatus.CERTIFICATE_FAILED
        message = (
            f"The shaped motion exceeds {assessment.worst_violation.describe()}. Allow a longer "
            "duration, or minimise tool_deviation."
        )
    value = objective_value(problem, assessment)
    better = better_baseline(problem, compared)
    return replace(
        solution,
        status=status,
        message=message,
        trajectory=trajectory,
        assessment=assessment,
        objective=value,
        ratio_to_better_baseline=_objective_ratio(problem, value.value, better),
        strict_baseline=strict,
        ratio_to_strict_baseline=_objective_ratio(problem, value.value, strict),
    )


def _is_better_shaped(
    problem: TrajectoryProblem,
    shaped: tuple[Trajectory, Assessment] | None,
    other: tuple[Trajectory, Assessment] | None,
) -> bool:
    """Return True if a shaped motion beats another one, or there is no other."""
    if shaped is None or other is None:
        return shaped is not None
    return _rival_is_better(problem, shaped[1], other[1])


def windows_for_arms(
    problem: TrajectoryProblem, motion: ResolvedMotion, price: float
) -> tuple[Window, ...]:
    """Return windows whose estimated cost is at most a share of the objective, widest first.

    The estimate scales the objective with the inverse square of the remaining duration.
    """
    period, duration = _lowest_mode_period(problem, motion), problem.duration[0]
    return tuple(
        (share, named)
        for share, named in _WINDOWS_FOR_ARMS
        if share * period < duration
        and _COST_SAFETY_FACTOR * ((1.0 - share * period / duration) ** -2 - 1.0) <= price
    )


@dataclass(frozen=True)
class _TimedSolver:
    """Solver with one time limit for several solves, which ends at an instant `end` [s]."""

    plain: Solve
    end: float

    @property
    def left(self) -> float:
        return self.end - time.perf_counter()

    def solve(self, problem: TrajectoryProblem) -> Solution:
        method = replace(problem.method, time_limit=max(self.left, MIN_SOLVE_TIME))
        return self.plain(replace(problem, method=method))


def mark_solution_interrupted(solution: Solution) -> Solution:
    """Return the solution with the status "interrupted"."""
    status = SolveStatus.INTERRUPTED
    return replace(solution, status=status, message=status.sentence)


def _solve_averaged(
    run: SolveRun,
    inner: TrajectoryProblem,
    window: float,
    solve: Solve,
) -> tuple[Solution, tuple[Trajectory, Assessment] | None]:
    """Solve the inner quasi-static problem and average its motion over a window [s]."""
    oracle = AveragedLimits(run, window, solve)
    end = exchange(run, oracle, oracle.solve(inner))
    found, shaped = end.solution, end.shaped
    if oracle.interrupted and found.status is not SolveStatus.INTERRUPTED:
        found = mark_solution_interrupted(found)
    if shaped is not None and not shaped[1].feasible(CERTIFICATE_TOLERANCE):
        # A wider smoothing of the motor law may remove an excess that back-off has not.
        shaped = _shape_motion(run.problem, found, window, kink_excess=CERTIFICATE_TOLERANCE)
    return found, shaped


@dataclass(frozen=True)
class ShapedMotion:
    """Inner problem with its solution, and the averaged motion with its certificate."""

    inner: TrajectoryProblem
    solution: Solution
    shaped: tuple[Trajectory, Assessment] | None


class AveragedLimits(Oracle[ShapedMotion]):
    """Limits of the averaged motion, from which the inner problem is backed off."""

    step = "input shaping"
    rounds = _MAX_BACK_OFF_ROUNDS
    explores = False

    def __init__(self, run: SolveRun, window: float, solve: Solve) -> None:
        self._problem, self._window, self._plain = run.problem, window, solve
        self._room = 0.0
        if run.problem.avoids_collisions:
            self._room = clearance_at_poses(run.problem, run.motion)
        self.interrupted = False

    def solve(self, inner: TrajectoryProblem) -> ShapedMotion:
        """Solve an inner problem and average its motion."""
        found = self._plain(inner)
        self.interrupted = found.status is SolveStatus.INTERRUPTED
        return ShapedMotion(inner, found, _shape_motion(self._problem, found, self._window))

    def propose(self, last: ShapedMotion, number: int) -> Proposal[ShapedMotion] | None:
        """Return the inner problem backed off; None without an excess, or after Ctrl-C."""
        if last.shaped is None or self.interrupted:
            return None
        # An excess that remains after two rounds is backed off by twice as much.
        more = _BACK_OFF_FACTOR if number < 2 else 2.0 * _BACK_OFF_FACTOR
        motion = last.shaped[1]
        tightened = _back_off_problem(self._problem, last.inner, motion, more, self._room)
        if tightened is None:
            return None

        def solve() -> ShapedMotion:
            tried = self.solve(tightened)
            if tried.solution.status.usable or self.interrupted:
                return tried
            # Backed off too far for any motion.
            return self.solve(_average_problems(last.inner, tightened))

        return Proposal(motion.worst_violation.describe(), solve)

    def accepts(self, found: ShapedMotion, best: ShapedMotion) -> bool:
        """Return True for a usable solution: each is backed off from the excess of the last."""
        return found.solution.status.usable


def _rival_is_better(problem: TrajectoryProblem, rival: Assessment | None, own: Assessment) -> bool:
    """Return True where the rival, which keeps every limit, is better or the motion does not."""
    if rival is None:
        return False
    if not own.feasible(CERTIFICATE_TOLERANCE):
        return True
    theirs, ours = (objective_value(problem, each).value for each in (rival, own))
    return theirs < (1.0 - CERTIFICATE_TOLERANCE) * ours


def _objective_ratio(
    problem: TrajectoryProblem, value: float, other: Baseline | None
) -> float | None:
    if other is None or other.objective is None:
        return None
    return improvement(problem, value, other.objective)


def _lowest_mode_period(problem: TrajectoryProblem, motion: ResolvedMotion) -> float:
    """Return the longest period of the lowest mode in the poses of a motion [s]."""
    arm = ElasticArm(problem.robot, motion.start, problem.process_force)
    lowest = [mode.frequency for pose in motion.points for mode in modes(arm, pose)[:1]]
    if not lowest:
        raise ProblemError("shaped_deviation needs an elastic joint: describe a drivetrain.")
    return 1.0 / min(lowest)


def _too_short_error(
    problem: TrajectoryProblem, motion: ResolvedMotion, window: float, named: str
) -> ProblemError:
    """Return the error of a duration too short for any window."""
    _, why = shortest_duration(problem, motion)
    return ProblemError(
        f"shaped_deviation takes {named} of the arm's lowest mode, {1e3 * window:.0f} ms, from "
        f"the duration of {problem.duration[0]:g} s, which leaves too little. {why} Allow a "
        "longer duration, or minimise tool_deviation."
    )


def _shortened_problem(
    problem: TrajectoryProblem, motion: ResolvedMotion, window: float
) -> TrajectoryProblem | None:
    """Return the quasi-static problem of the remaining duration; None where that is too short."""
    duration = problem.duration[0] - window
    needed, _ = shortest_duration(problem, motion)
    if duration <= needed:
        return None
    [term] = problem.objectives
    quasi_static = Objective(
        name="dynamic_deflection", measure=term.measure, accept_bound=term.accept_bound
    )
    limits = problem.active_limits
    lifted = {kind.name: np.inf for kind in limits.kinds if kind.of_arrival}
    return replace(
        problem,
        duration=(duration, duration),
        objectives=(quasi_static,),
        # Limits on residual vibration apply to the averaged motion.
        limits=Limits(limits.values, **lifted),
    )


def _shape_motion(
    problem: TrajectoryProblem, found: Solution, window: float, kink_excess: float = KINK_EXCESS
) -> tuple[Trajectory, Assessment] | None:
    """Return the motion of motors that lead the averaged links, and its certificate.

    The motor law is smoothed wider where a motor limit is exceeded by more than `kink_excess`.
    """
    if found.trajectory is None:
        return None

    def motor_excess(motors: Trajectory) -> float:
        return max(each.value for each in drive_violations(problem, motors))

    averaged, tried = AveragedMotion(found.trajectory, window), []
    law = MotorLaw(problem.robot, problem.process_force)
    for spacing in KNOT_SPACINGS:
        link = smooth_motion(averaged, spacing)
        motors = motors_with_sufficient_smoothing(
            functools.partial(law.motion, link), motor_excess, WINDUP_SMOOTHING[-1], kink_excess
        )
        tried.append((motors, with_collisions(problem, assess(problem, motors))))
        if tried[-1][1].feasible(CERTIFICATE_TOLERANCE):
            break
    return min(tried, key=lambda pair: max(pair[1].worst_violation.value, CERTIFICATE_TOLERANCE))


def _back_off_problem(
    problem: TrajectoryProblem,
    inner: TrajectoryProblem,
    assessment: Assessment,
    more: float,
    room: float,
) -> TrajectoryProblem | None:
    """Return the inner problem with limits and via tolerances backed off; None without an excess.

    The clearance is increased by the missing distance, up to the distance `room` [m] that the given
    poses allow.
    """
    excess = {
        each.limit: each.value
        for each in assessment.violations
        if each.value > CERTIFICATE_TOLERANCE
    }
    limits, vias = inner.active_limits, []
    near = [
        problem.stated_cell.clearance - each.distance
        for each in assessment.violations
        if each.distance is not None and each.value > CERTIFICATE_TOLERANCE
    ]
    cell = inner.cell
    wider = min(inner.stated_cell.clearance + more * max(near, default=0.0), room)
    if wider > inner.stated_cell.clearance:
        cell = replace(inner.stated_cell, clearance=wider)
    drawn = {
        name: getattr(limits, name) * max(1.0 - more * excess[name], _MIN_LIMIT_SHARE)
        for name in DRIVE_LIMITS
        if name in excess
    }
    missed = any(name.startswith("via_") for name in excess)
    if not drawn and not missed and cell is inner.cell:
        return None
    for number, (given, own) in enumerate(zip(problem.vias, inner.vias, strict=True), start=1):
        less = own.tolerance - more * excess.get(f"via_{number}", 0.0) * given.tolerance
        vias.append(replace(own, tolerance=max(less, _MIN_LIMIT_SHARE * given.tolerance)))
    return replace(inner, vias=tuple(vias), limits=Limits(limits.values, **drawn), cell=cell)


def _average_problems(loose: TrajectoryProblem, tight: TrajectoryProblem) -> TrajectoryProblem:
    """Return the tight problem with limits and tolerances midway between both."""
    before, after = loose.active_limits, tight.active_limits
    middle = {name: 0.5 * (getattr(before, name) + getattr(after, name)) for name in DRIVE_LIMITS}
    vias = tuple(
        replace(own, tolerance=0.5 * (own.tolerance + given.tolerance))
        for own, given in zip(tight.vias, loose.vias, strict=True)
    )
    return replace(tight, vias=vias, limits=Limits(after.values, **middle))
