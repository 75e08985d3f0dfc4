"""The worst violation of every limit along an assessed motion, each relative to its limit."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.certificate.rigid_body import tool_angle
from stiffopt.problem.limit import DriveLimit
from stiffopt.result.assessment import Assessment, DriveHistory, Violation

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import Target, TrajectoryProblem

# A motion that exceeds a limit by more than this share fails the certificate; a baseline that does
# is shown, never counted. Rows hold at nodes and midpoints only, so every motion exceeds its limits
# a little between them; this is below what a data sheet's two digits say of a limit, and far above
# rounding.
CERTIFICATE_TOLERANCE = 5e-3

# Share of a limit by which a boundary value may be missed.
_BOUNDARY_VALUE_TOLERANCE = 1e-3


def find_violations(problem: TrajectoryProblem, motion: Assessment) -> Assessment:
    """The assessment with its `violations` filled, worst first.

    Parameters
    ----------
    problem : TrajectoryProblem
        Its limits, targets and boundary values are read.
    motion : Assessment
    """
    limits = problem.active_limits
    found = [each for kind in limits.kinds for each in kind.violations(limits, motion)]
    found += _target_violations(problem, motion)
    found += _boundary_violations(problem, motion)
    found.sort(key=lambda violation: -violation.value)
    return replace(motion, violations=tuple(found))


def find_drive_violations(problem: TrajectoryProblem, drives: DriveHistory) -> list[Violation]:
    """Violations of the limits that drives have by themselves, worst first."""
    limits = problem.active_limits
    kinds = [kind for kind in limits.kinds if isinstance(kind, DriveLimit)]
    found = [each for kind in kinds for each in kind.violations(limits, drives)]
    return sorted(found, key=lambda violation: -violation.value)


def _target_violations(problem: TrajectoryProblem, motion: Assessment) -> list[Violation]:
    """How far start, end and vias are missed, relative to their tolerance; vias in order."""
    found = []
    last = len(motion.time) - 1
    stops = [("start", problem.start, 0), ("end", problem.end, last)]
    first = 0
    for number, via in enumerate(problem.vias, start=1):
        first += int(np.argmin(_relative_target_miss(problem, via, motion, slice(first, None))))
        stops.append((f"via_{number}", via, first))
    for name, target, k in stops:
        miss = _relative_target_miss(problem, target, motion, slice(k, k + 1))[0]
        found.append(Violation(float(miss - 1.0), name, None, float(motion.time[k])))
    return found


def _boundary_violations(problem: TrajectoryProblem, motion: Assessment) -> list[Violation]:
    """Start and end velocities and accelerations against the given ones, at 1e-3 of the limits."""
    limits, n = problem.active_limits, motion.position.shape[1]
    zero = np.zeros(n)
    velocities = problem.boundary_velocity or (zero, zero)
    found = []
    for side, k, velocity in (("start", 0, velocities[0]), ("end", -1, velocities[1])):
        rows = [("velocity", motion.velocity[k] - velocity, limits.velocity)]
        if problem.boundary_acceleration == "zero":
            rows.append(("acceleration", motion.acceleration[k], limits.acceleration))
        for name, miss, limit in rows:
            typical = np.where(np.isfinite(limit), limit, np.max(np.abs(getattr(motion, name))))
            share = np.abs(miss) / (_BOUNDARY_VALUE_TOLERANCE * np.maximum(typical, 1e-9))
            j = int(np.argmax(share))
            time = float(motion.time[k])
            found.append(Violation(float(share[j] - 1.0), f"{side}_{name}", j + 1, time))
    return found


def _relative_target_miss(
    problem: TrajectoryProblem, target: Target, motion: Assessment, instants: slice
) -> np.ndarray:
    """Miss of a target at some instants, relative to its tolerance; of a pose the worse of two."""
    place = _target_distance(target, motion, instants) / target.tolerance
    if target.rpy is None:
        return np.asarray(place)
    turn = tool_angle(problem.robot, motion.position[instants], target.rpy)
    return np.asarray(np.maximum(place, turn / target.angle_tolerance))


def _target_distance(target: Target, motion: Assessment, instants: slice) -> np.ndarray:
    """Distance to a target at some instants: [m] of the tool, or the largest joint angle [rad]."""
    if target.joints is not None:
        away = np.abs(motion.position[instants] - target.joints)
        return np.asarray(np.max(away, axis=1))
    return np.asarray(np.linalg.norm(motion.tool[instants] - target.position, axis=1))
