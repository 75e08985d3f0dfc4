"""Batch simulation of arms with uncertain parameters on one planned motion.

Bodies are linearised about the plan, linear in the payload; springs keep their nonlinear law. Links
deviate by about 1e-3 rad from the plan, so neglected terms are of second order in that. Integrated
by the trapezoidal rule with the tangent of the springs in every step: stable for any stiffness.
Hysteresis is neglected. Elastic bearings are joints of their own (`BearingJoints`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from stiffopt.elastic import native
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.bearings import BearingJoints
from stiffopt.elastic.modes import modes
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.uncertainty import Departure
from stiffopt.result.tool_error import ToolError, path_directions
from stiffopt.result.trajectory import JointMotion

if TYPE_CHECKING:
    from ctypes import CDLL

    from stiffopt.robot.robot import Robot


# Time step [s], and least steps in a period of the lowest mode: with 100 the phase error of the
# trapezoidal rule is 1/30 rad in 15 periods.
_MAX_TIME_STEP = 1e-3
_STEPS_PER_PERIOD = 100
# Periods of the lowest mode simulated after arrival: the first peak is the largest.
_PERIODS_AFTER_ARRIVAL = 1.5
_MAX_TIME_AFTER_ARRIVAL = 1.0  # [s]
# The static equilibrium changes slowly: computed every so many steps, linear in between.
_EQUILIBRIUM_STRIDE = 5
_EQUILIBRIUM_ITERATIONS = 4
# Most positions of links for which motors' motions are kept, and of static equilibria: a weld of
# minutes has 1e8 of them with its arms. Members that are simulated at once: lanes of the compiled
# core, of whose positions some ten arrays stay in the processor's cache.
_MAX_POSITIONS, _MEMBERS_AT_ONCE = 2_000_000, 8
# Steps whose bodies are linearised at once, and for which one derivative of the bodies stands:
# they take an eighth of the memory then, and peaks of an ER3A and a UR10 change by 3e-5 at most.
_STEPS_AT_ONCE, _BODY_STRIDE = 4096, 8
_SPRING_TABLE_POINTS = 20001  # of each joint's law, equidistant in wind-up


class LinearizedBodies:
    """Linearised bodies at instants of a motion: first all bodies, then the payload alone.

    Parameters
    ----------
    arm : ElasticArm
    q, v, a : array (K, n)
        Motion of the links, point of linearisation.

    Attributes
    ----------
    by_q, by_v, inertia : array (2, K, n, n)
        Derivatives of the torque by position, velocity and acceleration.
    """

    def __init__(self, arm: ElasticArm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        whole = [
            robot.bodies_in_motion().torque_slopes(q, v, a)
            for robot in _robot_and_heavier_payload(arm)
        ]
        self.by_q, self.by_v, self.inertia = _split_payload(whole)


class LinearizedWeight:
    """Linearised weight in poses (K, n): first all bodies, then the payload alone.

    Attributes
    ----------
    torque : array (2, K, n)
        Static spring torque [N m].
    by_q : array (2, K, n, n)
        Derivative by position.
    """

    def __init__(self, arm: ElasticArm, q: np.ndarray) -> None:
        whole = []
        for robot in _robot_and_heavier_payload(arm):
            bodies = robot.rigid_bodies()
            weight = np.array([bodies.gravity_torque(row) for row in q])
            whole.append((weight, np.array([bodies.weight_slope(row) for row in q])))
        self.torque, self.by_q = _split_payload(whole)
        self.torque[0] -= arm.force_torque(q)


def _robot_and_heavier_payload(arm: ElasticArm) -> list[Robot]:
    robot = arm.robot
    return [robot] if robot.payload is None else [robot, robot.with_payload_times(2.0)]


def _split_payload(whole: Sequence[tuple[np.ndarray, ...]]) -> list[np.ndarray]:
    heavier = whole[-1]
    return [np.stack([own, more - own]) for own, more in zip(whole[0], heavier, strict=True)]


def _plan_torques(arm: ElasticArm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Inverse dynamics (2, K, n) of a motion less the torque of the process force [N m].

    First of all bodies, then of the payload alone.
    """
    whole = [
        (robot.bodies_in_motion().torque(q, v, a),) for robot in _robot_and_heavier_payload(arm)
    ]
    (torque,) = _split_payload(whole)
    torque[0] -= arm.force_torque(q)
    return torque


def _parts_with_rest(
    plan: JointMotion, times: np.ndarray
) -> Iterator[tuple[slice, tuple[np.ndarray, ...]]]:
    """Parts of the times (K,) and of the rest after them, with position, velocity, acceleration."""
    for first in range(0, len(times) + 1, _STEPS_AT_ONCE):
        own = slice(first, first + _STEPS_AT_ONCE)
        poses = [plan(times[own], k) for k in range(3)]
        if own.stop > len(times):
            end = plan(np.array([plan.duration]))
            ends = (end, np.zeros_like(end), np.zeros_like(end))
            poses = [np.concatenate(each) for each in zip(poses, ends, strict=True)]
        yield own, tuple(poses)


class TabulatedSprings:
    """Springs of all joints tabulated on equidistant wind-ups; zero for rigid joints."""

    def __init__(self, arm: ElasticArm) -> None:
        self._arm, self._half = arm, (_SPRING_TABLE_POINTS - 1) // 2
        reach = np.array([1.0 if s is None else s.windup_reach for s in arm.springs])
        windups = np.linspace(-reach, reach, _SPRING_TABLE_POINTS)
        table = np.array(
            [
                np.zeros(_SPRING_TABLE_POINTS) if spring is None else spring.torque(windup)
                for spring, windup in zip(arm.springs, windups.T, strict=True)
            ]
        )
        self._scale = self._half / reach
        self._torque, self._rise = table.ravel(), np.diff(table, append=table[:, -1:]).ravel()
        self._offset = _SPRING_TABLE_POINTS * np.arange(len(reach))

    def table(self) -> dict[str, np.ndarray | int]:
        """Torques and differences to the next point (n points,), points per radian (n,)."""
        numbers = {"torque": self._torque, "rise": self._rise, "scale": self._scale}
        return {**numbers, "points": _SPRING_TABLE_POINTS}

    def at(self, windup: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torques [N m] and tangent stiffnesses [N m/rad] at wind-ups, (B, n) each."""
        place = windup * self._scale + self._half
        # Linear extrapolation beyond the table.
        cell = np.minimum(np.maximum(place.astype(np.int64), 0), 2 * self._half - 1)
        at = cell + self._offset
        rise = self._rise[at]
        return self._torque[at] + (place - cell) * rise, rise * self._scale

    def torque(self, windup: np.ndarray) -> np.ndarray:
        """Torques [N m] at wind-ups, (B, n) each."""
        return self.at(windup)[0]

    def windup(self, torque: np.ndarray) -> np.ndarray:
        """Wind-ups [rad] at torques, (.., n) each; the inverse of `torque`."""
        return self._arm.windup(torque.reshape(-1, torque.shape[-1])).reshape(torque.shape)


@dataclass(frozen=True, kw_only=True, eq=False)
class Member:
    """One simulated arm: a command and a departure of its parameters."""

    command: MotorMotion  # motion of the motors
    departure: Departure  # parameters of the arm


class Follower(Protocol):
    """Motors' response to a command, as of `Servo`."""

    def follow(self, command: MotorMotion, until: float, ahead: float = 0.0) -> MotorMotion:
        """Return the motion of the motors until a time [s]."""


class UncertainArms:
    """Arms of a robot with uncertain parameters, linearised along one planned motion.

    Parameters
    ----------
    arm : ElasticArm
        Nominal arm.
    plan : JointMotion
        At rest at both ends; its second derivative is used.
    servo, worst : Follower, optional
        The nominal and the worst servo; each departure has a share of the difference of their
        responses. Default one that follows exactly, and the nominal one.
    ahead : float
        Time by which set-points are sent ahead [s].
    """

    def __init__(
        self,
        arm: ElasticArm,
        plan: JointMotion,
        servo: Follower | None = None,
        worst: Follower | None = None,
        ahead: float = 0.0,
    ) -> None:
        self._servo: Follower = servo or Servo()
        self._worst, self._ahead = worst or self._servo, ahead
        self.duration = plan.duration
        start = plan(np.zeros(1))[0]
        self._bearings = BearingJoints(arm, start) if arm.robot.tilts else None
        if self._bearings is not None:
            arm, plan = self._bearings.arm, self._bearings.motion(plan)
            start = plan(np.zeros(1))[0]
        slowest = min((mode.frequency for mode in modes(arm, start)), default=1.0)
        count = int(
            np.ceil(self.duration / min(_MAX_TIME_STEP, 1.0 / (_STEPS_PER_PERIOD * slowest)))
        )
        self.step = self.duration / count
        flight = np.minimum(self.step * np.arange(count + 1), self.duration)
        rest = (
            int(np.ceil(min(_PERIODS_AFTER_ARRIVAL / slowest, _MAX_TIME_AFTER_ARRIVAL) / self.step))
            + 1
        )
        self.time = np.concatenate([flight, self.duration + self.step * np.arange(1, rest + 1)])
        self._q, self._v = (
            self._extend_at_rest(plan(flight)),
            self._extend_at_rest(plan(flight, 1), 0.0),
        )
        # Torques in the middle of every step of the flight, then at rest; derivatives of the bodies
        # in the middle of every few of them.
        n, middle = self._q.shape[1], 0.5 * (flight[:-1] + flight[1:])
        self.torques = np.empty((2, len(middle) + 1, n))
        for own, poses in _parts_with_rest(plan, middle):
            self.torques[:, own] = _plan_torques(arm, *poses)
            if arm.path_force is not None:
                forces = arm.path_force(np.append(middle, self.duration)[own])
                self.torques[0, own] -= [
                    arm.bodies.jacobian(arm.robot.tool, q)[:3].T @ force
                    for q, force in zip(poses[0], forces, strict=True)
                ]
        self.stride = _BODY_STRIDE
        firsts = np.arange(0, count, self.stride)
        middle = 0.5 * (flight[firsts] + flight[np.minimum(firsts + self.stride, count)])
        self.bodies = np.empty((2, len(middle) + 1, n, 3 * n))
        for own, poses in _parts_with_rest(plan, middle):
            self.bodies[:, own] = self._trapezoidal_matrices(LinearizedBodies(arm, *poses))
        self.springs, self.damping = TabulatedSprings(arm), arm.damping
        self.rigid = np.flatnonzero(~arm.elastic)
        self._start = LinearizedWeight(arm.at_first_instant(), self._q[:1])
        steps = np.arange(0, len(self.time), _EQUILIBRIUM_STRIDE)
        self._equilibrium_samples = np.unique(np.append(steps, len(self.time) - 1))
        self._weight = LinearizedWeight(arm, self._q[self._equilibrium_samples])
        self._jacobian = self._extend_at_rest(
            np.array([arm.bodies.jacobian(arm.robot.tool, q) for q in self._q[: count + 1]])
        )
        self._direction = path_directions(arm.tool(self._q))
        # By command motions behind both servos, of the last batch; by stiffness and payload planned
        # static equilibria.
        self._followed: dict[MotorMotion, np.ndarray] = {}
        self._equilibria: dict[tuple[bytes, float], np.ndarray] = {}

    def simulate(self, members: Sequence[Member]) -> ToolError:
        """Simulate all members."""
        found = list(self._simulate_in_batches(members))
        return replace(
            found[0],
            position=np.concatenate([each.position for each in found]),
            orientation=np.concatenate([each.orientation for each in found]),
        )

    def position_peaks(self, members: Sequence[Member], below: float = np.inf) -> np.ndarray:
        """Largest position errors (2, B) of members, in flight and after arrival [m].

        Of the first members alone where the sum of both phases' largest is not `below` for them.
        """
        found = np.empty((2, 0))
        for each in self._simulate_in_batches(members, axes=3):
            own = [each.peak(each.flight), each.peak(each.after)]
            found = np.concatenate([found, own], axis=1)
            if not found.max(axis=1).sum() < below:
                break
        return found

    def peaks(self, members: Sequence[Member]) -> list[dict[str, np.ndarray]]:
        """Peaks of members in flight and after arrival, as of `ToolError.peaks`."""
        found = [(e.peaks(e.flight), e.peaks(e.after)) for e in self._simulate_in_batches(members)]
        return [
            {name: np.concatenate([each[name] for each in phase]) for name in phase[0]}
            for phase in zip(*found, strict=True)
        ]

    def _simulate_in_batches(self, members: Sequence[Member], axes: int = 6) -> Iterator[ToolError]:
        """Simulate as many members at a time as the memory is for; 3 axes for positions alone."""
        made = native.core(len(self.damping))
        for kept in _batches(members, _MAX_POSITIONS // self._q.size):
            self._find_equilibria(self.departures(kept))
            different = dict.fromkeys(each.command for each in kept)
            self._followed = {own: self._behind_servos(own) for own in different}
            for part in _batches(kept, _MEMBERS_AT_ONCE):
                links = (
                    _integrate_numpy(self, part)
                    if made is None
                    else _integrate_compiled(made, self, part)
                )
                yield self.tool_error(part, links, axes)

    def _extend_at_rest(self, values: np.ndarray, at_rest: float | None = None) -> np.ndarray:
        """Append the last values of the flight, or `at_rest`, until the end."""
        last = values[-1:] if at_rest is None else np.full_like(values[-1:], at_rest)
        return np.concatenate([values, np.repeat(last, len(self.time) - len(values), axis=0)])

    def _trapezoidal_matrices(self, bodies: LinearizedBodies) -> np.ndarray:
        """Coefficients of the bodies in the equation of a step (2, K, n, 3 n).

        Columns of the velocity at its end, and of velocity and position at its start.
        """
        step = self.step
        inertia, turning = bodies.inertia / step, 0.5 * bodies.by_v + 0.25 * step * bodies.by_q
        return np.concatenate([inertia + turning, inertia - turning, -bodies.by_q], axis=3)

    def departures(self, members: Sequence[Member]) -> list[Departure]:
        """Departures of members, of all joints with those of elastic bearings."""
        own = [each.departure for each in members]
        if self._bearings is None:
            return own
        alike = {id(each): self._bearings.departure(each) for each in own}
        return [alike[id(each)] for each in own]

    def motors(self, commands: Sequence[MotorMotion]) -> tuple[np.ndarray, np.ndarray]:
        """Motions (K, C, 4, n) of the distinct commands, and the index of each member's (B,).

        Position and velocity with the nominal servo less those of the plan, and the additions of
        the worst servo to both.
        """
        different = list(dict.fromkeys(commands))
        places = {command: c for c, command in enumerate(different)}
        found = np.stack([self._behind_servos(command) for command in different], axis=1)
        return found, np.array([places[command] for command in commands])

    def _behind_servos(self, command: MotorMotion) -> np.ndarray:
        """Motion (K, 4, n) of one command, as of `motors`."""
        if command in self._followed:
            return self._followed[command]
        own = self._response(self._servo, command)
        same = self._worst == self._servo
        added = np.zeros_like(own) if same else self._response(self._worst, command) - own
        return np.concatenate([own - np.stack([self._q, self._v], axis=1), added], axis=1)

    def _response(self, servo: Follower, command: MotorMotion) -> np.ndarray:
        """Positions and velocities (K, 2, n) of the motors behind a servo."""
        if self._bearings is not None:
            command = self._bearings.motion(command)
        command = servo.follow(command, self.time[-1], self._ahead)
        return np.stack([command(self.time), command(self.time, 1)], axis=1)

    def initial_equilibrium(self, arms: _DepartureArrays, turn: np.ndarray) -> np.ndarray:
        """Static equilibrium (B, n) with the motors `turn` ahead of the start of the plan."""
        return _solve_equilibrium(self.springs, self._start, arms, turn[:, None])[:, 0]

    def tool_error(self, members: Sequence[Member], links: np.ndarray, axes: int = 6) -> ToolError:
        """Tool errors of members, for link positions less the plan (K, B, n)."""
        keys = [_equilibrium_key(each) for each in self.departures(members)]
        places = {own: place for place, own in enumerate(dict.fromkeys(keys))}
        equilibrium = np.array([self._equilibria[own] for own in places])
        # One matrix product for all members: einsum would loop over them.
        along = np.ascontiguousarray(self._jacobian[:, :axes].swapaxes(1, 2))
        away = links @ along
        own = [places[each] for each in keys]
        away -= np.take(equilibrium.swapaxes(0, 1) @ along, own, axis=1)
        away = away.swapaxes(0, 1)
        return ToolError(
            time=self.time,
            duration=self.duration,
            position=away[..., :3],
            orientation=away[..., 3:],
            direction=self._direction,
        )

    def _find_equilibria(self, departures: list[Departure]) -> None:
        """Find static equilibria with the motors at the planned positions, less these.

        Those that differ in damping or servo share one.
        """
        alike = {_equilibrium_key(each): each for each in departures}
        if len(self._equilibria | alike) * self._q.size > _MAX_POSITIONS:
            self._equilibria.clear()
        new = [own for own in alike if own not in self._equilibria]
        if not new:
            return
        arms, chosen = _DepartureArrays([alike[own] for own in new]), self._equilibrium_samples
        turn, every = np.zeros((len(new), *self._q[chosen].shape)), np.arange(len(self.time))
        coarse = _solve_equilibrium(self.springs, self._weight, arms, turn)
        right = np.clip(np.searchsorted(chosen, every), 1, len(chosen) - 1)
        left = right - 1
        share = ((every - chosen[left]) / (chosen[right] - chosen[left]))[:, None]
        between = (1.0 - share) * coarse[:, left] + share * coarse[:, right]
        self._equilibria.update(zip(new, between, strict=True))


def _equilibrium_key(departure: Departure) -> tuple[bytes, float]:
    """Return what the static equilibrium of an arm depends on."""
    return departure.stiffness.tobytes(), departure.payload


def _batches(members: Sequence[Member], size: int) -> Iterator[Sequence[Member]]:
    """Yield members, `size` at a time, one at least."""
    for first in range(0, len(members), max(1, size)):
        yield members[first : first + max(1, size)]


def _integrate_compiled(core: CDLL, many: UncertainArms, members: Sequence[Member]) -> np.ndarray:
    """Integrate to link positions less the plan (K, B, n)."""
    arms = _DepartureArrays(many.departures(members))
    moved, of = many.motors([member.command for member in members])
    return native.integrate_linearized(
        core,
        many.springs,
        many.rigid,
        many.initial_equilibrium(arms, moved[0, of, 0]),
        count=len(many.time),
        flight=many.torques.shape[1],
        stride=many.stride,
        spans=many.bodies.shape[1],
        commands=moved.shape[1],
        step=many.step,
        bodies=many.bodies,
        torques=many.torques,
        commanded=moved,
        of=of,
        stiffness=arms.stiffness,
        damping=arms.damping * many.damping,
        payload=arms.payload,
        servo=arms.servo,
    )


def _integrate_numpy(many: UncertainArms, members: Sequence[Member]) -> np.ndarray:
    """Integrate without the compiled core, to the same result."""
    arms, rigid = _DepartureArrays(many.departures(members)), many.rigid
    moved, of = many.motors([member.command for member in members])
    damping, step, joints = arms.damping * many.damping, many.step, np.arange(len(many.damping))
    turn, e = moved[0, of, 0], many.initial_equilibrium(arms, moved[0, of, 0])
    rate, drive = np.zeros_like(e), np.zeros_like(e)
    found = [e]
    for k in range(1, len(many.time)):
        flies = k < many.torques.shape[1]
        own, more = many.bodies[:, (k - 1) // many.stride if flies else -1]
        planned, heavier = many.torques[:, k - 1 if flies else -1]
        bodies = own + arms.payload[..., None] * more
        right = np.einsum("bij,bj->bi", bodies[:, :, len(joints) :], np.hstack([rate, e]))
        before = arms.stiffness * many.springs.torque(turn - e) + damping * (drive - rate)
        now = moved[k, of]
        turn = now[:, 0] + arms.servo * now[:, 2]
        drive = now[:, 1] + arms.servo * now[:, 3]
        # Springs at the predicted position, linear from there to the end of the step.
        torque, tangent = many.springs.at(turn - e - step * rate)
        torque, tangent = arms.stiffness * torque, arms.stiffness * tangent
        ahead = torque + 0.5 * step * tangent * rate + damping * drive
        right += 0.5 * (before + ahead) - (planned + arms.payload * heavier)
        left = bodies[:, :, : len(joints)]
        left[:, joints, joints] += 0.5 * damping + 0.25 * step * tangent
        # Rigid joints follow their motors.
        left[:, rigid], left[:, rigid, rigid], right[:, rigid] = 0.0, 1.0, drive[:, rigid]
        new = np.linalg.solve(left, right[..., None])[..., 0]
        e, rate = e + 0.5 * step * (rate + new), new
        e[:, rigid] = turn[:, rigid]
        found.append(e)
    return np.array(found)


class _DepartureArrays:
    """Departures as arrays: stiffness (B, n), the others (B, 1)."""

    def __init__(self, departures: Sequence[Departure]) -> None:
        self.stiffness = np.array([each.stiffness for each in departures])
        self.damping = np.array([[each.damping] for each in departures])
        self.payload = np.array([[each.payload - 1.0] for each in departures])
        self.servo = np.array([[each.servo] for each in departures])


def _solve_equilibrium(
    springs: TabulatedSprings, weight: LinearizedWeight, arms: _DepartureArrays, turn: np.ndarray
) -> np.ndarray:
    """Static equilibrium (B, K, n) with the motors `turn` ahead of the poses of the weight."""
    static = weight.torque[0] + arms.payload[..., None] * weight.torque[1]
    stiffness = arms.stiffness[:, None]
    e = turn - springs.windup(static / stiffness)
    for _ in range(_EQUILIBRIUM_ITERATIONS - 1):
        # One matrix product per pose for all arms and payloads.
        own, more = ((e.swapaxes(0, 1) @ by.swapaxes(1, 2)).swapaxes(0, 1) for by in weight.by_q)
        e = turn - springs.windup((static + own + arms.payload[..., None] * more) / stiffness)
    return np.asarray(e)
