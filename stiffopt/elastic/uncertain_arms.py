"""Batch simulation of arms with uncertain parameters on one planned motion.

Bodies are linearised about the plan, linear in the payload; springs keep their nonlinear law. Links
deviate by about 1e-3 rad from the plan, so neglected terms are of second order in that. Integrated
by the trapezoidal rule with the tangent of the springs in every step: stable for any stiffness.
Hysteresis is neglected. Elastic bearings are joints of their own (`BearingJoints`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.bearings import BearingJoints
from stiffopt.elastic.linearization import (
    LinearizedBodies,
    LinearizedWeight,
    TabulatedSprings,
    plan_torques,
)
from stiffopt.elastic.member_group import (
    DepartureArrays,
    MemberGroup,
    between,
    solve_equilibrium,
)
from stiffopt.elastic.modes import modes
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.uncertainty import Departure
from stiffopt.result.tool_error import ToolError, path_directions
from stiffopt.result.trajectory import JointMotion

# Time step [s], and least steps in a period of the lowest mode: with 100 the phase error of the
# trapezoidal rule is 1/30 rad in 15 periods.
_MAX_TIME_STEP = 1e-3
_STEPS_PER_PERIOD = 100
# Periods of the lowest mode simulated after arrival: the first peak is the largest.
_PERIODS_AFTER_ARRIVAL = 1.5
_MAX_TIME_AFTER_ARRIVAL = 1.0  # [s]
# What depends on the pose alone (static equilibria, Jacobians) is computed after each travel of a
# joint [rad] or [m], at most every so many steps, linear in between.
_POSE_TRAVEL, _POSE_STRIDE = 2e-3, 5
# One derivative of the bodies stands for steps in which position, velocity and acceleration change
# less than this [rad], [rad/s], [rad/s^2], at least for so many: peaks of an ER3A and a UR10 change
# by 3e-5 at most.
_BODY_CHANGES, _BODY_STRIDE = (2e-4, 1e-3, 0.02), 8
# Members and steps that are simulated at once: lanes of the compiled core, and positions of which
# some ten arrays stay in the processor's cache. Numbers of static equilibria that are kept.
_MEMBERS_AT_ONCE, _STEPS_AT_ONCE, _MAX_EQUILIBRIA = 16, 2048, 10_000_000
# Blocks of as many steps that searches simulate, beside the last one: those of the largest errors.
# Each is preceded by another one, a second in which vibration builds up.
_SEARCHED_BLOCKS = 5
# Blocks of a servo's response that are computed at once. They begin at multiples of a time [s] that
# set-points of the usual rates meet; the command is known as long after the end.
_SERVO_BLOCKS, _BEGIN_SPACING = 32, 0.04


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
        self._mark_phases()
        self._linearise_bodies(arm, plan, flight)
        self.springs, self.damping = TabulatedSprings(arm), arm.damping
        self.rigid = np.flatnonzero(~arm.elastic)
        self.start = LinearizedWeight(arm.at_first_instant(), self._q[:1])
        travel = np.abs(np.diff(self._q, axis=0)).max(axis=1) / _POSE_TRAVEL
        self._poses, self._travel = _change_places(travel, _POSE_STRIDE)
        self.weight = LinearizedWeight(arm, self._q[self._poses])
        self._jacobians = np.array(
            [arm.bodies.jacobian(arm.robot.tool, q).T for q in self._q[self._poses]]
        )
        self._direction = path_directions(arm.tool(self._q))
        # By command motions behind both servos and where they are known, of the last call; by
        # stiffness and payload planned static equilibria.
        self._followed: dict[MotorMotion, tuple[list[range], np.ndarray]] = {}
        # Runs of blocks of steps, one after another.
        self._whole = [range(-(-len(self.time) // _STEPS_AT_ONCE))]
        self._searched = self._whole
        self._equilibria: dict[tuple[bytes, float], np.ndarray] = {}

    def _mark_phases(self) -> None:
        """Find the steps of the flight and of the time from arrival on."""
        arrived = int(np.searchsorted(self.time, self.duration, side="left"))
        landed = int(np.searchsorted(self.time, self.duration, side="right"))
        self._phases = (slice(0, landed), slice(arrived, len(self.time)))

    def _linearise_bodies(self, arm: ElasticArm, plan: JointMotion, flight: np.ndarray) -> None:
        """Linearise the bodies about the flight, then at rest."""
        # Torques in the middle of every step; derivatives of the bodies in that of a span of them.
        n, middle = self._q.shape[1], 0.5 * (flight[:-1] + flight[1:])
        self.torques = np.empty((2, len(middle) + 1, n))
        changes = np.zeros(len(middle))
        last: list[np.ndarray] = []
        for own, poses in _parts_with_rest(plan, middle):
            self.torques[:, own] = plan_torques(arm, *poses)
            if arm.path_force is not None:
                forces = arm.path_force(np.append(middle, self.duration)[own])
                self.torques[0, own] -= [
                    arm.bodies.jacobian(arm.robot.tool, q)[:3].T @ force
                    for q, force in zip(poses[0], forces, strict=True)
                ]
            last = last or [pose[:1] for pose in poses]
            sizes = [
                np.abs(np.diff(pose, axis=0, prepend=before)).max(axis=1) / change
                for pose, before, change in zip(poses, last, _BODY_CHANGES, strict=True)
            ]
            changes[own] = np.max(sizes, axis=0)[: len(changes[own])]
            last = [pose[-1:] for pose in poses]
        spans = _change_places(changes[1:], _BODY_STRIDE)[0][:-1]
        self.span_of = np.searchsorted(spans, np.arange(len(middle)), side="right") - 1
        ends = np.append(spans[1:], len(middle))
        centres = 0.5 * (flight[spans] + flight[ends])
        self.bodies = np.empty((2, len(spans) + 1, n, 3 * n))
        for own, poses in _parts_with_rest(plan, centres):
            self.bodies[:, own] = self._trapezoidal_matrices(LinearizedBodies(arm, *poses))

    def simulate(self, members: Sequence[Member]) -> ToolError:
        """Simulate all members."""
        shape = len(members), len(self.time), 3
        position, orientation = np.empty(shape), np.empty(shape)
        for of, steps, error in self._errors(members):
            position[of, steps], orientation[of, steps] = error.position, error.orientation
        return self._tool_error(slice(None), position, orientation)

    def position_peaks(
        self, members: Sequence[Member], below: float = np.inf, *, searched: bool = False
    ) -> np.ndarray:
        """Largest position errors (2, B) of members, in flight and after arrival [m].

        Up to the instant from which on the sum of both phases' largest is not `below`; `searched`
        blocks alone (`search_where_worst`) on request, and before all others.
        """
        if not searched and np.isfinite(below) and self._searched != self._whole:
            found = self.position_peaks(members, below, searched=True)
            if not found.max(axis=1).sum() < below:
                return found
        found = np.zeros((2, len(members)))
        for _, largest in self._largest_errors(members, searched=searched):
            found = np.maximum(found, largest)
            if not found.max(axis=1).sum() < below:
                break
        return found

    def mixed_peaks(
        self,
        commands: Sequence[MotorMotion],
        departures: Sequence[Departure],
        weights: np.ndarray,
        below: float = np.inf,
        *,
        searched: bool = False,
    ) -> np.ndarray:
        """Peaks (c,) of weighted sums of two or four commands, in flight plus after arrival [m].

        Each phase's is that on the worst of the departures. `weights` (c, k) of the k commands.
        Errors are linear in the command where springs differ by a hundredth of their wind-up. Up to
        the instant from which on none is `below`, `searched` as for `position_peaks`.
        """
        if not searched and np.isfinite(below) and self._searched != self._whole:
            found = self.mixed_peaks(commands, departures, weights, below, searched=True)
            if not found.min() < below:
                return found
        members = [Member(command=own, departure=each) for each in departures for own in commands]
        first, second = np.triu_indices(len(commands))
        twice = np.where(first == second, 1.0, 2.0)
        products = twice * weights[:, first] * weights[:, second]
        squares = np.zeros((2, len(weights)))
        for of, steps, error in self._errors(members, 3, searched=searched):
            phases = self._phases_within(steps)
            shape = -1, len(commands), *error.position.shape[1:]
            for own in error.position.reshape(shape):
                pairs = np.einsum("pkx,pkx->pk", own[first], own[second])
                # Threads of a matrix product would cost more than they save.
                along = np.einsum("cp,pk->ck", products, pairs)
                for largest, phase in zip(squares, phases, strict=True):
                    np.maximum(largest, along[:, phase].max(axis=1, initial=0.0), out=largest)
            if of.stop == len(members) and not np.sqrt(squares).sum(axis=0).min() < below:
                break
        return np.asarray(np.sqrt(squares).sum(axis=0))

    def search_where_worst(self, members: Sequence[Member]) -> np.ndarray:
        """Return position peaks of members, and search from now on where they are largest."""
        found, blocks = np.zeros((2, len(members))), len(self._whole[0])
        worst = np.zeros(blocks + 1)
        for block, largest in self._largest_errors(members):
            found = np.maximum(found, largest)
            worst[block] = largest.max()
        chosen = np.isin(np.arange(blocks + 1), np.argsort(-worst)[:_SEARCHED_BLOCKS])
        chosen[-2:] = True, False
        chosen[:-1] |= chosen[1:]
        ends = np.flatnonzero(np.diff(chosen, prepend=False)).reshape(-1, 2)
        self._searched = [range(*each) for each in ends.tolist()]
        return found

    def _largest_errors(
        self, members: Sequence[Member], *, searched: bool = False
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Largest position errors (2, B) in each block of steps, in flight and after arrival."""
        found = np.zeros((2, len(members)))
        for of, steps, error in self._errors(members, 3, searched=searched):
            for peaks, phase in zip(found, self._phases_within(steps), strict=True):
                peaks[of] = error.peak(phase) if phase.stop > phase.start else 0.0
            if of.stop == len(members):
                yield steps.start // _STEPS_AT_ONCE, found.copy()

    def peaks(self, members: Sequence[Member]) -> list[dict[str, np.ndarray]]:
        """Peaks of members in flight and after arrival, as of `ToolError.peaks`."""
        found: list[dict[str, np.ndarray]] = [{}, {}]
        for of, steps, error in self._errors(members):
            for peaks, phase in zip(found, self._phases_within(steps), strict=True):
                if phase.stop > phase.start:
                    for name, own in error.peaks(phase).items():
                        known = peaks.setdefault(name, np.zeros(len(members)))
                        known[of] = np.maximum(known[of], own)
        return found

    def _phases_within(self, steps: slice) -> list[slice]:
        """Return the parts of both phases within steps, counted from the first of these."""
        return [
            slice(max(each.start - steps.start, 0), min(each.stop, steps.stop) - steps.start)
            for each in self._phases
        ]

    def _errors(
        self, members: Sequence[Member], axes: int = 6, *, searched: bool = False
    ) -> Iterator[tuple[slice, slice, ToolError]]:
        """Simulate members side by side: yield some of them, some steps and their tool errors.

        All members advance by as many steps before the next ones: memory does not grow with the
        number of members. With 3 axes positions alone; `searched` blocks alone on request.
        """
        runs = self._searched if searched else self._whole
        self._find_equilibria(self.departures(members))
        different = dict.fromkeys(each.command for each in members)
        self._followed = {own: self._behind_servos(own, runs) for own in different}
        groups = [
            MemberGroup(self, members, slice(first, min(first + _MEMBERS_AT_ONCE, len(members))))
            for first in range(0, len(members), _MEMBERS_AT_ONCE)
        ]
        for block in itertools.chain.from_iterable(runs):
            first = block * _STEPS_AT_ONCE
            steps = slice(first, min(first + _STEPS_AT_ONCE, len(self.time)))
            poses = self.interpolation(steps)
            along = between(self._jacobians[:, :, :axes], poses)
            for group in groups:
                if any(block == run.start for run in runs):
                    group.begin(first)
                away = (group.advance(steps) - group.equilibrium(poses)) @ along
                away = away.swapaxes(0, 1)
                yield group.of, steps, self._tool_error(steps, away[..., :3], away[..., 3:])

    def _tool_error(self, steps: slice, position: np.ndarray, orientation: np.ndarray) -> ToolError:
        return ToolError(
            time=self.time[steps],
            duration=self.duration,
            position=position,
            orientation=orientation,
            direction=self._direction[steps],
        )

    def interpolation(self, steps: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose before each step, and the share of the travel to the next one."""
        left = np.searchsorted(self._poses[1:-1], np.arange(steps.start, steps.stop), side="right")
        begin, end = self._travel[self._poses[left]], self._travel[self._poses[left + 1]]
        return left, (self._travel[steps] - begin) / np.maximum(end - begin, 1e-12)

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

    def motors(self, command: MotorMotion) -> np.ndarray:
        """Motion (K, 4, n) of a command of the members that are simulated.

        Position and velocity with the nominal servo less those of the plan, and the additions of
        the worst servo to both.
        """
        return self._followed[command][1]

    def _behind_servos(
        self, command: MotorMotion, runs: list[range]
    ) -> tuple[list[range], np.ndarray]:
        """Return runs of blocks with the motion of a command in them, as of `motors`."""
        known = self._followed.get(command)
        if known is not None and known[0] in (runs, self._whole):
            return known
        found = np.empty((len(self.time), 4, self._q.shape[1]))
        blocks = (
            run[k : k + _SERVO_BLOCKS] for run in runs for k in range(0, len(run), _SERVO_BLOCKS)
        )
        for some in blocks:
            steps = slice(
                max(some.start * _STEPS_AT_ONCE - 1, 0),
                min(some.stop * _STEPS_AT_ONCE, len(self.time)),
            )
            own = self._response(self._servo, command, steps)
            found[steps, :2] = own - np.stack([self._q[steps], self._v[steps]], axis=1)
            same = self._worst == self._servo
            worst = own if same else self._response(self._worst, command, steps)
            found[steps, 2:] = worst - own
        return runs, found

    def _response(self, servo: Follower, command: MotorMotion, steps: slice) -> np.ndarray:
        """Positions and velocities (K, 2, n) of the motors behind a servo at some steps."""
        if self._bearings is not None:
            command = self._bearings.motion(command)
        # As long a time before: the servo forgets how it began.
        time = self.time[steps]
        begin = time[0] - _STEPS_AT_ONCE * self.step
        begin = max(np.floor(begin / _BEGIN_SPACING) * _BEGIN_SPACING, 0.0)
        if begin > 0.0 or steps.stop < len(self.time):
            command, time = command.part(begin, time[-1] + _BEGIN_SPACING), time - begin
        command = servo.follow(command, time[-1], self._ahead)
        return np.stack([command(time), command(time, 1)], axis=1)

    def equilibria(self, departures: Sequence[Departure]) -> np.ndarray:
        """Planned static equilibria (M, B, n) of departures in the poses, less these."""
        keys = [_equilibrium_key(each) for each in departures]
        return np.stack([self._equilibria[each] for each in keys], axis=1)

    def _find_equilibria(self, departures: list[Departure]) -> None:
        """Find static equilibria with the motors at the planned positions.

        Those that differ in damping or servo share one.
        """
        alike = {_equilibrium_key(each): each for each in departures}
        turn = np.zeros(self._q[self._poses].shape)
        if len(self._equilibria | alike) * turn.size > _MAX_EQUILIBRIA:
            self._equilibria.clear()
        new = [own for own in alike if own not in self._equilibria]
        for first in range(0, len(new), _MEMBERS_AT_ONCE):
            own = new[first : first + _MEMBERS_AT_ONCE]
            arms = DepartureArrays([alike[each] for each in own])
            turns = np.repeat(turn[None], len(own), axis=0)
            found = solve_equilibrium(self.springs, self.weight, arms, turns)
            self._equilibria.update(zip(own, found, strict=True))


def _equilibrium_key(departure: Departure) -> tuple[bytes, float]:
    """Return what the static equilibrium of an arm depends on."""
    return departure.stiffness.tobytes(), departure.payload


def _change_places(changes: np.ndarray, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Return places (M,) from 0 to K after each unit of the changes (K,) between them.

    At most every `stride` places. And the sum (K + 1,) of the changes, of 1 / stride at most each.
    """
    total = np.concatenate([[0.0], np.cumsum(np.minimum(changes, 1.0 / stride))])
    # Rounding of the sum must not shift a place.
    found = np.flatnonzero(np.diff(np.floor(total + 1e-9), prepend=-1.0))
    return np.unique(np.append(found, len(changes))), total
