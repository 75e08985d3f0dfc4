"""Worst violation of every limit along an assessed motion, relative to the limit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.certificate.rigid_body import tool_angle
from stiffopt.exact.chain import stage_slip_torque
from stiffopt.problem.limit import DriveLimit
from stiffopt.result.assessment import Assessment, DriveHistory, Violation

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import Target, TrajectoryProblem
    from stiffopt.robot.robot import Robot

# Share by which a limit may be exceeded: above it a motion fails the certificate and a baseline is
# not counted. Rows hold at nodes and midpoints only, so every motion exceeds its limits slightly in
# between; the value is below the resolution of a data sheet's two digits and far above rounding.
CERTIFICATE_TOLERANCE = 5e-3

# Limits of each drive, besides its position's.
DRIVE_LIMITS = ("velocity", "acceleration", "jerk", "torque")

# Share of a limit by which a boundary velocity or acceleration may be missed.
_BOUNDARY_VALUE_TOLERANCE = 1e-3
# Weight of a miss beyond a via's tolerance: more than that of all misses within it.
_EXCESS_WEIGHT = 1e6


def find_violations(problem: TrajectoryProblem, motion: Assessment) -> Assessment:
    """Return the assessment with its `violations` filled, worst first."""
    limits = problem.active_limits
    found = [each for kind in limits.kinds for each in kind.violations(limits, motion)]
    found += _target_violations(problem, motion)
    found += _boundary_violations(problem, motion)
    found.sort(key=lambda violation: -violation.value)
    return replace(motion, violations=tuple(found))


def find_drive_violations(problem: TrajectoryProblem, drives: DriveHistory) -> list[Violation]:
    """Return the violations of drive limits, worst first."""
    limits = problem.active_limits
    kinds = [kind for kind in limits.kinds if isinstance(kind, DriveLimit)]
    found = [each for kind in kinds for each in kind.violations(limits, drives)]
    return sorted(found, key=lambda violation: -violation.value)


def _target_violations(problem: TrajectoryProblem, motion: Assessment) -> list[Violation]:
    """Return the misses of start, end and vias in order, relative to their tolerance."""
    last = len(motion.time) - 1
    stops = [("start", problem.start, 0), ("end", problem.end, last)]
    instants = pass_vias(problem, motion.position, motion.tool)
    for number, (via, k) in enumerate(zip(problem.vias, instants, strict=True), start=1):
        stops.append((f"via_{number}", via, k))
    found = []
    for name, target, k in stops:
        at = slice(k, k + 1)
        miss = relative_target_miss(problem, target, motion.position[at], motion.tool[at])[0]
        found.append(Violation(float(miss - 1.0), name, None, float(motion.time[k])))
    return found


def pass_vias(problem: TrajectoryProblem, position: np.ndarray, tool: np.ndarray) -> list[int]:
    """Return the instants at which positions of joints and tool (K, ..) pass the vias.

    Of all instants in order, those of the least misses: a motion may pass nearer to a via later on.
    """
    cost, costs = np.zeros(len(position)), []
    for via in problem.vias:
        miss = relative_target_miss(problem, via, position, tool)
        beyond = _EXCESS_WEIGHT * np.maximum(miss - 1.0, 0.0)
        cost = np.minimum.accumulate(cost) + miss + beyond
        costs.append(cost)
    instants, k = [], len(position) - 1
    for cost in reversed(costs):
        k = int(np.argmin(cost[: k + 1]))
        instants.append(k)
    return instants[::-1]


def _boundary_violations(problem: TrajectoryProblem, motion: Assessment) -> list[Violation]:
    """Compare start and end velocities and accelerations with the given ones."""
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


def relative_target_miss(
    problem: TrajectoryProblem, target: Target, position: np.ndarray, tool: np.ndarray
) -> np.ndarray:
    """Return the misses (K,) of a target, relative to its tolerance; of a pose the worse of two.

    By positions of joints (K, n) [rad or m] and tool (K, 3) [m].
    """
    if target.joints is not None:
        away = np.max(np.abs(position - target.joints), axis=1)
    else:
        away = np.linalg.norm(tool - target.position, axis=1)
    place = away / target.tolerance
    if target.rpy is None:
        return np.asarray(place)
    turn = tool_angle(problem.robot, position, target.rpy)
    return np.asarray(np.maximum(place, turn / target.angle_tolerance))


@dataclass(frozen=True)
class Slip:
    """A connection that slips."""

    element: str  # name; parallel elements are joined by "with"
    joint: int  # 1-based
    # Torque of the joint at which it slips, and the largest of the motion [N m].
    holds: float
    carries: float
    time: float  # when it first slips [s]

    def describe(self) -> str:
        """Return text for messages: "flange of joint 2 holds 30 N m but carries 41 N m, ..."."""
        return (
            f"{self.element} of joint {self.joint} holds {self.holds:.3g} N m but carries "
            f"{self.carries:.3g} N m, first exceeded at {self.time:.3f} s"
        )


def find_slips(robot: Robot, motion: Assessment) -> tuple[Slip, ...]:
    """Return the connections that slip in a motion, joint by joint."""
    found = []
    for j, chain in enumerate(robot.chains):
        torque = np.abs(motion.spring_torque[:, j])
        for group in () if chain is None else chain.groups(None):
            holds = sum(stage_slip_torque(stage, None) for stage in group)
            if torque.max() < holds:
                continue
            name = " with ".join(stage.element.name for stage in group)
            first = float(motion.time[int(np.argmax(torque >= holds))])
            found.append(Slip(name, j + 1, holds, float(torque.max()), first))
    return tuple(found)


def describe_slips(found: tuple[Slip, ...]) -> str:
    """Return a clause on the slipping connections and their remedy, to continue a sentence."""
    return (
        f"connections slip: {'; '.join(slip.describe() for slip in found)}. Preload them more "
        "(stiffopt preload finds how far), or plan a motion with less torque."
    )
