"""Baselines: motions to compare an optimised one with, assessed by the same certificate."""

from __future__ import annotations

import numpy as np

from stiffopt.baseline.rivals import FairRival, baseline_path, fair_rivals, quintic_law
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


def baselines(problem: TrajectoryProblem, motion: ResolvedMotion) -> dict[str, Baseline]:
    """Return toppra's and the quintic motion on the joint path through the poses.

    Where the duration is free, toppra's motion keeps its own (shortest) duration, and the quintic
    motion takes the shortest duration that toppra found, within the allowed range.
    """
    path = baseline_path(problem, motion)
    if path.stops.size:
        reason = f"The path has {path.stops.size} stops, at which it would not rest."
        return {
            name: _assess_baseline(problem, BaselineMotion(name=name, motion=None, reason=reason))
            for name in ("toppra", "quintic")
        }
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
        "toppra": _assess_baseline(problem, fastest),
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
    return _assess_baseline(problem, BaselineMotion(name="detour", motion=motion))


def slowed_quintic(problem: TrajectoryProblem, motion: ResolvedMotion) -> Assessment | None:
    """Return the fastest quintic motion that meets all limits, see `FairRival.fastest`."""
    path = baseline_path(problem, motion)
    rival = FairRival(problem, path, "quintic", quintic_law(1.0))
    return rival.fastest(problem.duration[0])


def strict_baseline(
    problem: TrajectoryProblem, motion: ResolvedMotion, compared: dict[str, Baseline]
) -> Baseline | None:
    """Return the best baseline that meets every limit.

    Where none does, the best fair rival, slowed until it does, which may take longer than the
    problem allows (`feasible` is False then); None where even that exceeds a limit.
    """
    best = better_baseline(problem, compared)
    if best is not None or not problem.rests_at_both_ends:
        return best
    shortest, longest = problem.duration
    slowed, durations = {}, {}
    for rival, found in fair_rivals(problem, motion, shortest):
        allowed = found.duration <= longest * (1.0 + 1e-9)
        durations[rival.name] = found.duration
        slowed[rival.name] = Baseline(
            name=f"slowed {rival.name}" if found.duration > shortest * (1.0 + 1e-9) else rival.name,
            assessment=found,
            objective=objective_value(problem, found).value,
            feasible=allowed,
            reason="" if allowed else f"Keeps every limit, but takes {found.duration:.3g} s.",
        )
    quickest = min(durations, key=lambda name: durations[name], default=None)
    return better_baseline(problem, slowed) or (None if quickest is None else slowed[quickest])


def better_baseline(problem: TrajectoryProblem, compared: dict[str, Baseline]) -> Baseline | None:
    """Return the feasible baseline with the better objective, None if neither is feasible."""
    feasible = [b for b in compared.values() if b.feasible and b.objective is not None]
    sign = -1.0 if is_maximised(problem) else 1.0
    return min(feasible, key=lambda b: sign * (b.objective or 0.0), default=None)


def _assess_baseline(problem: TrajectoryProblem, baseline: BaselineMotion) -> Baseline:
    """Certify a baseline."""
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
    reason = f"Exceeds {exceeded[0].describe()}." if exceeded else ""
    if not problem.rests_at_both_ends:
        reason = "It goes from rest to rest, not between the given boundary velocities."
    return Baseline(
        name=baseline.name,
        assessment=assessment,
        objective=objective_value(problem, assessment).value,
        feasible=not exceeded and problem.rests_at_both_ends,
        reason=reason,
        trajectory=baseline.motion,
    )


def quintic_motion(problem: TrajectoryProblem, motion: ResolvedMotion) -> Trajectory:
    """Return the quintic motion at the least duration that the problem allows, limits aside."""
    return baseline_path(problem, motion).follow(quintic_law(problem.duration[0]))
