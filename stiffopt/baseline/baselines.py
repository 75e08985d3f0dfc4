"""Baselines: motions to compare an optimised one with, assessed by the same certificate."""

from __future__ import annotations

import numpy as np

from stiffopt.baseline.toppra_motion import BaselineMotion, toppra_baseline
from stiffopt.certificate.assess import assess
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.objective_value import is_maximised, objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.joint_path import JointPath
from stiffopt.result.solution import Baseline
from stiffopt.result.trajectory import Trajectory

# Limits that are not linear in path acceleration and squared path speed: toppra ignores them.
_LIMITS_BEYOND_TOPPRA = ("jerk", "start_acceleration", "end_acceleration")
# Certificate samples per trial duration in the search of `slowed_quintic`.
_SLOWED_MOTION_SAMPLES = 301


def baselines(problem: TrajectoryProblem, motion: ResolvedMotion) -> dict[str, Baseline]:
    """Return toppra's and the quintic motion on the joint path through the poses.

    Where the duration is free, toppra's motion keeps its own (shortest) duration, and the quintic
    motion takes the shortest duration that toppra found, within the allowed range.
    """
    path = _baseline_path(problem, motion)
    fixed = problem.duration[0] == problem.duration[1]
    duration = problem.duration[0] if fixed else None
    fastest = toppra_baseline(
        problem.robot,
        problem.active_limits,
        path,
        duration,
        problem.process_force,
        eased=problem.boundary_acceleration == "zero",
    )
    if duration is None:
        duration = float(np.clip(fastest.fastest or 1.0, *problem.duration))
        if fastest.motion is not None and fastest.motion.duration < duration:
            stretched = fastest.motion.scaled_to(duration)
            fastest = BaselineMotion(name="toppra", motion=stretched, fastest=fastest.fastest)
    quintic = BaselineMotion(name="quintic", motion=path.follow(quintic_law(duration)))
    return {
        "toppra": _assess_baseline(problem, fastest, ignored=_LIMITS_BEYOND_TOPPRA),
        "quintic": _assess_baseline(problem, quintic),
    }


def detour_baseline(problem: TrajectoryProblem, path: JointPath) -> Baseline:
    """Return toppra's motion along a collision-free path, within the allowed duration.

    The quintic motion on that path where toppra finds no time law.
    """
    shortest, longest = problem.duration
    fixed = shortest if shortest == longest else None
    quick = toppra_baseline(
        problem.robot,
        problem.active_limits,
        path,
        fixed,
        problem.process_force,
        intervals=200,
        eased=problem.boundary_acceleration == "zero",
    )
    motion = quick.motion
    if motion is None:
        motion = path.follow(quintic_law(float(np.clip(quick.fastest or 1.0, shortest, longest))))
    elif not shortest <= motion.duration <= longest:
        motion = motion.scaled_to(float(np.clip(motion.duration, shortest, longest)))
    return _assess_baseline(
        problem, BaselineMotion(name="detour", motion=motion), ignored=_LIMITS_BEYOND_TOPPRA
    )


def slowed_quintic(problem: TrajectoryProblem, motion: ResolvedMotion) -> Assessment | None:
    """Return the quintic motion at the shortest duration that meets all limits, within 0.2 %.

    None where ten times the duration of the problem does not suffice.
    """
    path = _baseline_path(problem, motion)
    low = problem.duration[0]

    def excess(duration: float, points: int) -> float:
        slowed = path.follow(quintic_law(duration))
        times = np.linspace(0.0, duration, points)
        return assess(problem, slowed, times=times).worst_violation.value

    high = 10.0 * low
    if low <= 0.0 or excess(high, _SLOWED_MOTION_SAMPLES) > CERTIFICATE_TOLERANCE:
        return None
    while high - low > 1e-3 * low:
        middle = 0.5 * (low + high) if high > 2.0 * low else float(np.sqrt(low * high))
        low, high = (
            (low, middle)
            if excess(middle, _SLOWED_MOTION_SAMPLES) <= CERTIFICATE_TOLERANCE
            else (middle, high)
        )
    # 0.1 % longer: limits may be exceeded slightly between the samples of the search.
    assessment = with_collisions(problem, assess(problem, path.follow(quintic_law(1.001 * high))))
    return assessment if assessment.feasible(CERTIFICATE_TOLERANCE) else None


def strict_baseline(
    problem: TrajectoryProblem, motion: ResolvedMotion, compared: dict[str, Baseline]
) -> Baseline | None:
    """Return the best baseline that meets every limit, also those its method cannot handle.

    Where none does, the quintic motion slowed until it does, which may take longer than the
    problem allows (`feasible` is False then); None where even that exceeds a limit.
    """
    kept = {
        name: b
        for name, b in compared.items()
        if b.feasible and b.assessment is not None and b.assessment.feasible(CERTIFICATE_TOLERANCE)
    }
    best = better_baseline(problem, kept)
    if best is not None or (
        problem.boundary_velocity is not None and np.any(problem.boundary_velocity)
    ):
        return best
    slowed = slowed_quintic(problem, motion)
    if slowed is None:
        return None
    shortest, longest = problem.duration
    allowed = shortest <= slowed.duration <= longest
    return Baseline(
        name="slowed quintic",
        assessment=slowed,
        objective=objective_value(problem, slowed).value,
        feasible=allowed,
        reason="" if allowed else f"Keeps every limit, but takes {slowed.duration:.3g} s.",
    )


def better_baseline(problem: TrajectoryProblem, compared: dict[str, Baseline]) -> Baseline | None:
    """Return the feasible baseline with the better objective, None if neither is feasible."""
    feasible = [b for b in compared.values() if b.feasible and b.objective is not None]
    sign = -1.0 if is_maximised(problem) else 1.0
    return min(feasible, key=lambda b: sign * (b.objective or 0.0), default=None)


def _baseline_path(problem: TrajectoryProblem, motion: ResolvedMotion) -> JointPath:
    if problem.path is None:
        # Chord parametrisation: with equal steps a spline through uneven vias overshoots.
        return JointPath.through(motion.points, "chord")
    return JointPath.through(problem.path)


def _assess_baseline(
    problem: TrajectoryProblem, baseline: BaselineMotion, ignored: tuple[str, ...] = ()
) -> Baseline:
    """Certify a baseline; limits in `ignored` are reported but do not make it infeasible."""
    if baseline.motion is None:
        return Baseline(
            name=baseline.name,
            assessment=None,
            objective=None,
            feasible=False,
            reason=baseline.reason,
        )
    assessment = with_collisions(problem, assess(problem, baseline.motion))
    exceeded = [v for v in assessment.violations if v.value > CERTIFICATE_TOLERANCE]
    counted = [v for v in exceeded if v.limit not in ignored]
    reason = f"Exceeds {counted[0].describe()}." if counted else ""
    moving = problem.boundary_velocity is not None and np.any(problem.boundary_velocity)
    if moving:
        reason = "It goes from rest to rest, not between the given boundary velocities."
    elif exceeded and not counted:
        names = ", ".join(dict.fromkeys(v.limit for v in exceeded))
        reason = f"It exceeds the limit on {names}, which its method cannot handle."
    return Baseline(
        name=baseline.name,
        assessment=assessment,
        objective=objective_value(problem, assessment).value,
        feasible=not counted and not moving,
        reason=reason,
        trajectory=baseline.motion,
    )


def quintic_motion(problem: TrajectoryProblem, motion: ResolvedMotion) -> Trajectory:
    """Return the quintic motion at the least duration that the problem allows, limits aside."""
    return _baseline_path(problem, motion).follow(quintic_law(problem.duration[0]))


def quintic_law(duration: float) -> Trajectory:
    """Return the time law s(t) = 10 x^3 - 15 x^4 + 6 x^5, x = t/duration.

    Velocity and acceleration vanish at both ends. Peak velocity 15/8 divided by the duration, peak
    acceleration 10/sqrt(3) divided by its square.
    """
    t = duration
    acceleration = [[[0.0], [60.0 / t**3], [-180.0 / t**4], [120.0 / t**5]]]
    return Trajectory.from_acceleration([0.0, t], acceleration, [0.0], [0.0])
