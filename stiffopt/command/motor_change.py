"""Change of the motors' motion for least residual vibration: a convex quadratic programme.

The links' response to a small change is linear along the simulated motion, and so are the drive
quantities: unknown are the spline coefficients of every joint's change.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
import scipy

from stiffopt.elastic.linearization import TabulatedSprings
from stiffopt.elastic.modes import modes
from stiffopt.elastic.response import ElasticResponse
from stiffopt.elastic.simulate import REST
from stiffopt.result.trajectory import Trajectory
from stiffopt.symbolic import array_of
from stiffopt.transcription.constraint_back_off import largest_adjacent_excess

if TYPE_CHECKING:
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment
    from stiffopt.result.simulation import SimulatedMotion

# Knot spacing of the splines [s], within these numbers of pieces.
_KNOT_SPACING, _MIN_PIECES, _MAX_PIECES = 0.02, 40, 150
# Degree of the splines, of which so many at either end are omitted: position to jerk are unchanged.
# Knots are denser by this factor over so many spacings there: else the first three have no effect.
_SPLINE_DEGREE, _FIXED_END_SPLINES = 5, 4
_END_KNOT_FACTOR, _END_KNOT_SPACINGS = 4, 2
# Time step of the links' response [s], and steps between comparisons of the tool.
_RESPONSE_STEP, _RESPONSE_STRIDE = 1e-3, 3
# Periods of the lowest mode compared after arrival, and their weight.
_ARRIVAL_PERIODS, _ARRIVAL_WEIGHT = 3.0, 5.0
# Weight of the full squared jerk limit beside a squared deviation of the target size.
_JERK_WEIGHT = 0.1
# Share of a via's tolerance by which the tool may be moved there.
_VIA_TOOL_SHARE = 1e-3
# Rows of the drive limits per knot, and share of a limit reserved between them.
_ROWS_PER_KNOT, _LIMIT_RESERVE = 4, 1e-2


def change_motors(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motors: Trajectory,
    assessment: Assessment,
    simulated: SimulatedMotion,
    near: float,
    after: float = 1.0,
) -> Trajectory:
    """Return the motors with the change that brings tool and deviation nearest to the plan.

    `motors`, of planned links, have the `assessment` and the `simulated` arm; `near` is the target
    deviation from the plan [m], `after` a factor on the weight of deviations after arrival.
    """
    joints = np.flatnonzero(arm.elastic)
    splines = _Splines(motors.duration)
    answer, wanted = _linear_response(
        arm, motors, assessment, simulated, splines, _ARRIVAL_WEIGHT * after
    )
    rows, lower, upper = _drive_rows(problem, assessment, splines, joints)
    used = np.max(np.abs(assessment.jerk), axis=0)
    allowed = np.asarray(problem.active_limits.jerk, dtype=float)
    jerk = np.where(np.isfinite(allowed), allowed, used)[joints]
    # Unit of the coefficients: the change that uses a joint's jerk limit.
    unit = np.repeat(np.maximum(jerk, 1e-9) * splines.spacing**3, splines.count)
    bent = splines.sparse(splines.instants, 3)
    effort = scipy.sparse.block_diag([bent / max(own, 1e-9) for own in jerk]) @ scipy.sparse.diags(
        unit
    )
    answer = answer * unit / near
    hessian = answer.T @ answer / len(answer)
    hessian += _JERK_WEIGHT * (effort.T @ effort).toarray() / effort.shape[0]
    towards = -answer.T @ (wanted / near) / len(answer)
    found = unit * _solve_quadratic_programme(
        hessian, towards, scipy.sparse.csc_matrix(rows @ scipy.sparse.diags(unit)), lower, upper
    )
    return _apply_change(motors, splines, joints, np.reshape(found, (len(joints), -1)).T)


class _Splines:
    """Splines over the time of a motion that leave position to jerk at its ends unchanged."""

    def __init__(self, duration: float) -> None:
        pieces = int(np.clip(np.ceil(duration / _KNOT_SPACING), _MIN_PIECES, _MAX_PIECES))
        self.duration, self.spacing = duration, duration / pieces
        finer = np.linspace(0.0, duration, _END_KNOT_FACTOR * pieces + 1)
        inside = np.arange(len(finer))
        begins = np.minimum(inside, inside[::-1]) < _END_KNOT_FACTOR * _END_KNOT_SPACINGS
        self.breaks = finer[begins | (inside % _END_KNOT_FACTOR == 0)]
        pieces = len(self.breaks) - 1
        shares = np.linspace(0.0, 1.0, _ROWS_PER_KNOT, endpoint=False)
        within = self.breaks[:-1, None] + np.diff(self.breaks)[:, None] * shares
        self.instants = np.append(within.ravel(), duration)
        self.count = pieces + _SPLINE_DEGREE - 2 * _FIXED_END_SPLINES
        knots = np.pad(self.breaks, _SPLINE_DEGREE, mode="edge")
        self._all = scipy.interpolate.BSpline(
            knots, np.eye(pieces + _SPLINE_DEGREE), _SPLINE_DEGREE
        )

    def __call__(self, times: np.ndarray, order: int = 0) -> np.ndarray:
        """Return derivatives (K, m) at times (K,); zero after arrival."""
        spline = self._all.derivative(order) if order else self._all
        values = np.asarray(spline(np.minimum(times, self.duration)))[
            :, _FIXED_END_SPLINES:-_FIXED_END_SPLINES
        ]
        values[times > self.duration] = 0.0
        return values

    def pieces(self, order: int) -> np.ndarray:
        """Return coefficients (K, d + 1, m) of derivatives, powers of the time since each break."""
        begins = self.breaks[:-1]
        powers = range(_SPLINE_DEGREE - order + 1)
        return np.stack([self(begins, order + k) / math.factorial(k) for k in powers], axis=1)

    def sparse(self, times: np.ndarray, order: int) -> scipy.sparse.csc_matrix:
        """Return derivatives as a sparse matrix."""
        values = self(times, order)
        values[np.abs(values) < 1e-12 * np.max(np.abs(values))] = 0.0
        return scipy.sparse.csc_matrix(values)


def _apply_change(
    motors: Trajectory, splines: _Splines, joints: np.ndarray, change: np.ndarray
) -> Trajectory:
    """Return the motors with a change of some joints, coefficients (m, k)."""
    at_rest = np.zeros(motors.joints)
    pieces = splines.pieces(2) @ change
    added = np.zeros((*pieces.shape[:2], motors.joints))
    added[:, :, joints] = pieces
    return motors.plus(Trajectory(splines.breaks, added, at_rest, at_rest))


def _linear_response(
    arm: ElasticArm,
    motors: Trajectory,
    assessment: Assessment,
    simulated: SimulatedMotion,
    splines: _Splines,
    after: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return response of tool and deviation to every coefficient (K, m k), and target (K,) [m].

    The tool in flight and after arrival, and its deviation in flight: the deviation refers to the
    static equilibrium at the motors' position, which the smoothing shifts as well.
    """
    joints, duration = np.flatnonzero(arm.elastic), motors.duration
    dt = duration / np.ceil(duration / _RESPONSE_STEP)
    lowest = min(mode.frequency for mode in modes(arm, motors(duration)))
    end = duration + min(_ARRIVAL_PERIODS / lowest, REST - dt)
    times = dt * np.arange(round(end / dt))
    q, v, windup = (
        _interpolate_rows(times, simulated.time, each)
        for each in (simulated.position, simulated.velocity, simulated.windup)
    )
    springs = TabulatedSprings(arm).at(windup)[1][:, joints]
    response = _link_response(arm, q, v, springs, dt)
    moved, rate = splines(times), splines(times, 1)
    at = slice(None, None, _RESPONSE_STRIDE)
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
    planned = _interpolate_rows(times[at], assessment.time, assessment.deflection["dynamic"])
    lacking = (planned - _interpolate_rows(times[at], simulated.time, simulated.deviation))[flying]
    return np.concatenate(columns, axis=1), np.concatenate([tool_behind, lacking]).ravel()


def _interpolate_rows(times: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate values (k, n) at times (K,)."""
    return np.stack([np.interp(times, known, each) for each in values.T], axis=1)


def _link_response(
    arm: ElasticArm, q: np.ndarray, v: np.ndarray, springs: np.ndarray, dt: float
) -> ElasticResponse:
    """Return the linear response of elastic joints about a motion (K, n); springs [N m/rad]."""
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


def _drive_rows(
    problem: TrajectoryProblem, now: Assessment, splines: _Splines, joints: np.ndarray
) -> tuple[scipy.sparse.csc_matrix, np.ndarray, np.ndarray]:
    """Return rows of the drive quantities over their limits, with lower and upper bounds.

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
            scipy.sparse.block_diag(
                [sum(rates[k] * part[j] for k, part in parts.items()) / most[j] for j in joints]
            )
        )
        share = (value / most)[:, joints]
        above, below = (
            largest_adjacent_excess(now.time, at, np.maximum(each, 0.0)) for each in (share, -share)
        )
        upper.append(_remaining_limit(above).T.ravel())
        lower.append(-_remaining_limit(below).T.ravel())
    for row, least, most in _via_rows(problem, now, splines, joints):
        rows.append(row)
        lower.append(least)
        upper.append(most)
    highest = np.concatenate(upper)
    # A limit exceeded in both directions within a cell allows no change.
    return (
        scipy.sparse.csc_matrix(scipy.sparse.vstack(rows)),
        np.minimum(np.concatenate(lower), highest),
        highest,
    )


def _remaining_limit(used: np.ndarray) -> np.ndarray:
    """Return the unused share of a limit less the reserve; 0 where nearly all of it is used."""
    left = 1.0 - used
    return np.where(left > _LIMIT_RESERVE, left - _LIMIT_RESERVE, np.minimum(left, 0.0))


def _via_rows(
    problem: TrajectoryProblem, now: Assessment, splines: _Splines, joints: np.ndarray
) -> Iterator[tuple[scipy.sparse.csc_matrix, np.ndarray, np.ndarray]]:
    """Yield rows of the misses of vias over their tolerance, with lower and upper bounds.

    A joint may use the rest of its via's tolerance; the tool is held in place, since it is mostly
    at the edge of its tolerance.
    """
    bodies, tool = problem.robot.rigid_bodies(), problem.robot.tool
    passed = {each.limit: each.time for each in now.violations}
    for number, via in enumerate(problem.vias, start=1):
        k = int(np.argmin(np.abs(now.time - passed[f"via_{number}"])))
        moved = scipy.sparse.csc_matrix(splines(now.time[k : k + 1]))
        if via.joints is not None:
            room = (now.position[k] - via.joints)[joints] / via.tolerance
            per_joint = scipy.sparse.block_diag([moved] * len(joints)) / via.tolerance
            yield per_joint, np.minimum(-1.0 - room, 0.0), np.maximum(1.0 - room, 0.0)
            continue
        shares = bodies.jacobian(tool, now.position[k])[:, joints]
        shares[:3] /= via.tolerance
        shares[3:] /= via.angle_tolerance
        shares = shares if via.rpy is not None else shares[:3]
        stays = np.full(len(shares), _VIA_TOOL_SHARE)
        yield scipy.sparse.kron(scipy.sparse.csc_matrix(shares), moved), -stays, stays


def _solve_quadratic_programme(
    hessian: np.ndarray,
    towards: np.ndarray,
    rows: scipy.sparse.csc_matrix,
    lower: np.ndarray,
    upper: np.ndarray,
) -> np.ndarray:
    """Return the minimiser x (m,) of x' H x / 2 + g' x with bounded rows; zero if none is found."""
    rows.sort_indices()
    places = ca.Sparsity(
        int(rows.shape[0]),
        int(rows.shape[1]),
        [int(k) for k in rows.indptr],
        [int(k) for k in rows.indices],
    )
    dense = ca.DM(hessian)
    shapes: dict[str, Any] = {"h": dense.sparsity(), "a": places}
    # An interior point method: first-order ones leave most of a small vibration.
    programme = ca.conic("change", "piqp", shapes, {"error_on_fail": False})
    # Violated rows must be satisfied or, where that is infeasible, not get worse.
    for least, most in ((lower, upper), (np.minimum(lower, 0.0), np.maximum(upper, 0.0))):
        answer = programme(h=dense, g=towards, a=ca.DM(places, rows.data), lba=least, uba=most)
        if programme.stats()["success"]:
            return array_of(answer["x"]).ravel()
    return np.zeros(len(towards))
