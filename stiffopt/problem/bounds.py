"""Bounds of objectives and of the duration that hold for every motion, found before solving.

Bounds of a single objective or limit are in its own file. Here are the general ones: with a free
duration and no upper bound, deflection, torque and compliance decrease without end, and the limits
of joints and tool bound the duration from below.
"""

from __future__ import annotations

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.objective import ACCEPT_ADVICE, Bound, Objective
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem


def find_bounds(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[Bound, ...]:
    """Return the bounds of all objectives of a problem."""
    alone = len(problem.objectives) == 1
    found: list[Bound] = []
    for objective in problem.objectives:
        if alone and np.isinf(problem.duration[1]) and not objective.kind.ends_motion:
            found.append(_unbounded_duration(objective))
        found += objective.kind.bounds(objective, problem, motion)
    return tuple(found)


def check_bounds(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[str, ...]:
    """Refuse degenerate objectives and limits that no motion can meet; return notes on the others.

    Raises `ProblemError`: an objective is at its bound for every motion: value, cause and
    alternatives.
    """
    for kind in problem.active_limits.kinds:
        kind.check(problem, motion)
    bounds = find_bounds(problem, motion)
    accepted = {o.name for o in problem.objectives if o.accept_bound}
    refused = [b for b in bounds if b.degenerate and b.objective not in accepted]
    if refused:
        raise ProblemError("\n".join(b.text for b in refused))
    return tuple(
        b.text.removesuffix(ACCEPT_ADVICE) + "." * b.text.endswith(ACCEPT_ADVICE) for b in bounds
    )


def shortest_duration(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[float, str]:
    """Lower bound of the duration [s], and its explanation; (0, "") without a bound.

    The bound is the largest of: each joint alone from rest to rest over its travel, with reversals
    at vias, within velocity, acceleration and jerk limits; and the tool's straight travel at its
    speed limit.
    """
    if not (motion.start_fixed and motion.end_fixed) or not problem.rests_at_both_ends:
        return 0.0, ""
    limits = problem.active_limits
    # The jerk bound needs zero acceleration at both ends.
    still = problem.boundary_acceleration == "zero" and problem.path is None
    still = still and not problem.plans_links
    jerk = limits.jerk if still else np.full(problem.joints, np.inf)
    needed, ways = np.zeros(problem.joints), np.zeros(problem.joints)
    for j in range(problem.joints):
        own = (float(limits.velocity[j]), float(limits.acceleration[j]))
        pieces = _joint_travels(problem, motion, j)
        ways[j] = sum(pieces)
        straight = abs(float(motion.end[j] - motion.start[j]))
        needed[j] = max(
            rest_to_rest(straight, *own, float(jerk[j])),
            # At a reversal the velocity is zero, the acceleration need not be.
            sum(rest_to_rest(piece, *own, np.inf) for piece in pieces),
        )
    j = int(np.argmax(needed))
    length, speed = _tool_travel(problem, motion), float(getattr(limits, "tool_speed", np.inf))
    if length / speed > needed[j]:
        return length / speed, (
            f"The tool has to move by {1e3 * length:.4g} mm and needs {length / speed:.4g} s or "
            f"more for that within its tool speed limit {speed:.4g} m/s; the duration allows "
            f"{problem.duration[1]:.4g} s."
        )
    unit = "m" if problem.robot.prismatic[j] else "rad"
    given = [
        f"its {name} limit {value:.4g} {unit}/{per}"
        for name, value, per in (
            ("velocity", limits.velocity[j], "s"),
            ("acceleration", limits.acceleration[j], "s^2"),
            ("jerk", jerk[j], "s^3"),
        )
        if np.isfinite(value)
    ]
    return float(needed[j]), (
        f"Joint {j + 1} has to move by {ways[j]:.4g} {unit} and needs {needed[j]:.4g} s or more "
        f"for that within {' and '.join(given)}; the duration allows {problem.duration[1]:.4g} s."
    )


def rest_to_rest(travel: float, velocity: float, acceleration: float, jerk: float) -> float:
    """Shortest time [s] of one joint from rest to rest over a travel [rad]; 0 without limits.

    >>> rest_to_rest(2.0, 1.0, np.inf, np.inf), rest_to_rest(1.0, np.inf, 4.0, np.inf)
    (2.0, 1.0)
    >>> rest_to_rest(2.0, np.inf, np.inf, 32.0), rest_to_rest(3.0, 1.0, 2.0, 4.0)
    (1.2599..., 4.0)
    """

    def rise(speed: float) -> float:
        """Time from rest to a constant speed."""
        if np.isinf(jerk):
            return speed / acceleration
        if speed * jerk <= acceleration * acceleration:
            return float(2.0 * np.sqrt(speed / jerk))
        return speed / acceleration + acceleration / jerk

    if travel <= 0.0:
        return 0.0
    if np.isfinite(velocity) and velocity * rise(velocity) <= travel:
        return travel / velocity + rise(velocity)
    # No constant-speed phase: the travel s rise(s) grows with the peak speed s.
    if np.isinf(jerk):
        return 0.0 if np.isinf(acceleration) else float(2.0 * np.sqrt(travel / acceleration))
    by_jerk = float(np.cbrt(travel * travel * jerk / 4.0))
    if by_jerk * jerk <= acceleration * acceleration:
        return 2.0 * rise(by_jerk)
    # s^2 / a + s a / j = travel
    ramp = acceleration * acceleration / jerk
    speed = 0.5 * (np.sqrt(ramp * ramp + 4.0 * acceleration * travel) - ramp)
    return float(2.0 * rise(float(speed)))


def _joint_travels(problem: TrajectoryProblem, motion: ResolvedMotion, joint: int) -> list[float]:
    """Least travels of a joint between its reversals, with the tolerances of vias."""
    low = high = float(motion.start[joint])
    places = [(low, high)]
    for via in () if problem.path is not None or problem.plans_links else problem.vias:
        if via.joints is not None:
            middle = float(via.joints[joint])
            places.append((middle - via.tolerance, middle + via.tolerance))
    places.append((float(motion.end[joint]),) * 2)
    # Least travel through all intervals in order: move only as far as each requires.
    at, pieces, direction = places[0][0], [0.0], 0
    for low, high in places[1:]:
        step = min(max(at, low), high) - at
        if step and direction and np.sign(step) != direction:
            pieces.append(0.0)
        if step:
            direction = int(np.sign(step))
            pieces[-1] += abs(step)
        at += step
    return pieces


def _tool_travel(problem: TrajectoryProblem, motion: ResolvedMotion) -> float:
    """Least travel [m] of the tool through its given positions."""
    if problem.plans_links or not np.isfinite(problem.active_limits.tool_speed):
        return 0.0
    poses = [motion.start, motion.end]
    bodies = problem.robot.rigid_bodies()
    ends = [bodies.pose(problem.robot.tool, angles)[0] for angles in poses]
    way, at, missed = 0.0, ends[0], 0.0
    for via in problem.vias:
        if via.position is not None:
            way += max(float(np.linalg.norm(via.position - at)) - missed - via.tolerance, 0.0)
            at, missed = via.position, via.tolerance
    return way + max(float(np.linalg.norm(ends[1] - at)) - missed, 0.0)


def _unbounded_duration(objective: Objective) -> Bound:
    return Bound(
        objective.name,
        np.inf,
        f"{objective.name} with a free duration and no upper bound has no optimum: a slower motion "
        "is always better, down to the value at rest. Give motion.duration an upper bound or a "
        "fixed value, or add the objective 'duration' with a weight.",
        True,
    )
