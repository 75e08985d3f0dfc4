"""Motions shaped to the arm's lowest mode: they ring little also where the arm is not as modelled.

The quasi-static optimum is found for a duration that is shorter by a swing of the lowest mode, and
averaged over such a swing (a box filter, whose spectrum is zero at that frequency). An average
keeps every bound on position and its derivatives; it cuts vias, which are drawn tighter by as much,
and so are limits that the motors exceed in leading the links. That lead by the wind-up lets nothing
ring on the arm as modelled; what an error of the model leaves is the wind-up's share in it, which
the filter has made slow.

Source: Singer, Seering (1990), "Preshaping command inputs to reduce system vibration".
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from stiffopt.baseline.baselines import better_baseline, strict_baseline
from stiffopt.certificate.assess import assess, drive_violations
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.objective_value import improvement, objective_value
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.elastic.smooth_motion import smooth_motion
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
from stiffopt.result.trajectory import JointMotion, Trajectory
from stiffopt.solver.corners import widened
from stiffopt.solver.solve_run import LEAST_TIME

# Of the knots of the splines that round off the averaged motion [s]; the first that holds is taken.
_SPACINGS = (0.005, 0.01, 0.02, 0.04)
# Of the table that is averaged; how often vias and limits are drawn tighter, and how far at most.
_SAMPLES = 8001
_ROUNDS = 5
_TIGHTEST = 0.1
_DRAWN = ("velocity", "acceleration", "jerk", "torque")
_MORE = 1.1
# Over which is averaged, in swings: where a baseline that keeps all limits is better, a whole swing
# leaves too little of the time for the motion.
_WINDOWS = ((1.0, "a swing"), (0.5, "half a swing"), (0.25, "a quarter of a swing"))
# Over which is averaged for uncertain arms, and what it costs over the least peak of the time left.
_FOR_ARMS = ((1.0, "a swing"), (0.75, "three quarters of a swing"), (0.5, "half a swing"))
_COSTS_MORE = 1.6
# A larger excess of the motors is a corner of a joint's stiffness passed fast.
_CORNER = 0.25

Solve = Callable[[TrajectoryProblem], Solution]
Window = tuple[float, str]


def solve_shaped(
    problem: TrajectoryProblem,
    motion: ResolvedMotion,
    beside: dict[str, Baseline],
    notes: tuple[str, ...],
    solve: Solve,
    windows: Sequence[Window] = _WINDOWS,
) -> Solution:
    """Solve a problem whose objective is `shaped_deviation`.

    Parameters
    ----------
    problem : TrajectoryProblem
        Of fixed duration.
    motion : ResolvedMotion
    beside : dict
        Its baselines.
    notes : tuple of str
    solve : callable
        Solves a problem without raising where no motion is found.
    windows : sequence of (float, str), optional
        Shares of a swing over which is averaged, and their names: the first that is no worse than
        the baselines is taken.

    Raises
    ------
    ProblemError
        No time is left beside the shortest window.
    """
    swing = _swing(problem, motion)
    strict = strict_baseline(problem, motion, beside)
    rival = None if strict is None or not strict.feasible else strict.assessment
    clock = _Clock(solve, time.perf_counter() + problem.method.time_limit)
    kept: tuple[Solution, tuple[Trajectory, Assessment] | None, str] | None = None
    for share, named in windows:
        window = share * swing
        over = f"{1e3 * window:.0f} ms, {named}"
        inner = _shorter(problem, motion, window)
        if inner is None:
            continue
        made, averaged = _averaged(problem, motion, inner, window, clock.solve)
        stopped = made.status is SolveStatus.INTERRUPTED
        behind = averaged is not None and _is_better(problem, rival, averaged[1])
        if kept is None or (not behind and (made.status.usable or not kept[0].status.usable)):
            kept = made, averaged, over
        elif stopped:
            kept = interrupted(kept[0]), *kept[1:]
        if not behind or stopped or clock.left <= 0.0:
            break
    if kept is None:
        raise _too_little(problem, motion, window, named)
    found, shaped, over = kept
    solution = replace(
        found,
        baselines=beside,
        notes=(
            *dict.fromkeys((*notes, *found.notes)),
            f"Averaged over {over} of the arm's lowest mode.",
        ),
        inputs_hash=inputs_hash(problem),
    )
    if shaped is None:
        return replace(solution, strict_baseline=None, ratio_to_strict_baseline=None)
    status, message = found.status, found.message
    if status.usable and strict is not None and _is_better(problem, rival, shaped[1]):
        status = SolveStatus.ACCEPTABLE
        message = (
            f"{message} But the {strict.name} motion beside it is better and keeps all limits as "
            "well: run that one, give a longer duration, or minimise tool_deviation."
        )
    trajectory, assessment = shaped
    if status.usable and not assessment.feasible(CERTIFIED):
        status = SolveStatus.CERTIFICATE_FAILED
        message = (
            f"The shaped motion exceeds {assessment.worst_violation.describe()}. Give a longer "
            "duration, or minimise tool_deviation."
        )
    value = objective_value(problem, assessment)
    better = better_baseline(problem, beside)
    return replace(
        solution,
        status=status,
        message=message,
        trajectory=trajectory,
        assessment=assessment,
        objective=value,
        ratio_to_better_baseline=_ratio(problem, value.value, better),
        strict_baseline=strict,
        ratio_to_strict_baseline=_ratio(problem, value.value, strict),
    )


def windows_for_arms(
    problem: TrajectoryProblem, motion: ResolvedMotion, price: float
) -> tuple[Window, ...]:
    """Windows that are likely to cost no more than a share of the objective, the widest first.

    What is left of the duration asks for accelerations that are higher by its square.
    """
    swing, duration = _swing(problem, motion), problem.duration[0]
    return tuple(
        (share, named)
        for share, named in _FOR_ARMS
        if share * swing < duration
        and _COSTS_MORE * ((1.0 - share * swing / duration) ** -2 - 1.0) <= price
    )


@dataclass(frozen=True)
class _Clock:
    """Solves that have one time limit together, which ends at an instant `end` [s]."""

    plain: Solve
    end: float

    @property
    def left(self) -> float:
        return self.end - time.perf_counter()

    def solve(self, problem: TrajectoryProblem) -> Solution:
        method = replace(problem.method, time_limit=max(self.left, LEAST_TIME))
        return self.plain(replace(problem, method=method))


def interrupted(solution: Solution) -> Solution:
    """What was found before Ctrl-C, said to be all there is."""
    status = SolveStatus.INTERRUPTED
    return replace(solution, status=status, message=status.sentence)


def _averaged(
    problem: TrajectoryProblem,
    motion: ResolvedMotion,
    inner: TrajectoryProblem,
    window: float,
    solve: Solve,
) -> tuple[Solution, tuple[Trajectory, Assessment] | None]:
    """The solution of the inner quasi-static problem, and its motion averaged over a window [s]."""
    found = solve(inner)
    room = clearance_at_poses(problem, motion) if problem.avoids_collisions else 0.0
    shaped = _shaped(problem, found, window)
    for number in range(_ROUNDS):
        # What is left after two rounds is drawn in by twice as much.
        more = _MORE if number < 2 else 2.0 * _MORE
        tightened = None if shaped is None else _tightened(problem, inner, shaped[1], more, room)
        if tightened is None or found.status is SolveStatus.INTERRUPTED:
            break
        tried = solve(tightened)
        if not tried.status.usable and tried.status is not SolveStatus.INTERRUPTED:
            # Drawn too tight for any motion.
            tightened = _halfway(inner, tightened)
            tried = solve(tightened)
        if tried.status is SolveStatus.INTERRUPTED:
            found = interrupted(found)
        if not tried.status.usable:
            break
        inner, found = tightened, tried
        shaped = _shaped(problem, found, window)
    if shaped is not None and not shaped[1].feasible(CERTIFIED):
        # What drawing limits tighter has left of corners, wider ones may take.
        shaped = _shaped(problem, found, window, corner=CERTIFIED)
    return found, shaped


def _is_better(problem: TrajectoryProblem, rival: Assessment | None, own: Assessment) -> bool:
    """Whether a rival that keeps every limit is better than a motion, or that keeps them not."""
    if rival is None:
        return False
    if not own.feasible(CERTIFIED):
        return True
    theirs, ours = (objective_value(problem, each).value for each in (rival, own))
    return theirs < (1.0 - CERTIFIED) * ours


def _ratio(problem: TrajectoryProblem, value: float, other: Baseline | None) -> float | None:
    if other is None or other.objective is None:
        return None
    return improvement(problem, value, other.objective)


def _swing(problem: TrajectoryProblem, motion: ResolvedMotion) -> float:
    """Period of the lowest mode in the poses of a motion [s]."""
    arm = ElasticArm(problem.robot, motion.start, problem.process_force)
    lowest = [mode.frequency for pose in motion.points for mode in modes(arm, pose)[:1]]
    if not lowest:
        raise ProblemError("shaped_deviation needs a joint that yields: describe a drivetrain.")
    return 1.0 / min(lowest)


def _too_little(
    problem: TrajectoryProblem, motion: ResolvedMotion, window: float, named: str
) -> ProblemError:
    """What to do where the duration leaves too little beside any window."""
    _, why = shortest_duration(problem, motion)
    return ProblemError(
        f"shaped_deviation takes {named} of the arm's lowest mode, {1e3 * window:.0f} ms, from "
        f"the duration of {problem.duration[0]:g} s, which leaves too little. {why} Give a "
        "longer duration, or minimise tool_deviation."
    )


def _shorter(
    problem: TrajectoryProblem, motion: ResolvedMotion, window: float
) -> TrajectoryProblem | None:
    """The quasi-static problem whose motion is averaged; None where too little time is left."""
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
        # What swings on is that of the averaged motion.
        limits=Limits(limits.values, **lifted),
    )


def _shaped(
    problem: TrajectoryProblem, found: Solution, swing: float, corner: float = _CORNER
) -> tuple[Trajectory, Assessment] | None:
    """Motion of the motors that lead the averaged links, and its certificate.

    What exceeds a limit of the motors by more than `corner` is taken for a corner of their law.
    """
    if found.trajectory is None:
        return None

    def motor_excess(motors: Trajectory) -> float:
        return max(each.value for each in drive_violations(problem, motors))

    averaged, tried = Averaged(found.trajectory, swing), []
    law = MotorLaw(problem.robot, problem.process_force)
    for spacing in _SPACINGS:
        link = smooth_motion(averaged, spacing)
        motors = widened(
            functools.partial(law.motion, link), motor_excess, WINDUP_SMOOTHING[-1], corner
        )
        tried.append((motors, with_collisions(problem, assess(problem, motors))))
        if tried[-1][1].feasible(CERTIFIED):
            break
    return min(tried, key=lambda pair: max(pair[1].worst_violation.value, CERTIFIED))


def _tightened(
    problem: TrajectoryProblem,
    inner: TrajectoryProblem,
    assessment: Assessment,
    more: float,
    room: float,
) -> TrajectoryProblem | None:
    """The inner problem drawn tighter by what vias are missed and limits exceeded by, if any are.

    What an average brings nearer to something is kept further from it before, as far as the given
    poses leave `room` [m].

    Motors that lead the links have a little more acceleration than these.
    """
    excess = {each.limit: each.value for each in assessment.violations if each.value > CERTIFIED}
    limits, vias = inner.active_limits, []
    near = [
        problem.stated_cell.clearance - each.distance
        for each in assessment.violations
        if each.distance is not None and each.value > CERTIFIED
    ]
    cell = inner.cell
    wider = min(inner.stated_cell.clearance + more * max(near, default=0.0), room)
    if wider > inner.stated_cell.clearance:
        cell = replace(inner.stated_cell, clearance=wider)
    drawn = {
        name: getattr(limits, name) * max(1.0 - more * excess[name], _TIGHTEST)
        for name in _DRAWN
        if name in excess
    }
    missed = any(name.startswith("via_") for name in excess)
    if not drawn and not missed and cell is inner.cell:
        return None
    for number, (given, own) in enumerate(zip(problem.vias, inner.vias, strict=True), start=1):
        less = own.tolerance - more * excess.get(f"via_{number}", 0.0) * given.tolerance
        vias.append(replace(own, tolerance=max(less, _TIGHTEST * given.tolerance)))
    return replace(inner, vias=tuple(vias), limits=Limits(limits.values, **drawn), cell=cell)


def _halfway(loose: TrajectoryProblem, tight: TrajectoryProblem) -> TrajectoryProblem:
    """The tight problem with limits and tolerances in the middle between both."""
    before, after = loose.active_limits, tight.active_limits
    middle = {name: 0.5 * (getattr(before, name) + getattr(after, name)) for name in _DRAWN}
    vias = tuple(
        replace(own, tolerance=0.5 * (own.tolerance + given.tolerance))
        for own, given in zip(tight.vias, loose.vias, strict=True)
    )
    return replace(tight, vias=vias, limits=Limits(after.values, **middle))


@dataclass(frozen=True, eq=False)
class Averaged:
    """A motion averaged over the time before each instant; it lasts so much longer.

    Parameters
    ----------
    motion : JointMotion
    swing : float
        Over which is averaged [s].
    """

    motion: JointMotion
    swing: float

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.motion.duration + self.swing

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Positions (K, n) at the times (K,); derivatives are not needed of it."""
        if order:
            raise ValueError("only the position of an averaged motion is known")
        travelled = self._travel(t) - self._travel(np.asarray(t) - self.swing)
        return np.asarray(travelled / self.swing)

    def _travel(self, t: np.ndarray) -> np.ndarray:
        """Integral of the position from the start (K, n), at rest outside the motion."""
        end = self.motion.duration
        times = np.linspace(0.0, end, _SAMPLES)
        position = self.motion(times)
        whole = CubicHermiteSpline(times, position, self.motion(times, 1)).antiderivative()
        outside = np.minimum(t, 0.0)[:, None] * position[0]
        outside += np.maximum(np.asarray(t) - end, 0.0)[:, None] * position[-1]
        return np.asarray(whole(np.clip(t, 0.0, end)) + outside)
