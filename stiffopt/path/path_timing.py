"""Fastest timing of a joint path under limits of every derivative, by a sequence of programmes.

A timing of the path is rescaled: with time t of the present timing and x = (dt/dt_new)^2, the
joints' velocity is q' sqrt(x), their acceleration q'' x + q' x'/2 and their jerk
sqrt(x) (q''' x + 3/2 q'' x' + q' x''/2), the torques linear in x and x'. Divided by sqrt(x), the
limit of the jerk is convex in x, and its tangent at x = 1 lies below: every programme with it is
linear and its motion keeps the limits. Repeated until the duration settles, x is 1 everywhere and
the tangent exact. Time is the parameter, so that starts and stops are regular.

Source of the squared speed as unknown: Verscheure et al. (2009), "Time-optimal path tracking for
robots: a convex optimization approach", IEEE Transactions on Automatic Control 54; of the sequence
for limits of the jerk: Debrouwere et al. (2013), "Time-optimal path following for robots with
convex-concave constraints using sequential convex programming", IEEE Transactions on Robotics 29.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import factorial
from typing import TYPE_CHECKING

import numpy as np
import scipy

from stiffopt.baseline.path_limits import torque_rows
from stiffopt.errors import ProblemError
from stiffopt.path.banded_programme import BandedRows, maximise
from stiffopt.problem.limits.velocity_by_position import velocity_at
from stiffopt.result.trajectory import Trajectory, join_motions

if TYPE_CHECKING:
    from stiffopt.problem.limit import Limits
    from stiffopt.result.joint_path import JointPath
    from stiffopt.robot.robot import Robot

# Longest step of the grid [s], and least and largest number of steps.
_LONGEST_STEP, _MIN_STEPS, _MAX_STEPS = 5e-3, 200, 12_000
# Shares of a step at which limits hold.
_STAGE_SHARES = (0.0, 0.5, 1.0)
# Shares at which the last timing is checked.
_CHECKED_STAGES = (0.0, 0.25, 0.5, 0.75, 1.0)
# Programmes, and relative gain in duration below which they end.
_MAX_PROGRAMMES, _MIN_GAIN = 40, 1e-3
# Programmes after that, in which limits are tightened where the motion exceeds them between the
# stages, and the slowing from which on that is left out.
_MAX_POLISHINGS, _MAX_KEPT_SLOWING = 8, 1.002
_LEAST_ALLOWANCE = 0.4
# Relative change of the duration below which the nodes are kept.
_NODE_CHANGE_GAIN = 0.05
# Bounds of x: the tangent of the jerk limit admits nothing above 3.
_LEAST_SCALE, _LARGEST_SCALE = 1e-3, 2.9
# Share of the limits that the first timing uses, and its time of rise to full acceleration [s].
_FIRST_SHARE, _FIRST_RISE = 0.5, 0.05
_PATH_SAMPLES_PER_PIECE, _MIN_PATH_SAMPLES = 8, 2000
# Gauss-Legendre points of the time of a step.
_GAUSS_POINTS, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, kw_only=True, eq=False)
class PathDemands:
    """Demands on a timing along a path beside the limits of the joints.

    Parameters
    ----------
    path_speed : callable or None
        Largest rate (K,) [1/s] of the path parameter at path parameters (K,).
    process_force : callable or None
        Force on the tool (K, 3) [N], base axes, at path parameters (K,).
    margin : mapping
        Share of a limit that is left unused, by the limit's name.
    eased : bool
        The acceleration is zero at both ends.
    """

    path_speed: Callable[[np.ndarray], np.ndarray] | None = None
    process_force: Callable[[np.ndarray], np.ndarray] | None = None
    margin: dict[str, float] | None = None
    eased: bool = True

    def on(self, begin: float, end: float) -> PathDemands:
        """Return the demands on a part of the path, whose parameter runs from 0 to 1 again."""
        speed, force, span = self.path_speed, self.process_force, end - begin
        return replace(
            self,
            path_speed=None if speed is None else lambda s: speed(begin + span * s) / span,
            process_force=None if force is None else lambda s: force(begin + span * s),
        )

    def share(self, name: str) -> float:
        """Share of a limit that may be used."""
        return 1.0 - (self.margin or {}).get(name, 0.0)


def fastest_timing(
    robot: Robot, limits: Limits, path: JointPath, demands: PathDemands | None = None
) -> Trajectory:
    """Return the fastest time law s(t) of a path within limits, at rest at its ends and stops.

    Joint velocity (with its map over position), acceleration, jerk, drive torque and tool speed,
    with that of each piece of the path.

    Raises
    ------
    ProblemError
        A torque limit is exceeded at rest on the path.
    """
    asked = demands or PathDemands()
    laws = []
    for (begin, end, part), dwell in zip(
        path.between_stops(), [*path.dwells.tolist(), 0.0], strict=True
    ):
        law = _fastest_part(_PathTiming(robot, limits, part, asked.on(begin, end)), part)
        laws.append((_scaled_law(law, begin, end), dwell))
    return join_motions(laws)


def _scaled_law(law: Trajectory, begin: float, end: float) -> Trajectory:
    """Return a law from 0 to 1 as one from `begin` to `end`."""
    span = end - begin
    return Trajectory(law.times, span * law.acceleration, begin + span * law.q0, span * law.v0)


def _fastest_part(found: _PathTiming, path: JointPath) -> Trajectory:
    """Return the fastest law of a path without stops."""
    law, settled, ended, best = found.first_law(), False, 0, None
    for _ in range(_MAX_PROGRAMMES):
        better = found.rescaled(law)
        gain = abs(1.0 - better.duration / law.duration)
        # New nodes would smear the jumps of the jerk: not near the optimum.
        settled = settled or gain < _NODE_CHANGE_GAIN
        law = better if settled else better.with_nodes_at(path.knots)
        if not settled:
            continue
        slowed = law.duration * max(1.0, found.slowing(law))
        if best is None or slowed < best[1]:
            best = law, slowed
        ended += gain < _MIN_GAIN or ended > 0
        if ended > _MAX_POLISHINGS or (ended and slowed <= law.duration * _MAX_KEPT_SLOWING):
            break
        if ended:
            found.tighten(law)
    law, slowed = best or (law, law.duration * max(1.0, found.slowing(law)))
    return law.trajectory().scaled_to(slowed)


class _Law:
    """Time law s(t): the cubic spline through values at nodes, from rest to rest.

    Parameters
    ----------
    time, values : array (K + 1,)
        Nodes [s], and s there.
    eased : bool
        The acceleration is zero at both ends; the values beside the ends are then the spline's.
    """

    def __init__(self, time: np.ndarray, values: np.ndarray, eased: bool) -> None:
        knots = np.concatenate([time[:1].repeat(3), time, time[-1:].repeat(3)])
        sites, rest = np.arange(len(time)), [(1, 0.0)]
        if eased:
            sites, rest = np.delete(sites, [1, len(time) - 2]), [(1, 0.0), (2, 0.0)]
        spline = scipy.interpolate.make_interp_spline(
            time[sites], values[sites], 3, knots, bc_type=(rest, rest)
        )
        self.time, self.eased = time, eased
        # Coefficients (4, K) of the powers of the time since each node, the lowest first.
        self.powers = np.stack([spline(time[:-1], k) / factorial(k) for k in range(4)])
        self.values = np.append(self.powers[0], values[-1])

    @property
    def duration(self) -> float:
        return float(self.time[-1])

    def at(self, share: float) -> np.ndarray:
        """Return s and three derivatives (4, K) at a share of every step."""
        return _evaluate(self.powers, share * np.diff(self.time))

    def __call__(self, time: np.ndarray) -> np.ndarray:
        """Return s at times (m,)."""
        step = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        return np.asarray(_evaluate(self.powers[:, step], time - self.time[step])[0])

    def trajectory(self) -> Trajectory:
        """Return the law as a motion of one joint, from 0 to 1."""
        _, _, c2, c3 = self.powers
        acceleration = np.stack([2.0 * c2, 6.0 * c3], axis=1)
        return Trajectory.from_acceleration(
            self.time, acceleration[:, :, None], self.powers[0, :1], self.powers[1, :1]
        )

    def crossings(self, knots: np.ndarray) -> np.ndarray:
        """Times (m,) at which s passes knots (m,), by bisection."""
        step = np.clip(np.searchsorted(self.values, knots, side="right") - 1, 0, len(self.time) - 2)
        low, high = self.time[step].copy(), self.time[step + 1].copy()
        begin, powers = low.copy(), self.powers[:, step]
        for _ in range(60):
            middle = 0.5 * (low + high)
            before = _evaluate(powers, middle - begin)[0] < knots
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        return high

    def with_nodes_at(self, knots: np.ndarray) -> _Law:
        """Return the law with nodes where s passes knots, and about equal steps between."""
        crossed = np.concatenate([[0.0], self.crossings(knots[1:-1]), [self.duration]])
        # Rounding may order crossings of very close knots wrongly.
        crossed = np.maximum.accumulate(crossed)
        spans = np.diff(crossed)
        longest = self.duration / _steps_of(self.duration)
        counts = np.maximum(np.ceil(spans / longest).astype(int), 1)
        counts[[0, -1]] = np.maximum(counts[[0, -1]], 3)
        ends = np.cumsum(counts)
        inside = (np.arange(ends[-1]) - np.repeat(ends - counts, counts)) / np.repeat(
            counts, counts
        )
        time = np.repeat(crossed[:-1], counts) + inside * np.repeat(spans, counts)
        time = np.append(time, self.duration)
        values = self(time)
        values[np.append(0, ends)] = knots
        return _Law(time, values, self.eased)


def _evaluate(powers: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Cubic polynomials and three derivatives (4, K) at local times (K,)."""
    c0, c1, c2, c3 = powers
    return np.stack(
        [
            c0 + local * (c1 + local * (c2 + local * c3)),
            c1 + local * (2.0 * c2 + local * 3.0 * c3),
            2.0 * c2 + 6.0 * local * c3,
            6.0 * c3 + 0.0 * local,
        ]
    )


class _PathTiming:
    """Programmes of one path."""

    def __init__(self, robot: Robot, limits: Limits, path: JointPath, demands: PathDemands) -> None:
        self._robot, self._limits, self._path, self._demands = robot, limits, path, demands
        # Shares of the limits of acceleration and jerk that may be used in every step.
        self._allowances: dict[str, np.ndarray] = {}

    def first_law(self) -> _Law:
        """Return a timing that uses a share of the limits, with nodes at the path's knots."""
        path = self._path
        pieces = len(path.knots) - 1
        count = max(_PATH_SAMPLES_PER_PIECE, -(-_MIN_PATH_SAMPLES // pieces))
        s = np.append(
            np.linspace(path.knots[:-1], path.knots[1:], count, endpoint=False).T.ravel(), 1.0
        )
        speed, push = self._path_bounds(s)
        squared = speed**2
        squared[[0, -1]] = 0.0
        room = 2.0 * np.diff(s) * np.minimum(push[1:], push[:-1])
        for k in range(len(s) - 1):
            squared[k + 1] = min(squared[k + 1], squared[k] + room[k])
        for k in range(len(s) - 2, -1, -1):
            squared[k] = min(squared[k], squared[k + 1] + room[k])
        rate = np.sqrt(squared)
        steps = 2.0 * np.diff(s) / (rate[1:] + rate[:-1])
        time = np.concatenate([[0.0], np.cumsum(steps)])
        if self._demands.eased:
            time, s = _average_speed(time, s, rate, min(_FIRST_RISE, 0.2 * time[-1]))
        else:
            grid = np.linspace(0.0, time[-1], 4 * _steps_of(time[-1]) + 1)
            # Linear in speed between the samples, from rest to rest.
            own = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(steps) - 1)
            local = grid - time[own]
            bend = (rate[own + 1] - rate[own]) / steps[own]
            time, s = grid, s[own] + local * (rate[own] + 0.5 * local * bend)
        s[[0, -1]] = 0.0, 1.0
        return _Law(time, s, self._demands.eased).with_nodes_at(path.knots)

    def _path_bounds(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rate [1/s] and acceleration [1/s^2] of s that use a share of each limit, (K,) each."""
        path, limits = self._path, self._limits
        q, d1, d2, d3 = (path(s, k) for k in range(4))
        a, b, c, tool = torque_rows(self._robot, q, d1, d2, self._forces(s))
        with np.errstate(divide="ignore", invalid="ignore"):
            left = np.maximum(limits.torque - np.abs(c) - self._robot.coulomb, 1e-2 * limits.torque)
            caps = [
                self._velocity(q) / np.abs(d1),
                np.sqrt(limits.acceleration / np.abs(d2)),
                np.cbrt(limits.jerk / np.abs(d3)),
                np.sqrt(left / np.abs(b)),
                (self._tool_speed(path.piece_index(s)) / tool)[:, None],
            ]
            pushes = [limits.acceleration / np.abs(d1), left / np.abs(a)]
        speed = np.fmin.reduce(np.hstack(caps), axis=1)
        if self._demands.path_speed is not None:
            speed = np.minimum(speed, self._demands.path_speed(s))
        push = np.fmin.reduce(np.hstack(pushes), axis=1)
        if not (np.isfinite(speed).all() and np.isfinite(push).all()):
            raise ProblemError(
                "the path has no fastest timing: no limit bounds the speed everywhere. Give "
                "limits of velocity, and of acceleration or torque."
            )
        return _FIRST_SHARE * speed, _FIRST_SHARE * push

    def tighten(self, law: _Law) -> None:
        """Tighten limits of acceleration and jerk in steps that exceed them between stages."""
        piece, count = self._pieces(law), len(law.time) - 1
        rates = [self._joint_motion(law.at(share), piece) for share in _CHECKED_STAGES]
        for order, name in ((2, "acceleration"), (3, "jerk")):
            limit = self._demands.share(name) * getattr(self._limits, name)
            used = np.max([np.abs(each[order]) / limit for each in rates], axis=(0, 2))
            near = np.maximum(np.append(used[1:], 0.0), np.append(0.0, used[:-1]))
            worst = np.maximum(np.maximum(used, near), 1.0)
            now = self._allowances.get(name, np.ones(count))
            self._allowances[name] = np.clip(now / worst, _LEAST_ALLOWANCE, now)

    def slowing(self, law: _Law) -> float:
        """Return the factor on the duration at which velocity, acceleration and jerk are kept."""
        limits, piece = self._limits, self._pieces(law)
        factor = 0.0
        for share in _CHECKED_STAGES:
            own = law.at(share)
            q, *rates = self._joint_motion(own, piece)
            bounds = (self._velocity(q), limits.acceleration, limits.jerk)
            names = ("velocity", "acceleration", "jerk")
            for order, (name, rate, bound) in enumerate(zip(names, rates, bounds, strict=True), 1):
                most = float(np.max(np.abs(rate) / bound)) / self._demands.share(name)
                factor = max(factor, most ** (1.0 / order))
        return factor

    def _pieces(self, law: _Law) -> np.ndarray:
        return self._path.piece_index(0.5 * (law.values[1:] + law.values[:-1]))

    def _joint_motion(self, law: np.ndarray, piece: np.ndarray) -> tuple[np.ndarray, ...]:
        """Position and three derivatives by time of the joints, (K, n) each."""
        v, a, j = (each[:, None] for each in law[1:])
        p0, p1, p2, p3 = (self._path.evaluate_piece(law[0], piece, k) for k in range(4))
        return p0, p1 * v, p2 * v**2 + p1 * a, p3 * v**3 + 3.0 * p2 * v * a + p1 * j

    def rescaled(self, law: _Law) -> _Law:
        """Return the timing of the programme at a timing."""
        rows, basis = self._rows(law)
        unknowns = len(law.time) + 1
        weights = np.zeros(unknowns)
        h = np.diff(law.time)
        for k in range(3):
            # Integral of each basis function over its step, by Simpson's rule.
            part = h * (basis[0][0, :, k] + 4.0 * basis[1][0, :, k] + basis[2][0, :, k]) / 6.0
            weights[k : k + len(h)] += part
        x = maximise(rows, weights, np.full(unknowns, 0.5))
        return _time_scaled(law, x)

    def _rows(self, law: _Law) -> tuple[BandedRows, list[np.ndarray]]:
        """Rows of the programme, and values of the basis at the stages, (3, K, 3) each."""
        basis = [_basis(law.time, share) for share in (0.0, 0.5, 1.0)]
        entries, bounds, first = [], [], []
        steps = np.arange(len(law.time) - 1)
        piece = self._pieces(law)
        for share in _STAGE_SHARES:
            value, slope, bend = _basis(law.time, share)
            own, bound = self._stage_rows(law.at(share), piece)
            entries.append(
                own[0][:, :, None] * value[:, None, :]
                + own[1][:, :, None] * slope[:, None, :]
                + own[2][:, :, None] * bend[:, None, :]
            )
            bounds.append(bound)
            first.append(steps)
        rows = BandedRows(
            np.concatenate(first), np.concatenate(entries), np.concatenate(bounds), len(steps) + 2
        )
        return rows, basis

    def _stage_rows(
        self, law: np.ndarray, piece: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """Factors of x, x', x'' in each row (K, R), and its bound; rows are relative to limits."""
        robot, limits, share = self._robot, self._limits, self._demands.share
        p0, dq, ddq, dddq = self._joint_motion(law, piece)
        zero = np.zeros_like(dq)
        columns: list[tuple[np.ndarray, ...]] = []
        bounds: list[np.ndarray] = []

        def bound_both(
            name: str,
            limit: np.ndarray,
            x: np.ndarray,
            x1: np.ndarray,
            x2: np.ndarray,
            fixed: np.ndarray,
            rest: np.ndarray,
        ) -> None:
            """Add |x X + x1 X' + x2 X'' + fixed| <= limit rest, of finite limits."""
            for k in np.flatnonzero(np.isfinite(limit)):
                allowed = share(name) * limit[k] * self._allowances.get(name, 1.0)
                for sign in (1.0, -1.0):
                    columns.append(tuple(sign * each[:, k] / allowed for each in (x, x1, x2)))
                    bounds.append(rest[:, k] - sign * fixed[:, k] / allowed)

        one = np.ones_like(dq)
        bound_both("acceleration", limits.acceleration, ddq, 0.5 * dq, zero, zero, one)
        # J / sqrt(x) >= J (3/2 - x/2).
        for k in np.flatnonzero(np.isfinite(limits.jerk)):
            allowed = share("jerk") * limits.jerk[k] * self._allowances.get("jerk", 1.0)
            for sign in (1.0, -1.0):
                parts = dddq[:, k], 1.5 * ddq[:, k], 0.5 * dq[:, k]
                own = [sign * each / allowed for each in parts]
                columns.append((own[0] + 0.5, own[1], own[2]))
                bounds.append(np.full(len(dq), 1.5))
        if np.isfinite(limits.torque).any():
            hold_a, hold_b, hold, tool = torque_rows(robot, p0, dq, ddq, self._forces(law[0]))
            # sqrt(x) <= (1 + x) / 2, exact where the sequence ends.
            viscous = 0.5 * robot.viscous * dq
            friction = robot.coulomb * np.sign(dq) + viscous
            bound_both(
                "torque", limits.torque, hold_b + viscous, 0.5 * hold_a, zero, hold + friction, one
            )
        else:
            tool = torque_rows(robot, p0, dq, ddq, self._forces(law[0]))[3]
        with np.errstate(divide="ignore"):
            ceilings = [
                np.min((share("velocity") * self._velocity(p0) / np.abs(dq)) ** 2, axis=1),
                (share("tool_speed") * self._tool_speed(piece) / tool) ** 2,
            ]
            if self._demands.path_speed is not None:
                ceilings.append((self._demands.path_speed(law[0]) / np.maximum(law[1], 0.0)) ** 2)
        ceiling = np.minimum(np.min(ceilings, axis=0), _LARGEST_SCALE)
        for sign, bound in ((1.0, ceiling), (-1.0, np.full(len(dq), -_LEAST_SCALE))):
            columns.append((np.full(len(dq), sign), zero[:, 0], zero[:, 0]))
            bounds.append(bound)
        x, x1, x2 = (np.stack(column, axis=1) for column in zip(*columns, strict=True))
        return (x, x1, x2), np.stack(bounds, axis=1)

    def _velocity(self, q: np.ndarray) -> np.ndarray:
        allowed = np.broadcast_to(self._limits.velocity, q.shape)
        if self._limits.velocity_map is not None:
            allowed = np.minimum(allowed, velocity_at(self._limits.velocity_map, q))
        return allowed

    def _tool_speed(self, piece: np.ndarray) -> np.ndarray:
        """Return the largest tool speed (K,) [m/s] on pieces of the path (K,)."""
        asked = np.full(len(piece), self._limits.tool_speed)
        return asked if self._path.speeds is None else np.minimum(asked, self._path.speeds[piece])

    def _forces(self, s: np.ndarray) -> np.ndarray:
        return (
            np.zeros(3) if self._demands.process_force is None else self._demands.process_force(s)
        )


def _steps_of(duration: float) -> int:
    return int(np.clip(np.ceil(duration / _LONGEST_STEP), _MIN_STEPS, _MAX_STEPS))


def _basis(time: np.ndarray, share: float) -> np.ndarray:
    """Quadratic B-splines on nodes with two derivatives, (3, K, 3): those of every step."""
    h = np.diff(time)
    before, after = np.append(0.0, h[:-1]), np.append(h[1:], 0.0)
    up, down = share * h, (1.0 - share) * h
    first, last = 1.0 / (h * (h + before)), 1.0 / (h * (h + after))
    value = np.stack([down**2 * first, up**2 * last], axis=1)
    slope = np.stack([-2.0 * down * first, 2.0 * up * last], axis=1)
    bend = np.stack([2.0 * first, 2.0 * last], axis=1)
    full = []
    for part, whole in ((value, 1.0), (slope, 0.0), (bend, 0.0)):
        middle = whole - part.sum(axis=1)
        full.append(np.stack([part[:, 0], middle, part[:, 1]], axis=1))
    return np.stack(full)


def _time_scaled(law: _Law, x: np.ndarray) -> _Law:
    """Return the law with its time rescaled by the B-spline coefficients x (K + 2,)."""
    h = np.diff(law.time)
    near = np.stack([x[k : k + len(h)] for k in range(3)], axis=1)
    spent = np.zeros_like(h)
    for point, weight in zip(_GAUSS_POINTS, _GAUSS_WEIGHTS, strict=True):
        value = np.sum(_basis(law.time, 0.5 * (1.0 + point))[0] * near, axis=1)
        spent += 0.5 * weight * h / np.sqrt(np.maximum(value, _LEAST_SCALE))
    return _Law(np.concatenate([[0.0], np.cumsum(spent)]), law.values, law.eased)


def _average_speed(
    time: np.ndarray, s: np.ndarray, rate: np.ndarray, window: float
) -> tuple[np.ndarray, np.ndarray]:
    """Average a speed profile, linear between times, over a window [s]; return times and s."""
    whole = time[-1] + window
    grid = np.linspace(0.0, whole, 4 * _steps_of(whole) + 1)
    span = np.diff(time)
    area = s[:-1] * span + rate[:-1] * span**2 / 2.0 + np.diff(rate) * span**2 / 6.0
    area = np.concatenate([[0.0], np.cumsum(area)])

    def integral(at: np.ndarray) -> np.ndarray:
        """Integral of s over time, at rest before and after."""
        inner = np.clip(at, 0.0, time[-1])
        k = np.clip(np.searchsorted(time, inner, side="right") - 1, 0, len(span) - 1)
        local = inner - time[k]
        bend = (rate[k + 1] - rate[k]) / span[k]
        found = area[k] + local * (s[k] + local * (rate[k] / 2.0 + local * bend / 6.0))
        return np.asarray(found + np.maximum(at - time[-1], 0.0) * s[-1])

    return grid, (integral(grid) - integral(grid - window)) / window
