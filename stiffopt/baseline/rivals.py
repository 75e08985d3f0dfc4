"""Fair rivals: quintic, S-curve and toppra's motion on the path, each within every limit.

Each has the duration asked for, or is slowed until it keeps all limits; none is excused from one.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from ruckig import InputParameter, Result, Ruckig
from ruckig import Trajectory as RuckigTrajectory

from stiffopt.baseline.toppra_motion import toppra_baseline
from stiffopt.certificate.assess import assess
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.problem.bounds import shortest_duration
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.joint_path import JointPath
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.trajectory import Trajectory

# Certificate samples per trial duration in the search of the shortest one.
_TRIAL_SAMPLES = 301
# Knots of the spline that smooths a time law whose acceleration jumps.
_SMOOTHING_INTERVALS = 40
_MAX_SLOWDOWN = 10.0
_DURATION_RESOLUTION = 1e-3  # relative
# Samples at which an S-curve's limits on the path are taken.
_PATH_SAMPLES = 201
_UNLIMITED_RATE = 1e9  # speed of the path parameter [1/s]
# Rivals of the last problem and duration.
_last_rivals: dict[tuple[str, float], tuple[tuple[FairRival, Assessment], ...]] = {}


class FairRival:
    """Motion by one time law along the path, at any duration.

    `law`: path parameter over time; durations scale it.
    """

    def __init__(
        self, problem: TrajectoryProblem, path: JointPath, name: str, law: Trajectory
    ) -> None:
        self._problem, self._path, self.name, self._law = problem, path, name, law

    @cached_property
    def smoothed(self) -> FairRival:
        """The rival with continuous jerk."""
        spacing = self._law.duration / _SMOOTHING_INTERVALS
        law = smooth_motion(self._law, spacing)
        return FairRival(self._problem, self._path, self.name, law)

    def at(self, duration: float) -> Trajectory:
        """Return the motion of a duration [s]."""
        return self._path.follow(self._law.scaled_to(duration))

    def fastest(self, shortest: float) -> Assessment | None:
        """Return the fastest motion of at least `shortest` [s] that keeps every limit, in 0.2 %.

        None where ten times that does not suffice.
        """
        low, high = shortest, _MAX_SLOWDOWN * shortest
        if low <= 0.0:
            return None
        if (found := self._certified(low)) is not None:
            return found
        if self._excess(high) > CERTIFICATE_TOLERANCE:
            return None
        while high - low > _DURATION_RESOLUTION * low:
            middle = 0.5 * (low + high) if high > 2.0 * low else float(np.sqrt(low * high))
            kept = self._excess(middle) <= CERTIFICATE_TOLERANCE
            low, high = (low, middle) if kept else (middle, high)
        # Limits may be exceeded slightly between the samples of the search.
        return self._certified((1.0 + _DURATION_RESOLUTION) * high)

    def _certified(self, duration: float) -> Assessment | None:
        if self._excess(duration) > CERTIFICATE_TOLERANCE:
            return None
        found = assess(self._problem, self.at(duration))
        if not found.feasible(CERTIFICATE_TOLERANCE):
            return None
        found = with_collisions(self._problem, found)
        return found if found.feasible(CERTIFICATE_TOLERANCE) else None

    def _excess(self, duration: float) -> float:
        times = np.linspace(0.0, duration, _TRIAL_SAMPLES)
        found = assess(self._problem, self.at(duration), times=times).violations
        # Vias lie on the path, but between the samples.
        return max(each.value for each in found if not each.limit.startswith("via_"))


def fair_rivals(
    problem: TrajectoryProblem, motion: ResolvedMotion, shortest: float
) -> tuple[tuple[FairRival, Assessment], ...]:
    """Rivals that keep every limit, each as fast as that allows from `shortest` [s] on.

    Those of the last inputs are kept: comparison, simulation and report of a solve ask for them.
    """
    key = inputs_hash(problem), shortest
    if key not in _last_rivals:
        found = tuple(_search_rivals(problem, motion, shortest))
        _last_rivals.clear()
        _last_rivals[key] = found
    return _last_rivals[key]


def _search_rivals(
    problem: TrajectoryProblem, motion: ResolvedMotion, shortest: float
) -> Iterator[tuple[FairRival, Assessment]]:
    """Yield the rivals of `fair_rivals`."""
    if not problem.rests_at_both_ends:
        return
    # The search for the fastest one begins where a motion may exist.
    shortest = max(shortest, shortest_duration(problem, motion)[0])
    path = baseline_path(problem, motion)
    if path.stops.size:
        return
    laws = {"quintic": quintic_law(1.0), "S-curve": s_curve_law(problem, path, shortest)}
    quick = toppra_baseline(
        problem.robot,
        problem.active_limits,
        path,
        None,
        problem.process_force,
        intervals=200,
        eased=problem.boundary_acceleration == "zero",
    )
    if quick.law is not None:
        laws["toppra"] = quick.law
    for name, law in laws.items():
        if law is None:
            continue
        rival = FairRival(problem, path, name, law)
        for each in (rival, rival.smoothed):
            found = each.fastest(shortest)
            if found is not None:
                yield each, found
                break


def baseline_path(problem: TrajectoryProblem, motion: ResolvedMotion) -> JointPath:
    """Return the joint path of baselines: the problem's, else a spline through its poses."""
    if problem.path is None:
        # Chord parametrisation: with equal steps a spline through uneven vias overshoots.
        return JointPath.through(motion.points, "chord")
    return problem.path


def quintic_law(duration: float) -> Trajectory:
    """Return s(t) = 10 x^3 - 15 x^4 + 6 x^5, x = t/duration, at rest at both ends."""
    t = duration
    acceleration = [[[0.0], [60.0 / t**3], [-180.0 / t**4], [120.0 / t**5]]]
    return Trajectory.from_acceleration([0.0, t], acceleration, [0.0], [0.0])


def s_curve_law(problem: TrajectoryProblem, path: JointPath, duration: float) -> Trajectory | None:
    """Return the fastest jerk-limited time law of the path, from rest to rest; None without one.

    Limits of the path parameter are those at which no joint exceeds its own on a straight path.
    Without a limit of the jerk it has the least peak jerk of the duration.

    Source: Berscheid, Kroeger (2021), "Jerk-limited real-time trajectory generation with arbitrary
    target states", Robotics: Science and Systems.
    """
    slope = np.abs(path(np.linspace(0.0, 1.0, _PATH_SAMPLES), 1)).max(axis=0)
    limits = problem.active_limits
    with np.errstate(divide="ignore", invalid="ignore"):
        speed, acceleration, jerk = (
            float(np.nanmin(np.where(slope > 0.0, limit / slope, np.inf)))
            for limit in (limits.velocity, limits.acceleration, limits.jerk)
        )
    least_jerk = 32.0 / duration**3
    asked = InputParameter(1)
    asked.current_position, asked.target_position = [0.0], [1.0]
    asked.max_velocity = [min(speed, _UNLIMITED_RATE)]
    asked.max_acceleration = [min(acceleration, _UNLIMITED_RATE)]
    asked.max_jerk = [jerk if np.isfinite(jerk) else least_jerk]
    found = RuckigTrajectory(1)
    if Ruckig(1).calculate(asked, found) not in (Result.Working, Result.Finished):
        return None
    profile = found.profiles[0][0]
    lasted = np.array(profile.t)
    moving = lasted > 1e-12 * found.duration
    rates = np.stack([np.array(profile.a)[:-1], np.array(profile.j)], axis=1)[moving]
    times = np.concatenate([[0.0], np.cumsum(lasted[moving])])
    return Trajectory.from_acceleration(times, rates[..., None], [0.0], [0.0])
