"""The small change of the motors' motion that brings swinging links nearest to their plan.

The links' answer to it is linear along the simulated motion, and so is what it asks of the drives:
a convex quadratic programme in the coefficients of splines, one after another for every joint.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import block_diag, csc_matrix, diags, kron, vstack

from stiffopt.elastic.modes import modes
from stiffopt.elastic.response import ElasticResponse
from stiffopt.elastic.simulate import REST
from stiffopt.elastic.uncertain_arms import TabulatedSprings
from stiffopt.result.trajectory import Trajectory
from stiffopt.symbolic import array_of
from stiffopt.transcription.constraint_back_off import largest_adjacent_excess

if TYPE_CHECKING:
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment
    from stiffopt.result.simulation import SimulatedMotion

# Distance of the splines' knots [s], as far as their number stays within these.
_SPACING, _FEWEST, _MOST = 0.02, 40, 150
# Degree of the splines, of which so many at either end are left out: position to jerk stay. There
# knots are so many times as close over so many distances: else nothing changes for three of them.
_DEGREE, _KEPT = 5, 4
_CLOSER, _ENDS = 4, 2
# Between instants of the links' answer [s], and of those at which the tool is compared.
_STEP, _EVERY = 1e-3, 3
# Swings of the lowest mode that are looked at after arrival, and what they count for more.
_SWINGS, _AFTER = 3.0, 5.0
# What all of a joint's jerk costs, beside a motion that is just not near, squared.
_EFFORT = 0.1
# Of a via's tolerance, by which the tool may be moved there.
_STAYS = 1e-3
# Rows a knot at which the drives' limits hold, and the share of a limit kept free between them.
_ROWS, _FREE = 4, 1e-2


def changed_motors(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motors: Trajectory,
    assessment: Assessment,
    simulated: SimulatedMotion,
    near: float,
    after: float = 1.0,
) -> Trajectory:
    """The motors with the change that brings tool and deviation nearest to the plan.

    Parameters
    ----------
    problem : TrajectoryProblem
    arm : ElasticArm
    motors : Trajectory
        Of planned links.
    assessment : Assessment
        Of these motors.
    simulated : SimulatedMotion
        What the arm does with them.
    near : float
        Deviation from the plan that is near enough [m].
    after : float
        What deviations after arrival count for more than they do anyway.
    """
    joints = np.flatnonzero(arm.elastic)
    splines = _Splines(motors.duration)
    answer, wanted = _answer(arm, motors, assessment, simulated, splines, _AFTER * after)
    rows, lower, upper = _rows(problem, assessment, splines, joints)
    used = np.max(np.abs(assessment.jerk), axis=0)
    allowed = np.asarray(problem.active_limits.jerk, dtype=float)
    jerk = np.where(np.isfinite(allowed), allowed, used)[joints]
    # Of one size: what takes a joint's jerk.
    unit = np.repeat(np.maximum(jerk, 1e-9) * splines.spacing**3, splines.count)
    bent = splines.sparse(splines.instants, 3)
    effort = block_diag([bent / max(own, 1e-9) for own in jerk]) @ diags(unit)
    answer = answer * unit / near
    hessian = answer.T @ answer / len(answer)
    hessian += _EFFORT * (effort.T @ effort).toarray() / effort.shape[0]
    towards = -answer.T @ (wanted / near) / len(answer)
    found = unit * _least(hessian, towards, csc_matrix(rows @ diags(unit)), lower, upper)
    return _moved(motors, splines, joints, np.reshape(found, (len(joints), -1)).T)


class _Splines:
    """Splines over the time of a motion that leave position to jerk at its ends as they are.

    Parameters
    ----------
    duration : float
        [s].
    """

    def __init__(self, duration: float) -> None:
        pieces = int(np.clip(np.ceil(duration / _SPACING), _FEWEST, _MOST))
        self.duration, self.spacing = duration, duration / pieces
        finer = np.linspace(0.0, duration, _CLOSER * pieces + 1)
        inside = np.arange(len(finer))
        begins = np.minimum(inside, inside[::-1]) < _CLOSER * _ENDS
        self.breaks = finer[begins | (inside % _CLOSER == 0)]
        pieces = len(self.breaks) - 1
        shares = np.linspace(0.0, 1.0, _ROWS, endpoint=False)
        within = self.breaks[:-1, None] + np.diff(self.breaks)[:, None] * shares
        self.instants = np.append(within.ravel(), duration)
        self.count = pieces + _DEGREE - 2 * _KEPT
        knots = np.pad(self.breaks, _DEGREE, mode="edge")
        self._all = BSpline(knots, np.eye(pieces + _DEGREE), _DEGREE)

    def __call__(self, times: np.ndarray, order: int = 0) -> np.ndarray:
        """Derivatives (K, m) at times (K,); zero after arrival."""
        spline = self._all.derivative(order) if order else self._all
        values = np.asarray(spline(np.minimum(times, self.duration)))[:, _KEPT:-_KEPT]
        values[times > self.duration] = 0.0
        return values

    def pieces(self, order: int) -> np.ndarray:
        """Coefficients (K, d + 1, m) of derivatives, by powers of the time since each break."""
        begins = self.breaks[:-1]
        powers = range(_DEGREE - order + 1)
        return np.stack([self(begins, order + k) / math.factorial(k) for k in powers], axis=1)

    def sparse(self, times: np.ndarray, order: int) -> csc_matrix:
        """The same without the zeros."""
        values = self(times, order)
        values[np.abs(values) < 1e-12 * np.max(np.abs(values))] = 0.0
        return csc_matrix(values)


def _moved(
    motors: Trajectory, splines: _Splines, joints: np.ndarray, change: np.ndarray
) -> Trajectory:
    """Motors with a change of some joints, coefficients (m, k)."""
    at_rest = np.zeros(motors.joints)
    pieces = splines.pieces(2) @ change
    added = np.zeros((*pieces.shape[:2], motors.joints))
    added[:, :, joints] = pieces
    return motors.plus(Trajectory(splines.breaks, added, at_rest, at_rest))


def _answer(
    arm: ElasticArm,
    motors: Trajectory,
    assessment: Assessment,
    simulated: SimulatedMotion,
    splines: _Splines,
    after: float,
) -> tuple[np.ndarray, np.ndarray]:
    """What the tool and its deviation do by every coefficient (K, m k), and should do (K,) [m].

    The tool in flight and after arrival, its deviation in flight: that is told from where the tool
    hangs at the motors' position, which corners that are rounded off move as well.
    """
    joints, duration = np.flatnonzero(arm.elastic), motors.duration
    dt = duration / np.ceil(duration / _STEP)
    lowest = min(mode.frequency for mode in modes(arm, motors(duration)))
    end = duration + min(_SWINGS / lowest, REST - dt)
    times = dt * np.arange(round(end / dt))
    q, v, windup = (
        _at(times, simulated.time, each)
        for each in (simulated.position, simulated.velocity, simulated.windup)
    )
    springs = TabulatedSprings(arm).at(windup)[1][:, joints]
    response = _response(arm, q, v, springs, dt)
    moved, rate = splines(times), splines(times, 1)
    # Instants at which the tool is compared.
    at = slice(None, None, _EVERY)
    jacobian = np.stack([arm.bodies.jacobian(arm.robot.tool, row)[:3, joints] for row in q[at]])
    flying = times[at] <= duration
    weight = np.where(flying, 1.0, after)[:, None]
    columns = []
    for k, joint in enumerate(joints):
        push = springs[:, k, None] * moved + arm.damping[joint] * rate
        swing, _ = response.pushed(np.full(push.shape[1], k), push.T)
        tool = np.einsum("kij,mkj->kim", jacobian, swing[:, at])
        away = tool - jacobian[:, :, k, None] * moved[at, None]
        both = np.concatenate([weight[..., None] * tool, away[flying]])
        columns.append(both.reshape(-1, splines.count))
    link = motors.link
    assert link is not None
    behind = arm.static_equilibrium(link(np.minimum(times[at], link.duration))) - q[at]
    tool_behind = weight * np.einsum("kij,kj->ki", jacobian, behind[:, joints])
    planned = _at(times[at], assessment.time, assessment.deflection["dynamic"])
    lacking = (planned - _at(times[at], simulated.time, simulated.deviation))[flying]
    return np.concatenate(columns, axis=1), np.concatenate([tool_behind, lacking]).ravel()


def _at(times: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (k, n) at other times (K, n)."""
    return np.stack([np.interp(times, known, each) for each in values.T], axis=1)


def _response(
    arm: ElasticArm, q: np.ndarray, v: np.ndarray, springs: np.ndarray, dt: float
) -> ElasticResponse:
    """Links of joints that yield, about a motion (K, n), on springs (K, k) [N m/rad]."""
    joints = np.flatnonzero(arm.elastic)
    acceleration = np.gradient(v, dt, axis=0)
    by_q, by_v, inertia = (
        each[:, joints[:, None], joints]
        for each in arm.robot.bodies_in_motion().torque_slopes(q, v, acceleration)
    )
    diagonal = np.arange(len(joints))
    by_q[:, diagonal, diagonal] += springs
    by_v[:, diagonal, diagonal] += arm.damping[joints]
    return ElasticResponse(inertia, by_v, by_q, dt)


def _rows(
    problem: TrajectoryProblem, now: Assessment, splines: _Splines, joints: np.ndarray
) -> tuple[csc_matrix, np.ndarray, np.ndarray]:
    """What coefficients add to the drives of joints, over the limits, the least and the most of it.

    The links' torque is that of their plan.
    """
    limits, robot = problem.active_limits, problem.robot
    ones, at = np.ones(robot.n), splines.instants
    rates = {order: splines.sparse(at, order) for order in (1, 2, 3)}
    rows, lower, upper = [], [], []
    for value, limit, parts in (
        (now.velocity, limits.velocity, {1: ones}),
        (now.acceleration, limits.acceleration, {2: ones}),
        (now.jerk, limits.jerk, {3: ones}),
        (now.torque, limits.torque, {2: robot.rotor_inertia, 1: robot.viscous}),
    ):
        most = np.broadcast_to(np.asarray(limit, dtype=float), (robot.n,))
        rows.append(
            block_diag(
                [sum(rates[k] * part[j] for k, part in parts.items()) / most[j] for j in joints]
            )
        )
        share = (value / most)[:, joints]
        above, below = (
            largest_adjacent_excess(now.time, at, np.maximum(each, 0.0)) for each in (share, -share)
        )
        upper.append(_room(above).T.ravel())
        lower.append(-_room(below).T.ravel())
    for row, least, most in _via_rows(problem, now, splines, joints):
        rows.append(row)
        lower.append(least)
        upper.append(most)
    highest = np.concatenate(upper)
    # A limit that is exceeded both ways within a cell leaves no room.
    return csc_matrix(vstack(rows)), np.minimum(np.concatenate(lower), highest), highest


def _room(used: np.ndarray) -> np.ndarray:
    """What may be added where so much of a limit is used; nothing where it is nearly all."""
    left = 1.0 - used
    return np.where(left > _FREE, left - _FREE, np.minimum(left, 0.0))


def _via_rows(
    problem: TrajectoryProblem, now: Assessment, splines: _Splines, joints: np.ndarray
) -> Iterator[tuple[csc_matrix, np.ndarray, np.ndarray]]:
    """What coefficients add to the misses of vias, over their tolerance, its least and its most.

    A joint may move within what its via leaves it; the tool stays, where it mostly is at the edge
    of its tolerance.
    """
    bodies, tool = problem.robot.rigid_bodies(), problem.robot.tool
    passed = {each.limit: each.time for each in now.violations}
    for number, via in enumerate(problem.vias, start=1):
        k = int(np.argmin(np.abs(now.time - passed[f"via_{number}"])))
        moved = csc_matrix(splines(now.time[k : k + 1]))
        if via.joints is not None:
            room = (now.position[k] - via.joints)[joints] / via.tolerance
            per_joint = block_diag([moved] * len(joints)) / via.tolerance
            yield per_joint, np.minimum(-1.0 - room, 0.0), np.maximum(1.0 - room, 0.0)
            continue
        shares = bodies.jacobian(tool, now.position[k])[:, joints]
        shares[:3] /= via.tolerance
        shares[3:] /= via.angle_tolerance
        shares = shares if via.rpy is not None else shares[:3]
        stays = np.full(len(shares), _STAYS)
        yield kron(csc_matrix(shares), moved), -stays, stays


def _least(
    hessian: np.ndarray,
    towards: np.ndarray,
    rows: csc_matrix,
    lower: np.ndarray,
    upper: np.ndarray,
) -> np.ndarray:
    """Argument x (m,) of the least x' H x / 2 + g' x, rows within their bounds; or else zero."""
    rows.sort_indices()
    places = ca.Sparsity(
        int(rows.shape[0]),
        int(rows.shape[1]),
        [int(k) for k in rows.indptr],
        [int(k) for k in rows.indices],
    )
    dense = ca.DM(hessian)
    shapes: dict[str, Any] = {"h": dense.sparsity(), "a": places}
    # An interior point method: first-order ones end with most of a small swing still there.
    programme = ca.conic("change", "piqp", shapes, {"error_on_fail": False})
    # What is exceeded has to give way, or else to get no worse.
    for least, most in ((lower, upper), (np.minimum(lower, 0.0), np.maximum(upper, 0.0))):
        answer = programme(h=dense, g=towards, a=ca.DM(places, rows.data), lba=least, uba=most)
        if programme.stats()["success"]:
            return array_of(answer["x"]).ravel()
    return np.zeros(len(towards))
