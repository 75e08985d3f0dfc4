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

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.baseline.path_limits import torque_rows
from stiffopt.errors import ProblemError
from stiffopt.path.banded_programme import BandedRows, maximise
from stiffopt.path.time_law import (
    LEAST_SCALE,
    TimeLaw,
    average_speed,
    basis_of,
    count_steps,
    time_scaled,
)
from stiffopt.problem.limits.joint_curve import allowed_torque, curve_at
from stiffopt.result.trajectory import Trajectory, join_motions
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.problem.limit import Limits
    from stiffopt.result.joint_path import JointPath
    from stiffopt.robot.robot import Robot

# Shares of a step at which limits hold.
_STAGE_SHARES = (0.0, 0.5, 1.0)
# Shares at which the last timing is checked.
_CHECKED_STAGES = (0.0, 0.25, 0.5, 0.75, 1.0)
# Programmes, and relative gain in duration below which they end.
_MAX_PROGRAMMES, _MIN_GAIN = 40, 1e-3
# Programmes after that, in which limits are tightened where the motion exceeds them between the
# stages, and the slowing from which on that is left out.
_MAX_POLISHINGS, _MAX_KEPT_SLOWING = 8, 1.0002
_LEAST_ALLOWANCE = 0.4
# Relative change of the duration below which the nodes are kept.
_NODE_CHANGE_GAIN = 0.05
# Limits that the programme keeps, and the power of the speed that each grows with.
_DERIVATIVE_ORDERS = {"velocity": 1, "tool_speed": 1, "acceleration": 2, "torque": 2, "jerk": 3}
# Largest turn of the joints' direction within a step [rad]: what limits allow turns with it.
_LARGEST_TURN = 0.05
# Largest x: the tangent of the jerk limit admits nothing above 3.
_LARGEST_SCALE = 2.9
# Use of a limit, nowhere exceeded at a stage, below which a programme leaves it out: at the largest
# x it would just be met, and the next programme sees where x' exceeds it.
_SMALL_USE = 1.0 / _LARGEST_SCALE
# Share of the limits that the first timing uses, and its time of rise to full acceleration [s].
_FIRST_SHARE, _FIRST_RISE = 0.5, 0.05
_PATH_SAMPLES_PER_PIECE, _MIN_PATH_SAMPLES = 8, 2000


@dataclass(frozen=True, kw_only=True, eq=False)
class PathDemands:
    """Demands on a timing along a path beside the limits of the joints."""

    # Largest rate (K,) [1/s] of the path parameter at path parameters (K,).
    path_speed: Callable[[np.ndarray], np.ndarray] | None = None
    # Force on the tool (K, 3) [N], base axes, at path parameters (K,).
    process_force: Callable[[np.ndarray], np.ndarray] | None = None
    # Shares (K,) of a limit that may be used, by the limit's name, at path parameters (K,).
    shares: Callable[[str, np.ndarray], np.ndarray] | None = None
    eased: bool = True  # the acceleration is zero at both ends

    def on(self, begin: float, end: float) -> PathDemands:
        """Return the demands on a part of the path, whose parameter runs from 0 to 1 again."""
        speed, force, shares = self.path_speed, self.process_force, self.shares
        span = end - begin
        return replace(
            self,
            path_speed=None if speed is None else lambda s: speed(begin + span * s) / span,
            process_force=None if force is None else lambda s: force(begin + span * s),
            shares=None if shares is None else lambda name, s: shares(name, begin + span * s),
        )

    def share(self, name: str, s: np.ndarray) -> np.ndarray:
        """Shares (K,) of a limit that may be used at path parameters (K,)."""
        return np.ones(len(s)) if self.shares is None else self.shares(name, s)


def fastest_timing(
    robot: Robot, limits: Limits, path: JointPath, demands: PathDemands | None = None
) -> Trajectory:
    """Return the fastest time law s(t) of a path within limits, at rest at its ends and stops."""
    return join_motions(PathTiming(robot, limits, path, demands).laws())


class PathTiming:
    """Fastest timing of a path within limits, at rest at its ends and stops.

    Joint velocity (with its map over position), acceleration, jerk, drive torque and tool speed,
    with that of each piece of the path.
    """

    def __init__(
        self, robot: Robot, limits: Limits, path: JointPath, demands: PathDemands | None = None
    ) -> None:
        asked = demands or PathDemands()
        self._dwells = [*path.dwells.tolist(), 0.0]
        self._parts = [
            (begin, end, _PartTiming(robot, limits, part, asked.on(begin, end)))
            for begin, end, part in path.between_stops()
        ]

    def laws(self) -> list[tuple[Trajectory, float]]:
        """Return the fastest law of each part between stops, with the rest after it [s].

        Where shares of the demands have changed since the last call, they are sought from its laws.
        Raises `ProblemError`: a torque limit is exceeded at rest on the path.
        """
        return [
            (_scaled_law(part.fastest_law(), begin, end), dwell)
            for (begin, end, part), dwell in zip(self._parts, self._dwells, strict=True)
        ]


def _scaled_law(law: Trajectory, begin: float, end: float) -> Trajectory:
    """Return a law from 0 to 1 as one from `begin` to `end`."""
    span = end - begin
    return Trajectory(law.times, span * law.acceleration, begin + span * law.q0, span * law.v0)


def slowing_within_limits(uses: Mapping[str, np.ndarray]) -> float:
    """Return the factor on the duration at which limits are kept that are used so far."""
    factors = [float(used.max()) ** (1.0 / _DERIVATIVE_ORDERS[name]) for name, used in uses.items()]
    return float(max(1.0, *factors))


class _PartTiming:
    """Programmes of a path without stops."""

    def __init__(self, robot: Robot, limits: Limits, path: JointPath, demands: PathDemands) -> None:
        self._robot, self._limits, self._path, self._demands = robot, limits, path, demands
        # Shares of the limits of acceleration and jerk that may be used in every step.
        self._allowances: dict[str, np.ndarray] = {}
        self._known: TimeLaw | None = None
        # Steps on each piece of the path at least, by how far its direction turns.
        begin, end = (
            path.evaluate_piece(s, np.arange(len(s)), 1) for s in (path.knots[:-1], path.knots[1:])
        )
        across = np.linalg.norm(begin, axis=1) * np.linalg.norm(end, axis=1)
        turn = np.arccos(np.clip(np.sum(begin * end, axis=1) / np.maximum(across, 1e-300), -1, 1))
        self._least_steps = np.maximum(np.ceil(turn / _LARGEST_TURN).astype(int), 1)

    def fastest_law(self) -> Trajectory:
        """Return the fastest law, sought from that of the last call."""
        law, settled = self._known or self.first_law(), self._known is not None
        ended, best = 0, None
        for _ in range(_MAX_PROGRAMMES):
            better = self.rescaled(law)
            gain = abs(1.0 - better.duration / law.duration)
            # New nodes would smear the jumps of the jerk: not near the optimum.
            settled = settled or gain < _NODE_CHANGE_GAIN
            law = better if settled else better.with_nodes_at(self._path.knots, self._least_steps)
            if not settled:
                continue
            uses = self.uses(law)
            slowed = law.duration * slowing_within_limits(uses)
            if best is None or slowed < best[1]:
                best = law, slowed
            ended += gain < _MIN_GAIN or ended > 0
            if ended > _MAX_POLISHINGS or (ended and slowed <= law.duration * _MAX_KEPT_SLOWING):
                break
            if ended:
                self.tighten(uses)
        law, slowed = best or (law, law.duration * slowing_within_limits(self.uses(law)))
        self._known = law
        return law.trajectory().scaled_to(slowed)

    def first_law(self) -> TimeLaw:
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
            time, s = average_speed(time, s, rate, min(_FIRST_RISE, 0.2 * time[-1]))
        else:
            grid = np.linspace(0.0, time[-1], 4 * count_steps(time[-1]) + 1)
            # Linear in speed between the samples, from rest to rest.
            own = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(steps) - 1)
            local = grid - time[own]
            bend = (rate[own + 1] - rate[own]) / steps[own]
            time, s = grid, s[own] + local * (rate[own] + 0.5 * local * bend)
        s[[0, -1]] = 0.0, 1.0
        law = TimeLaw(time, s, self._demands.eased)
        return law.with_nodes_at(path.knots, self._least_steps)

    def _path_bounds(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rate [1/s] and acceleration [1/s^2] of s that use a share of each limit, (K,) each."""
        path, limits = self._path, self._limits
        q, d1, d2, d3 = (path(s, k) for k in range(4))
        a, b, c, tool = torque_rows(self._robot, q, d1, d2, self._forces(s))
        self._check_hold(s, c + self._robot.coulomb * np.sign(d1))
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
            speed, push = (np.fmin.reduce(np.hstack(each), axis=1) for each in (caps, pushes))
        if self._demands.path_speed is not None:
            speed = np.minimum(speed, self._demands.path_speed(s))
        if not (np.isfinite(speed).all() and np.isfinite(push).all()):
            raise ProblemError(
                "the path has no fastest timing: no limit bounds the speed everywhere. Give "
                "limits of velocity, and of acceleration or torque."
            )
        return _FIRST_SHARE * speed, _FIRST_SHARE * push

    def _check_hold(self, s: np.ndarray, hold: np.ndarray) -> None:
        """Raise `ProblemError` where torques (K, n), however slow the motion, exceed a limit."""
        allowed = self._demands.share("torque", s)[:, None] * allowed_torque(
            self._limits, np.zeros_like(hold)
        )
        k, j = np.unravel_index(np.argmax(np.abs(hold) / allowed), hold.shape)
        if abs(hold[k, j]) > allowed[k, j]:
            unit = joint_unit("N m", bool(self._robot.prismatic[j]))
            raise ProblemError(
                f"at {100.0 * s[k]:.3g} % of the path weight, process force and dry friction take "
                f"{abs(hold[k, j]):.4g} {unit} at joint {j + 1}, above its torque limit of "
                f"{allowed[k, j]:.4g} {unit}, however slow the motion. Lighten the payload or the "
                "force, move the path or widen its freedom, or raise limits.torque."
            )

    def uses(self, law: TimeLaw) -> dict[str, np.ndarray]:
        """Largest use (K,) of each limit in every step, relative to it; of torque beside the hold.

        Above 1 where the motion exceeds the limit between the stages of the programme.
        """
        piece, limits = self._pieces(law), self._limits
        found: dict[str, np.ndarray] = dict.fromkeys(_DERIVATIVE_ORDERS, np.zeros(len(piece)))
        for stage in _CHECKED_STAGES:
            own = law.at(stage)
            q, *rates = self._joint_motion(own, piece)
            share = functools.partial(self._demands.share, s=own[0])
            _, moving, hold, tool = self._torques(own, q, rates[0], rates[1])
            sign = np.sign(hold + moving)
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios = {
                    "velocity": np.abs(rates[0]) / self._velocity(q),
                    "acceleration": np.abs(rates[1]) / limits.acceleration,
                    "jerk": np.abs(rates[2]) / limits.jerk,
                    "torque": sign
                    * moving
                    / (
                        share("torque")[:, None] * allowed_torque(self._limits, rates[0])
                        - sign * hold
                    ),
                    "tool_speed": (tool / self._tool_speed(piece))[:, None],
                }
            for name, ratio in ratios.items():
                used = np.max(np.nan_to_num(ratio, posinf=0.0), axis=1) / (
                    1.0 if name == "torque" else share(name)
                )
                found[name] = np.maximum(found[name], used)
        return found

    def tighten(self, uses: Mapping[str, np.ndarray]) -> None:
        """Tighten limits in steps that exceed them between stages."""
        for name, used in uses.items():
            near = np.maximum(np.append(used[1:], 0.0), np.append(0.0, used[:-1]))
            worst = np.maximum(np.maximum(used, near), 1.0)
            now = self._allowances.get(name, np.ones(len(used)))
            self._allowances[name] = np.clip(now / worst, _LEAST_ALLOWANCE, now)

    def _torques(
        self, law: np.ndarray, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Torques (K, n) by acceleration dq, of the motion, and of rest and dry friction.

        The tool speed (K,) comes last.
        """
        robot = self._robot
        pushing, moving, hold, tool = torque_rows(robot, q, dq, ddq, self._forces(law[0]))
        dry = robot.coulomb * np.sign(dq)
        return pushing, moving + robot.viscous * dq, hold + dry, tool

    def _pieces(self, law: TimeLaw) -> np.ndarray:
        return self._path.piece_index(0.5 * (law.values[1:] + law.values[:-1]))

    def _joint_motion(self, law: np.ndarray, piece: np.ndarray) -> tuple[np.ndarray, ...]:
        """Position and three derivatives by time of the joints, (K, n) each."""
        v, a, j = (each[:, None] for each in law[1:])
        p0, p1, p2, p3 = (self._path.evaluate_piece(law[0], piece, k) for k in range(4))
        return p0, p1 * v, p2 * v**2 + p1 * a, p3 * v**3 + 3.0 * p2 * v * a + p1 * j

    def rescaled(self, law: TimeLaw) -> TimeLaw:
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
        return time_scaled(law, x)

    def _rows(self, law: TimeLaw) -> tuple[BandedRows, list[np.ndarray]]:
        """Rows of the programme, and values of the basis at the stages, (3, K, 3) each."""
        basis = [basis_of(law.time, share) for share in (0.0, 0.5, 1.0)]
        entries, bounds = [], []
        piece = self._pieces(law)
        for share in _STAGE_SHARES:
            value, slope, bend = basis_of(law.time, share)
            own, bound = self._stage_rows(law.at(share), piece)
            # Rows of a stage, entries of each basis function (3, R, K).
            entries.append(
                value.T[:, None] * own[0] + slope.T[:, None] * own[1] + bend.T[:, None] * own[2]
            )
            bounds.append(bound)
        rows = BandedRows(np.concatenate(entries, axis=1), np.concatenate(bounds))
        return rows, basis

    def _stage_rows(
        self, law: np.ndarray, piece: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """Factors of x, x', x'' in each row (R, K), and its bound; rows are relative to limits."""
        limits, share = self._limits, functools.partial(self._demands.share, s=law[0])
        p0, dq, ddq, dddq = self._joint_motion(law, piece)
        zero = np.zeros_like(dq)
        columns: list[tuple[np.ndarray, ...]] = []
        bounds: list[np.ndarray] = []

        def allowance(name: str) -> np.ndarray:
            return self._allowances.get(name, np.ones(len(dq)))

        def bound_both(
            name: str, limit: np.ndarray, x: np.ndarray, x1: np.ndarray, fixed: np.ndarray
        ) -> None:
            """Add |x X + x1 X' + fixed| <= limit (K, n), of finite limits."""
            for k in np.flatnonzero(np.isfinite(limit).all(axis=0)):
                allowed = share(name) * limit[:, k]
                for sign in (1.0, -1.0):
                    if (sign * (x + fixed)[:, k] / allowed).max() < _SMALL_USE:
                        continue
                    columns.append(tuple(sign * each[:, k] / allowed for each in (x, x1, zero)))
                    bounds.append(allowance(name) * (1.0 - sign * fixed[:, k] / allowed))

        bound_both("acceleration", limits.acceleration + zero, ddq, 0.5 * dq, zero)
        # J / sqrt(x) >= J (3/2 - x/2).
        for k in np.flatnonzero(np.isfinite(limits.jerk)):
            allowed = share("jerk") * limits.jerk[k] * allowance("jerk")
            for sign in (1.0, -1.0):
                if (sign * dddq[:, k] / allowed).max() < _SMALL_USE:
                    continue
                parts = dddq[:, k], 1.5 * ddq[:, k], 0.5 * dq[:, k]
                own = [sign * each / allowed for each in parts]
                columns.append((own[0] + 0.5, own[1], own[2]))
                bounds.append(np.full(len(dq), 1.5))
        pushing, moving, hold, tool = self._torques(law, p0, dq, ddq)
        # sqrt(x) <= (1 + x) / 2, exact where the sequence ends.
        viscous = 0.5 * self._robot.viscous * dq
        # The curve of the torque over speed at the present one: exact where the sequence ends.
        torque = allowed_torque(self._limits, dq)
        bound_both("torque", torque, moving - viscous, 0.5 * pushing, hold + viscous)
        with np.errstate(divide="ignore"):
            joints = share("velocity") * (self._velocity(p0) / np.abs(dq)).min(axis=1)
            ceilings = [
                (allowance("velocity") * joints) ** 2,
                (allowance("tool_speed") * share("tool_speed") * self._tool_speed(piece) / tool)
                ** 2,
            ]
            if self._demands.path_speed is not None:
                ceilings.append((self._demands.path_speed(law[0]) / np.maximum(law[1], 0.0)) ** 2)
        ceiling = np.minimum(np.min(ceilings, axis=0), _LARGEST_SCALE)
        for sign, bound in ((1.0, ceiling), (-1.0, np.full(len(dq), -LEAST_SCALE))):
            columns.append((np.full(len(dq), sign), zero[:, 0], zero[:, 0]))
            bounds.append(bound)
        x, x1, x2 = (np.stack(column) for column in zip(*columns, strict=True))
        return (x, x1, x2), np.stack(bounds)

    def _velocity(self, q: np.ndarray) -> np.ndarray:
        allowed = np.broadcast_to(self._limits.velocity, q.shape)
        if self._limits.velocity_map is not None:
            allowed = np.minimum(allowed, curve_at(self._limits.velocity_map, q))
        return allowed

    def _tool_speed(self, piece: np.ndarray) -> np.ndarray:
        """Return the largest tool speed (K,) [m/s] on pieces of the path (K,)."""
        asked = np.full(len(piece), self._limits.tool_speed)
        return asked if self._path.speeds is None else np.minimum(asked, self._path.speeds[piece])

    def _forces(self, s: np.ndarray) -> np.ndarray:
        return (
            np.zeros(3) if self._demands.process_force is None else self._demands.process_force(s)
        )
