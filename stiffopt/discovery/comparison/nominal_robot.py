"""Nominal model of a recording set along a motion: torques, wind-up, friction, arm signals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from stiffopt.discovery.comparison.filtering import derivative
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.settings import fill_missing
from stiffopt.discovery.signals import (
    HARMONICS_PER_JOINT,
    PARAMETERS_PER_BODY,
    JointConstants,
    RobotConstants,
    smooth_sign,
)
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.robot.batched_kinematics import body_torque_regressor, frame_positions, tool_jacobians
from stiffopt.robot.frames import first_link_of

# Step of a centre of mass for the slopes of inertial parameters [m].
_CENTRE_STEP = 1e-5
# Displacement of links for the slopes of their torques [rad].
_DISPLACEMENT_STEP = 1e-4


class RobotModel:
    """Nominal dynamics in the joint order of the recording set.

    `n`: joints. `rotor_inertia`, `coulomb`, `viscous` (n,): zero where the set states none.
    `torque_cache`: recently used torques of single bodies, and harmonics of single joints, along
    motions.
    """

    def __init__(self, recordings: RecordingSet) -> None:
        self.recordings = recordings
        self.arm = recordings.robot
        self._bodies = self.arm.bodies_in_motion()
        self.order = np.asarray(recordings.order)
        self.n = len(recordings.joints)
        self.rotor_inertia = self.arm.rotor_inertia[self.order]
        self.coulomb = self.arm.coulomb[self.order]
        self.viscous = self.arm.viscous[self.order]
        self._counterbalances = recordings.nominal.counterbalance
        self.torque_cache: dict[tuple[object, int], np.ndarray] = {}

    # ---- constants

    @cached_property
    def constants(self) -> RobotConstants:
        """Constants without ranges from recordings, see `constants_over`."""
        nominal, connections = self.recordings.nominal, self.recordings.nominal.connections
        torque_max = self.arm.torque_max[self.order]
        torque_max = np.where((torque_max > 0.0) & np.isfinite(torque_max), torque_max, np.nan)
        rated = fill_missing(nominal.torque_rated, torque_max / 3.0)
        ratio = fill_missing(nominal.gear_ratio, np.ones(self.n))
        damping = fill_missing(nominal.joint_damping, np.zeros(self.n))
        law = self.recordings.actuator
        joints = tuple(
            JointConstants(
                joint=j + 1,
                ratio=float(ratio[j]),
                coulomb=float(self.coulomb[j]),
                viscous=float(self.viscous[j]),
                torque_rated=float(rated[j]),
                torque_max=float(torque_max[j]),
                rotor_inertia=float(self.rotor_inertia[j]),
                joint_damping=float(damping[j]),
                chain=self.arm.chains[self.order[j]],
                pole_pairs=nominal.pole_pairs,
                prismatic=bool(self.recordings.prismatic[j]),
                belt=None if connections is None else "belt" in connections[j],
                joints=self.n,
                position_gain=np.nan if law is None else float(law.stiffness[j]),
            )
            for j in range(self.n)
        )
        bodies = [self.arm.tree.bodies[j] for j in self.order]
        return RobotConstants(
            joints=joints,
            links=tuple(first_link_of(self.arm.model, int(j) + 1) for j in self.order),
            masses=np.array([body.mass for body in bodies]),
            centres=np.array([body.centre for body in bodies]),
            tool_range=np.array([[-1.0] * 3, [1.0] * 3]),
            gravity=np.asarray(self.recordings.gravity, dtype=float),
        )

    @cached_property
    def guessed_bodies(self) -> tuple[int, ...]:
        """Bodies, by place among the joints, whose masses are estimates of the robot's file."""
        guessed = {each.element for each in self.arm.sources if each.provenance == "estimated"}
        links = enumerate(self.constants.links)
        return tuple(body for body, link in links if f"link {link}" in guessed)

    @cached_property
    def body_value_slopes(self) -> dict[ValueName, np.ndarray]:
        """Changes (10,) of a body's inertial parameters per unit of mass and centre, by name."""
        found = {}
        for place, joint in enumerate(self.order):
            body = self.arm.tree.bodies[joint]
            now = body.inertial_parameters
            found[ValueName("mass", place)] = now
            for axis, shift in zip("xyz", _CENTRE_STEP * np.eye(3), strict=True):
                moved = replace(body, centre=body.centre + shift).inertial_parameters
                found[ValueName("com", place, axis)] = (moved - now) / _CENTRE_STEP
        return found

    # ---- along a motion, (K, n) each, in the joint order of the set

    @property
    def elastic(self) -> bool:
        """True where any nominal joint winds up."""
        return any(joint.elastic for joint in self.constants.joints)

    @property
    def vibrates(self) -> bool:
        """True where the stiffness and damping of every joint are known."""
        return self.recordings.swings

    def windup(self, torque: np.ndarray) -> np.ndarray:
        """Return the nominal wind-up under spring torques [rad]."""
        joints = enumerate(self.constants.joints)
        return np.array([joint.windup(torque[:, j]) for j, joint in joints]).T

    def compliance(self, torque: np.ndarray) -> np.ndarray:
        """Return the tangent compliance of the nominal wind-up [rad/(N m)]."""
        return np.column_stack(
            [joint.compliance(torque[:, j]) for j, joint in enumerate(self.constants.joints)]
        )

    def friction(self, velocity: np.ndarray, direction: np.ndarray | None = None) -> np.ndarray:
        """Return nominal friction [N m]; default direction: smooth sign of the velocity."""
        side = smooth_sign(velocity) if direction is None else direction
        return np.asarray(self.coulomb * side + self.viscous * velocity)

    def spring_torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Return the spring torque of rigid bodies and counterbalances [N m]."""
        torque = self._bodies.torque(*self._ordered(q, v, a))[:, self.order]
        for balance in self._counterbalances:
            j = balance.joint
            torque[:, j] -= balance.at(q[:, j])
        return torque

    def gravity_torque(self, q: np.ndarray, gravity: np.ndarray) -> np.ndarray:
        """Return the gravity torque (K, n) under another gravity vector (3,) [m/s^2]."""
        bodies = self._bodies.with_gravity(gravity)
        return bodies.gravity_torque(self._to_robot_order(q))[:, self.order]

    def torque_slopes(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return torque derivatives by position, velocity, acceleration (K, n, n) each."""
        slopes = self._bodies.torque_slopes(*self._ordered(q, v, a))
        position, velocity, acceleration = (x[:, self.order][..., self.order] for x in slopes)
        return position, velocity, acceleration

    def body_torques(
        self,
        body: int,
        q: np.ndarray,
        v: np.ndarray,
        a: np.ndarray,
        added_gravity: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the spring torques per inertial parameter of one body (K, n, 10)."""
        motion, tree = self._ordered(q, v, a), self.arm.tree
        if added_gravity is not None:
            tree = replace(tree, gravity=np.asarray(tree.gravity + added_gravity))
        torques = body_torque_regressor(tree, int(self.order[body]), *motion)
        # Avoid a copy of the largest array of a long run where both orders agree.
        return torques if np.all(self.order == np.arange(self.n)) else torques[:, self.order]

    def body_regressor(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Return the spring torques per inertial parameter of every body (K, n, 10 n)."""
        return np.concatenate([self.body_torques(b, q, v, a) for b in range(self.n)], axis=2)

    def changed_torque(
        self,
        change: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        a: np.ndarray,
        added_gravity: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the spring torques (K, n) of changed inertial parameters (n, 10)."""
        by_body, bodies = np.empty_like(change), self._bodies
        by_body[self.order] = change
        if added_gravity is not None:
            bodies = bodies.with_gravity(np.asarray(self.arm.tree.gravity + added_gravity))
        return bodies.changed_torque(by_body, *self._ordered(q, v, a))[:, self.order]

    def weight(self, q: np.ndarray, change: np.ndarray | None = None) -> np.ndarray:
        """Return the gravity torque per gravity along the axes of the base (K, n, 3).

        `change` (n, 10): of the inertial parameters.
        """
        rest, stated = np.zeros_like(q), self.arm.tree.gravity
        found = np.stack([self.gravity_torque(q, axis) for axis in np.eye(3)], axis=2)
        if change is not None:
            for k, axis in enumerate(np.eye(3)):
                found[..., k] += self.changed_torque(change, q, rest, rest, axis - stated)
        return found

    def zero_harmonics(
        self,
        joint: int,
        q: np.ndarray,
        v: np.ndarray,
        a: np.ndarray,
        change: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the harmonics of the body torques over the angle of one joint (K, n, 4).

        Rotations are linear in sine and cosine of the angle, and torques quadratic in rotations:
        five angles determine the harmonics exactly. Counterbalances keep their torque. `change`
        (n, 10): of the inertial parameters.
        """
        count = HARMONICS_PER_JOINT + 1
        angles = 2.0 * np.pi * np.arange(count) / count
        found = np.zeros((HARMONICS_PER_JOINT, self.n, len(q)))
        for angle in angles:
            moved = q.copy()
            moved[:, joint] += angle
            torque = self._bodies.torque(*self._ordered(moved, v, a))[:, self.order]
            if change is not None:
                torque = torque + self.changed_torque(change, moved, v, a)
            for k, order in enumerate((1, 1, 2, 2)):
                wave = np.cos(order * angle) if k % 2 else np.sin(order * angle)
                found[k] += 2.0 / count * wave * torque.T
        return found.T

    def cached_torques(
        self, key: tuple[object, int], size: int, evaluate: Callable[[], np.ndarray]
    ) -> np.ndarray:
        """Return torques along a motion from the cache, or evaluate them (of a size in bytes)."""
        kept = self.torque_cache
        found = kept.pop(key, None)
        if found is None:
            # Free memory before the allocation: a long run has no room for one more.
            while kept and size + sum(each.nbytes for each in kept.values()) > _TORQUE_CACHE_BYTES:
                kept.pop(next(iter(kept)))
            found = evaluate()
        kept[key] = found
        return found

    def tool(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the tool position (K, 3) and its Jacobian (K, 3, n)."""
        position, jacobian = tool_jacobians(self.arm.tree, self.arm.tool, self._to_robot_order(q))
        return position, jacobian[..., self.order]

    def tool_axes(self, q: np.ndarray) -> np.ndarray:
        """Return the rotation (K, 3, 3) of the link that carries the tool, in the base."""
        frame, ordered = self.arm.tool, self._to_robot_order(q)
        places = [
            frame_positions(self.arm.tree, replace(frame, offset=frame.offset + step), ordered)
            for step in (np.zeros(3), *np.eye(3))
        ]
        return np.stack([place - places[0] for place in places[1:]], axis=2)

    def temperature_rise(self, run: RecordedRun, count: int) -> np.ndarray:
        """Return the housing temperature above that of friction identification (K, n) [K]."""
        reference = self.recordings.nominal.friction_temperature
        if run.temperature is None or reference is None:
            return np.zeros((self.n, count)).T
        return np.tile(np.asarray(run.temperature, dtype=float) - reference, (count, 1))

    def _ordered(self, *motion: np.ndarray) -> Iterator[np.ndarray]:
        return map(self._to_robot_order, motion)

    def _to_robot_order(self, values: np.ndarray) -> np.ndarray:
        """Return columns (K, n) in the robot's own joint order."""
        full = np.empty_like(values)
        full[:, self.order] = values
        return full


# Cache of torques over all runs of a robot, least recently used out first [bytes].
_TORQUE_CACHE_BYTES = 2**26
# Cached torques of changed inertial parameters per run, oldest out first.
_MAX_CACHED_CHANGES = 3


class _TorqueParts:
    """Joint torques along a motion by parts, (K, n, width) each, evaluated on demand.

    Body torques of a ten-minute run exceed all its other signals, and most effects use none.

    `motion` (K, n): position, velocity and acceleration of the links. `width`: columns of a part.
    `evaluate`: (part, *motion) -> its columns.
    """

    def __init__(
        self,
        robot: RobotModel,
        motion: tuple[np.ndarray, ...],
        width: int,
        evaluate: Callable[..., np.ndarray],
    ) -> None:
        self._robot, self._motion, self._width, self._evaluate = robot, motion, width, evaluate

    def of_part(self, part: int) -> np.ndarray:
        """Return the columns (K, n, width) of a part (from 0)."""
        size = self._motion[0].nbytes * self._width
        return self._robot.cached_torques(
            (self, part), size, lambda: self._evaluate(part, *self._motion)
        )

    def __getitem__(self, where: tuple[Any, int]) -> np.ndarray:
        """Return entries [..., k] as of an array."""
        part, column = divmod(where[1], self._width)
        return np.asarray(self.of_part(part)[..., column])


class BodyRegressor(_TorqueParts):
    """Joint torques along a motion per inertial parameter (K, n, 10 n), body by body.

    `added_gravity` (3,): in the axes of the base, beside the stated gravity [m/s^2]. `zeros` (n,):
    where the joints stand beyond the motion [rad].
    """

    def __init__(
        self,
        robot: RobotModel,
        motion: tuple[np.ndarray, ...],
        added_gravity: np.ndarray | None = None,
        zeros: np.ndarray | float = 0.0,
    ) -> None:
        evaluate = partial(robot.body_torques, added_gravity=added_gravity)
        super().__init__(robot, (motion[0] + zeros, *motion[1:]), PARAMETERS_PER_BODY, evaluate)
        self._given, self.added_gravity, self.zeros = motion, added_gravity, zeros
        self._changes: dict[bytes, np.ndarray] = {}

    def along(self, *motion: np.ndarray) -> BodyRegressor:
        """Return the torques along another motion."""
        return BodyRegressor(self._robot, motion, self.added_gravity, self.zeros)

    def under(self, added: np.ndarray, zeros: np.ndarray) -> BodyRegressor:
        """Return the torques under still more gravity (3,), at still other zeros (n,)."""
        before = 0.0 if self.added_gravity is None else self.added_gravity
        return BodyRegressor(self._robot, self._given, before + added, self.zeros + zeros)

    def torque_of_body(self, body: int, change: np.ndarray) -> np.ndarray:
        """Return the torques (K, n) of changed parameters (10,) of one body (from 0)."""
        # Instants are contiguous in memory: one product of a row with a matrix.
        return np.asarray(np.tensordot(change, self.of_part(body).T, 1).T)

    def torque(self, change: np.ndarray) -> np.ndarray:
        """Return the torques (K, n) of changed parameters (n, 10) of all bodies."""
        key = change.tobytes()
        if key not in self._changes:
            while len(self._changes) >= _MAX_CACHED_CHANGES:
                self._changes.pop(next(iter(self._changes)))
            q, v, a = self._motion
            self._changes[key] = self._robot.changed_torque(
                change, q, v, a, added_gravity=self.added_gravity
            )
        return self._changes[key]


class LazyArmSignals:
    """Tool, weight, body torques and joint zeros along a link motion, evaluated on demand.

    `body_regressor`: torques per inertial parameter. `zero_harmonics`: harmonics of the torques
    over the zeros of joints (K, n, 4 n). Weight and zeros are those of bodies with changed
    inertial parameters (n, 10), by default the nominal ones.
    """

    def __init__(self, robot: RobotModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        self._robot, self._motion = robot, (q, v, a)
        self.body_regressor = BodyRegressor(robot, self._motion)
        self._take_bodies(None)

    def _take_bodies(self, change: np.ndarray | None) -> None:
        evaluate = partial(self._robot.zero_harmonics, change=change)
        self._change = change
        self.zero_harmonics = _TorqueParts(self._robot, self._motion, HARMONICS_PER_JOINT, evaluate)
        self.__dict__.pop("weight", None)

    @cached_property
    def _tool_kinematics(self) -> tuple[np.ndarray, np.ndarray]:
        return self._robot.tool(self._motion[0])

    @property
    def tool_position(self) -> np.ndarray:
        """Tool position in the base frame (K, 3) [m]."""
        return self._tool_kinematics[0]

    @property
    def tool_jacobian(self) -> np.ndarray:
        """Jacobian of the tool position (K, 3, n)."""
        return self._tool_kinematics[1]

    @cached_property
    def tool_levers(self) -> np.ndarray:
        """Work of forces at the tool (K, n, 6) [m], along the axes of base and tool."""
        levers = np.swapaxes(self.tool_jacobian, 1, 2)
        turned = levers @ self._robot.tool_axes(self._motion[0])
        return np.concatenate([levers, turned], axis=2)

    @cached_property
    def weight(self) -> np.ndarray:
        """Torques per gravity along the axes of the base (K, n, 3) [N m per m/s^2]."""
        return self._robot.weight(self._motion[0], self._change)

    def displaced_torque(self, wound: np.ndarray, dt: float) -> np.ndarray:
        """Return the change (k, n) of the torques of links displaced by -wound, to first order.

        `wound` (k, n): motor less link angle beyond the nominal one, of the first samples [rad].
        """
        rate = derivative(wound, dt)
        change = (wound, rate, derivative(rate, dt))
        step = _DISPLACEMENT_STEP / max(float(np.abs(wound).max()), _DISPLACEMENT_STEP)
        ahead, behind = (
            self._robot.spring_torque(
                *(x[: len(wound)] + s * d for x, d in zip(self._motion, change, strict=True))
            )
            for s in (-step, step)
        )
        return np.asarray((ahead - behind) / (2.0 * step))

    def head(self, count: int) -> _FirstSamples:
        """Return the first samples, as views of the evaluation of all."""
        return _FirstSamples(self, count)

    def decimate(self, every: int) -> LazyArmSignals:
        """Return every k-th sample."""
        other = LazyArmSignals(self._robot, *(x[::every] for x in self._motion))
        other.body_regressor = self.body_regressor.along(*other._motion)
        return other

    def with_bodies(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> LazyArmSignals:
        """Return the signals with the body torques along another motion."""
        other = copy(self)
        other.body_regressor = self.body_regressor.along(q, v, a)
        return other

    def with_geometry(self, gravity: np.ndarray, zeros: np.ndarray) -> LazyArmSignals:
        """Return the signals with the body torques under more gravity (3,), at other zeros (n,)."""
        other = copy(self)
        other.body_regressor = self.body_regressor.under(gravity, zeros)
        return other

    def with_changed_bodies(self, change: np.ndarray) -> LazyArmSignals:
        """Return the signals with weight and joint zeros of changed bodies (n, 10)."""
        other = copy(self)
        other._take_bodies(change)
        return other


class _FirstSamples:
    """First samples of signals, as views of their evaluation along the whole motion."""

    def __init__(self, whole: Any, count: int) -> None:
        self._whole, self._count = whole, count

    def head(self, count: int) -> _FirstSamples:
        return _FirstSamples(self._whole, count)

    def __getitem__(self, where: Any) -> np.ndarray:
        return np.asarray(self._whole[where][: self._count])

    def __getattr__(self, name: str) -> Any:
        own = getattr(self._whole, name)
        if isinstance(own, np.ndarray):
            return own[: self._count]
        if callable(own):
            return lambda *arguments: own(*arguments)[: self._count]
        return _FirstSamples(own, self._count)
