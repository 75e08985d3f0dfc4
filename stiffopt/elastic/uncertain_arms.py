"""Many arms on one planned motion at once, linearised about the plan.

Bodies are linearised about the planned motion, payloads in proportion; springs keep their law.
Links leave the plan by a thousandth of a radian, so that what is neglected is as small. Integrated
by the trapezoidal rule, the springs at their tangent from step to step: stable however stiff a
joint is. Hysteresis is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.elastic import native
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.elastic.motor import MotorMotion, Servo
from stiffopt.elastic.uncertainty import Departure
from stiffopt.result.trajectory import JointMotion

if TYPE_CHECKING:
    from ctypes import CDLL

    from stiffopt.robot.robot import Robot


_SPRING_TABLE_POINTS = 20001


class LinearizedBodies:
    """Links and payload about instants of a motion: quantities of all bodies, then of the payload.

    Parameters
    ----------
    arm : ElasticArm
    q, v, a : array (K, n)
        Motion of the links about which is linearised.

    Attributes
    ----------
    torque : array (2, K, n)
        Needed for the motion, less what the process force does [N m].
    by_q, by_v, inertia : array (2, K, n, n)
        Its derivatives by position, velocity and acceleration.
    """

    def __init__(self, arm: ElasticArm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        whole = [_linearize_dynamics(robot, q, v, a) for robot in _robot_and_heavier_payload(arm)]
        self.torque, self.by_q, self.by_v, self.inertia = _split_payload(whole)
        self.torque[0] -= [arm.force_torque(row) for row in q]


class LinearizedWeight:
    """Weight of links and payload in poses (K, n), in the same parts.

    Attributes
    ----------
    held : array (2, K, n)
        Torque in the springs at rest [N m].
    by_q : array (2, K, n, n)
        Its derivative by position.
    """

    def __init__(self, arm: ElasticArm, q: np.ndarray) -> None:
        whole = []
        for robot in _robot_and_heavier_payload(arm):
            bodies = robot.rigid_bodies()
            weight = np.array([bodies.gravity_torque(row) for row in q])
            whole.append((weight, np.array([bodies.weight_slope(row) for row in q])))
        self.held, self.by_q = _split_payload(whole)
        self.held[0] -= [arm.force_torque(row) for row in q]


def _robot_and_heavier_payload(arm: ElasticArm) -> list[Robot]:
    """The robot, and with its payload twice."""
    robot = arm.robot
    return [robot] if robot.payload is None else [robot, robot.with_payload_times(2.0)]


def _split_payload(whole: Sequence[tuple[np.ndarray, ...]]) -> list[np.ndarray]:
    """Of all bodies and of the payload alone, (2, ...)."""
    heavier = whole[-1]
    return [np.stack([own, more - own]) for own, more in zip(whole[0], heavier, strict=True)]


def _linearize_dynamics(
    robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, ...]:
    bodies = robot.bodies_in_motion()
    return bodies.torque(q, v, a), *bodies.torque_slopes(q, v, a)


class TabulatedSprings:
    """Springs of all joints on even grids of wind-ups; rigid joints have none and no wind-up.

    Parameters
    ----------
    arm : ElasticArm
    """

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
        """Torques and their rises to the next point (n points,), points in a radian (n,)."""
        numbers = {"torque": self._torque, "rise": self._rise, "scale": self._scale}
        return {**numbers, "points": _SPRING_TABLE_POINTS}

    def at(self, windup: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torques [N m] and tangent stiffnesses [N m/rad] at wind-ups, (B, n) each."""
        place = windup * self._scale + self._half
        # Beyond the table the spring goes on straight.
        cell = np.minimum(np.maximum(place.astype(np.int64), 0), 2 * self._half - 1)
        at = cell + self._offset
        rise = self._rise[at]
        return self._torque[at] + (place - cell) * rise, rise * self._scale

    def torque(self, windup: np.ndarray) -> np.ndarray:
        """Torques [N m] at wind-ups, (B, n) each."""
        return self.at(windup)[0]

    def windup(self, torque: np.ndarray) -> np.ndarray:
        """Wind-ups at torques, (.., n) each; the inverse."""
        return self._arm.windup(torque.reshape(-1, torque.shape[-1])).reshape(torque.shape)


# Of the integration [s], and its steps in a swing of the lowest mode: with a hundred of them it
# falls behind by a thirtieth of a radian in fifteen swings.
_MAX_TIME_STEP = 1e-3
_STEPS_PER_PERIOD = 100
# Swings of the lowest mode that are followed after arrival: the first is the largest.
_PERIODS_AFTER_ARRIVAL = 1.5
_MAX_TIME_AFTER_ARRIVAL = 1.0
# Where the tool would hang changes slowly: found at every so many steps.
_EQUILIBRIUM_STRIDE = 5
_EQUILIBRIUM_ITERATIONS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Member:
    """One arm with one command.

    Parameters
    ----------
    command : MotorMotion
        Of the motors.
    departure : Departure
        What the arm is.
    reference : MotorMotion
        The motion from whose hanging at rest the deviation is measured: the command itself, or the
        plan that it is to fulfil.
    """

    command: MotorMotion
    departure: Departure
    reference: MotorMotion


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmDeviations:
    """Deviations of several arms.

    Parameters
    ----------
    time : array (K,) [s]
    duration : float
        When the commands arrive [s].
    deviation : array (B, K, 3)
        Of each arm's tool from where it would hang at rest, base axes [m].
    """

    time: np.ndarray
    duration: float
    deviation: np.ndarray

    @cached_property
    def distance(self) -> np.ndarray:
        """Sizes of the deviations (B, K) [m]."""
        return np.asarray(np.linalg.norm(self.deviation, axis=2))

    @property
    def flight(self) -> np.ndarray:
        """Which instants are in flight (K,)."""
        return np.asarray(self.time <= self.duration)

    @property
    def peak(self) -> np.ndarray:
        """Largest deviations in flight (B,) [m]."""
        return np.asarray(self.distance[:, self.flight].max(axis=1))

    @property
    def peak_after(self) -> np.ndarray:
        """Largest deviations after arrival (B,) [m]."""
        return np.asarray(self.distance[:, self.time >= self.duration].max(axis=1))


class UncertainArms:
    """The arms of a robot along one planned motion.

    Parameters
    ----------
    arm : ElasticArm
        The nominal one.
    plan : JointMotion
        At rest at both ends; its second derivative is used.
    servo : Servo, optional
        The worst one; members have a share of its lag.
    """

    def __init__(self, arm: ElasticArm, plan: JointMotion, servo: Servo | None = None) -> None:
        self._servo = servo
        self.duration = plan.duration
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
        self._flight = count + 1
        self._q, self._v = (
            self._extend_at_rest(plan(flight)),
            self._extend_at_rest(plan(flight, 1), 0.0),
        )
        # Bodies in the middle of every step of the flight, then at rest.
        middle = 0.5 * (flight[:-1] + flight[1:])
        ends = [self._q[-1:], np.zeros_like(self._q[:1]), np.zeros_like(self._q[:1])]
        moving = [np.concatenate([plan(middle, k), end]) for k, end in enumerate(ends)]
        self.steps = self._trapezoidal_matrices(LinearizedBodies(arm, *moving))
        self.springs, self.damping = TabulatedSprings(arm), arm.damping
        self.rigid = np.flatnonzero(~arm.elastic)
        self._start = LinearizedWeight(arm, self._q[:1])
        steps = np.arange(0, len(self.time), _EQUILIBRIUM_STRIDE)
        self._equilibrium_samples = np.unique(np.append(steps, len(self.time) - 1))
        self._weight = LinearizedWeight(arm, self._q[self._equilibrium_samples])
        self._jacobian = self._extend_at_rest(
            np.array([arm.bodies.jacobian(arm.robot.tool, q)[:3] for q in self._q[: count + 1]])
        )

    def swings(self, members: Sequence[Member]) -> ArmDeviations:
        """Simulate members, all at once."""
        return simulate_uncertain_arms([SimulationRequest(self, members)])[0]

    def _extend_at_rest(self, values: np.ndarray, at_rest: float | None = None) -> np.ndarray:
        """Values of the flight and their last one, or another, until the end."""
        last = values[-1:] if at_rest is None else np.full_like(values[-1:], at_rest)
        return np.concatenate([values, np.repeat(last, len(self.time) - len(values), axis=0)])

    def _trapezoidal_matrices(self, bodies: LinearizedBodies) -> np.ndarray:
        """What the bodies are in the equation of each step (2, K, n, 3 n + 1).

        Columns by the rate at its end, the rate at its beginning and the place there; the torque
        that the plan needs.
        """
        step = self.step
        inertia, turning = bodies.inertia / step, 0.5 * bodies.by_v + 0.25 * step * bodies.by_q
        columns = [inertia + turning, inertia - turning, -bodies.by_q, bodies.torque[..., None]]
        return np.concatenate(columns, axis=3)

    def motors(self, commands: Sequence[MotorMotion]) -> tuple[np.ndarray, np.ndarray]:
        """Motions (K, C, 4, n) of the different commands, and which each member has (B,).

        Position and velocity as commanded less those of the plan, and what the worst servo adds to
        either.
        """
        different = list({id(command): command for command in commands}.values())
        places = {id(command): c for c, command in enumerate(different)}
        found = np.zeros((len(different), 4, len(self.time), self._q.shape[1]))
        for own, command in zip(found, different, strict=True):
            own[0], own[1] = command(self.time), command(self.time, 1)
            own[1, self.time > self.duration] = 0.0
            if self._servo is not None:
                late = self._servo.follow(command, self.time[-1])
                own[2], own[3] = late(self.time) - own[0], late(self.time, 1) - own[1]
        found[:, 0] -= self._q
        found[:, 1] -= self._v
        by_time = np.ascontiguousarray(found.transpose(2, 0, 1, 3))
        return by_time, np.array([places[id(command)] for command in commands])

    def begun(self, arms: _DepartureArrays, turn: np.ndarray) -> np.ndarray:
        """Links at rest (B, n) with the motors `turn` ahead of where the plan begins."""
        return _solve_equilibrium(self.springs, self._start, arms, turn[:, None])[:, 0]

    def deviation(self, members: Sequence[Member], links: np.ndarray) -> np.ndarray:
        """Of the members' tools (B, K, 3), for links that are ahead of the plan by (K, B, n)."""
        # Many members of one arm differ in their commands only, and would hang alike.
        alike = {(id(each.reference), id(each.departure)): each for each in members}
        places = {key: place for place, key in enumerate(alike)}
        hanging = self._reference_equilibrium(
            _DepartureArrays([each.departure for each in alike.values()]),
            [each.reference for each in alike.values()],
        )
        own = [places[id(each.reference), id(each.departure)] for each in members]
        # One matrix product for all members: einsum would take them one by one.
        along = self._jacobian.swapaxes(1, 2)
        away = links @ along - (hanging.swapaxes(0, 1) @ along)[:, own]
        return np.asarray(away.swapaxes(0, 1))

    def _reference_equilibrium(
        self, arms: _DepartureArrays, references: Sequence[MotorMotion]
    ) -> np.ndarray:
        """Links at rest at the positions of the references, less those of the plan (B, K, n)."""
        chosen, count = self._equilibrium_samples, len(self.time)
        different = {id(each): each(self.time[chosen]) for each in references}
        turn = np.stack([different[id(each)] for each in references]) - self._q[chosen]
        coarse = _solve_equilibrium(self.springs, self._weight, arms, turn)
        right = np.clip(np.searchsorted(chosen, np.arange(count)), 1, len(chosen) - 1)
        left = right - 1
        share = ((np.arange(count) - chosen[left]) / (chosen[right] - chosen[left]))[:, None]
        return np.asarray((1.0 - share) * coarse[:, left] + share * coarse[:, right])


@dataclass(frozen=True, eq=False)
class SimulationRequest:
    """Members whose arms are along one plan."""

    many: UncertainArms
    members: Sequence[Member]

    def swings(self, links: np.ndarray) -> ArmDeviations:
        """Their deviations, from the positions of their links less those of the plan (K, B, n)."""
        many = self.many
        deviation = many.deviation(self.members, links[: len(many.time)])
        return ArmDeviations(time=many.time, duration=many.duration, deviation=deviation)


def simulate_uncertain_arms(asked: Sequence[SimulationRequest]) -> list[ArmDeviations]:
    """Simulate the members of several plans of one arm.

    Parameters
    ----------
    asked : sequence of Asked
    """
    core = native.core(len(asked[0].many.damping)) if asked else None
    return [
        each.swings(_integrate_numpy(each) if core is None else _integrate_compiled(core, each))
        for each in asked
    ]


def _integrate_compiled(core: CDLL, asked: SimulationRequest) -> np.ndarray:
    """Positions of the links less those of their plan (K, B, n)."""
    many = asked.many
    arms = _DepartureArrays([member.departure for member in asked.members])
    moved, of = many.motors([member.command for member in asked.members])
    return native.integrate_linearized(
        core,
        many.springs,
        many.rigid,
        many.begun(arms, moved[0, of, 0]),
        count=len(many.time),
        flight=many.steps.shape[1],
        commands=moved.shape[1],
        step=many.step,
        bodies=many.steps,
        commanded=moved,
        of=of,
        stiffness=arms.stiffness,
        damping=arms.damping * many.damping,
        payload=arms.payload,
        servo=arms.servo,
    )


def _integrate_numpy(asked: SimulationRequest) -> np.ndarray:
    """As `_integrate_compiled`, without the compiled core."""
    many, rigid = asked.many, asked.many.rigid
    arms = _DepartureArrays([member.departure for member in asked.members])
    moved, of = many.motors([member.command for member in asked.members])
    damping, step, joints = arms.damping * many.damping, many.step, np.arange(len(many.damping))
    turn, e = moved[0, of, 0], many.begun(arms, moved[0, of, 0])
    rate, drive = np.zeros_like(e), np.zeros_like(e)
    found = [e]
    for k in range(1, len(many.time)):
        own, more = many.steps[:, min(k, many.steps.shape[1]) - 1]
        bodies = own + arms.payload[..., None] * more
        right = np.einsum("bij,bj->bi", bodies[:, :, len(joints) : -1], np.hstack([rate, e]))
        before = arms.stiffness * many.springs.torque(turn - e) + damping * (drive - rate)
        now = moved[k, of]
        turn = now[:, 0] + arms.servo * now[:, 2]
        drive = now[:, 1] + arms.servo * now[:, 3]
        # Springs at the predicted place, straight from there to the end of the step.
        torque, tangent = many.springs.at(turn - e - step * rate)
        torque, tangent = arms.stiffness * torque, arms.stiffness * tangent
        ahead = torque + 0.5 * step * tangent * rate + damping * drive
        right += 0.5 * (before + ahead) - bodies[:, :, -1]
        left = bodies[:, :, : len(joints)]
        left[:, joints, joints] += 0.5 * damping + 0.25 * step * tangent
        # Rigid joints do as their motors.
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
    """Links at rest (B, K, n) with the motors `turn` ahead of the poses of the weight."""
    held = weight.held[0] + arms.payload[..., None] * weight.held[1]
    stiffness = arms.stiffness[:, None]
    e = turn - springs.windup(held / stiffness)
    for _ in range(_EQUILIBRIUM_ITERATIONS - 1):
        # One matrix product a pose for all arms, whatever they carry.
        own, more = ((e.swapaxes(0, 1) @ by.swapaxes(1, 2)).swapaxes(0, 1) for by in weight.by_q)
        e = turn - springs.windup((held + own + arms.payload[..., None] * more) / stiffness)
    return np.asarray(e)
