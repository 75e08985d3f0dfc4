"""The worst violation of every limit along an assessed motion, each relative to its limit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from stiffopt.certificate.rigid_body import tool_angle
from stiffopt.result.assessment import Assessment, Violation

# A motion that exceeds a limit by more than this share between nodes fails the certificate; a
# baseline that does is shown, never counted.
CERTIFIED = 5e-3
_BOUNDARY = 1e-3


def find_violations(problem: Any, motion: Assessment) -> Assessment:
    """The assessment with its `violations` filled, worst first.

    Parameters
    ----------
    problem : TrajectoryProblem
        Only its limits are read.
    motion : Assessment
    """
    limits = problem.active_limits
    span = limits.position_upper - limits.position_lower
    beyond = np.maximum(
        motion.position - limits.position_upper, limits.position_lower - motion.position
    )
    with np.errstate(invalid="ignore"):
        found = _per_joint("position", np.where(np.isfinite(span), beyond / span, -np.inf), motion)
    for name, values, bound in (
        ("velocity", motion.velocity, limits.velocity),
        ("acceleration", motion.acceleration, limits.acceleration),
        ("jerk", _jerk_with_jumps(motion), limits.jerk),
        ("torque", motion.torque, limits.torque),
    ):
        found += _per_joint(name, np.abs(values) / bound - 1.0, motion)
    if limits.velocity_map is not None:
        allowed = np.stack(
            [
                np.interp(
                    motion.position[:, j],
                    limits.velocity_map[0][:, j],
                    limits.velocity_map[1][:, j],
                )
                for j in range(motion.position.shape[1])
            ],
            axis=1,
        )
        excess = np.abs(motion.velocity) / allowed - 1.0
        found += _per_joint("velocity_by_position", excess, motion)
    magnitude = {k: np.linalg.norm(v, axis=1) for k, v in motion.deflection.items()}
    for name, series, bound in (
        ("tool_speed", motion.tool_speed, limits.tool_speed),
        ("dynamic_deflection", magnitude["dynamic"], limits.dynamic_deflection),
        ("total_deflection", magnitude["total"], limits.total_deflection),
    ):
        if np.isfinite(bound):
            k = int(np.argmax(series))
            found.append(
                Violation(float(series[k] / bound - 1.0), name, None, float(motion.time[k]))
            )
    for joint, floor in limits.joint_stiffness.items():
        low = motion.lowest_stiffness[joint - 1]
        found.append(Violation(1.0 - low.value / floor, "joint_stiffness", joint, low.time))
    found += _targets(problem, motion)
    found += _boundary(problem, motion)
    found.sort(key=lambda violation: -violation.value)
    return replace(motion, violations=tuple(found))


def _jerk_with_jumps(motion: Assessment) -> np.ndarray:
    """Jerk (K, n), at a jump of the acceleration as steep as the grid can show it."""
    slope = np.abs(np.diff(motion.acceleration, axis=0)) / np.diff(motion.time)[:, None]
    jerk = np.abs(motion.jerk)
    jerk[:-1] = np.maximum(jerk[:-1], slope)
    return np.asarray(jerk)


def _targets(problem: Any, motion: Assessment) -> list[Violation]:
    """How far start, end and vias are missed, relative to their tolerance; vias in order."""
    found = []
    last = len(motion.time) - 1
    stops = [("start", problem.start, 0), ("end", problem.end, last)]
    first = 0
    for number, via in enumerate(problem.vias, start=1):
        first += int(np.argmin(_miss(problem, via, motion)[first:]))
        stops.append((f"via_{number}", via, first))
    for name, target, k in stops:
        miss = _miss(problem, target, motion)[k]
        found.append(Violation(float(miss - 1.0), name, None, float(motion.time[k])))
    return found


def _boundary(problem: Any, motion: Assessment) -> list[Violation]:
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
            share = np.abs(miss) / (_BOUNDARY * np.maximum(typical, 1e-9))
            j = int(np.argmax(share))
            time = float(motion.time[k])
            found.append(Violation(float(share[j] - 1.0), f"{side}_{name}", j + 1, time))
    return found


def _miss(problem: Any, target: Any, motion: Assessment) -> np.ndarray:
    """Miss of a target over time, relative to its tolerance; of a pose the worse of its two."""
    place = _distance(target, motion) / target.tolerance
    if target.rpy is None:
        return np.asarray(place)
    turn = tool_angle(problem.robot, motion.position, target.rpy)
    return np.asarray(np.maximum(place, turn / target.angle_tolerance))


def _distance(target: Any, motion: Assessment) -> np.ndarray:
    """Distance to a target over time: [m] of the tool, or the largest joint angle [rad]."""
    if target.joints is not None:
        return np.asarray(np.max(np.abs(motion.position - target.joints), axis=1))
    return np.asarray(np.linalg.norm(motion.tool - target.position, axis=1))


def _per_joint(name: str, excess: np.ndarray, motion: Assessment) -> list[Violation]:
    """The worst joint of one kind of limit; none where the limit is infinite for all joints."""
    # An infinite limit gives -1 for a ratio, -inf for a position: neither is a limit.
    k, j = np.unravel_index(int(np.argmax(excess)), excess.shape)
    worst = float(excess[k, j])
    if not np.isfinite(worst) or worst <= -1.0 + 1e-15:
        return []
    return [Violation(worst, name, int(j) + 1, float(motion.time[k]))]
