"""Closed loop of an arm and its actuators as one step of an integrator, with exact derivatives.

The integrator is the linearly implicit two-stage method ROS2 of Verwer et al. (1999), which is of
second order for any approximation of the Jacobian and L-stable: stiff gains and dry friction on
light links need no shorter steps. Its Jacobian here holds the actuators and friction alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from stiffopt import native
from stiffopt.actuator.law import ActuatorLaw
from stiffopt.closed_loop.parameters import BODY_PARAMETERS, JOINT_PARAMETERS
from stiffopt.dynamics.newton_euler import own_bodies, torque_of_bodies
from stiffopt.interpreter.batched import read_batch
from stiffopt.robot.body_tree import BodyTree

# Rounding of the magnitude of the torque that load friction goes with [N m].
_LOAD_WIDTH = 0.1
# Inputs of a step that all lanes share: parameters.
_SHARED_INPUTS = (2,)
_STAGE_WEIGHT = 1.0 + 1.0 / np.sqrt(2.0)


@dataclass(frozen=True, eq=False)
class LoopSymbols:
    """Symbols of one step: state (2 n,), command (n,), parameters (p,), width, step, next state.

    At the width, a speed [rad/s], dry friction reaches 76 % (tanh 1).
    """

    state: ca.SX
    command: ca.SX
    parameters: ca.SX
    width: ca.SX
    step: ca.SX
    next: ca.SX


@dataclass(frozen=True, eq=False)
class LoopSignals:
    """Motion and torques of all joints, one entry (n,) each, in symbols.

    Readings of the encoders, speeds and accelerations of the motors, smooth direction of motion;
    torques of the actuators, of the springs, and of the drives by the model's own friction and
    rotors.
    """

    position: ca.SX
    velocity: ca.SX
    acceleration: ca.SX
    direction: ca.SX
    torque: ca.SX
    spring: ca.SX
    drive: ca.SX


@dataclass(frozen=True, kw_only=True)
class LoopSpring:
    """Spring of a joint between motor and link.

    Parameters
    ----------
    windup : callable
        Spring torque [N m] -> motor less link angle [rad], strictly increasing.
    damping : float
        Between motor and link [N m s/rad].
    encoder_at_output : bool
        The encoder reads the link; otherwise the motor.
    """

    windup: Callable[[ca.SX], ca.SX]
    damping: float = 0.0
    encoder_at_output: bool = False


@dataclass(frozen=True, kw_only=True)
class LoopPhysics:
    """Physics of a loop beyond rigid bodies, friction and rotors.

    Parameters
    ----------
    torque : callable, optional
        Torques (n,) that the drives have to give besides; affine in accelerations.
    displacement : callable, optional
        Readings (n,) -> motor less link angles (n,) of rigid joints [rad].
    springs : mapping of int to LoopSpring
        Of elastic joints (from 0).
    """

    torque: Callable[[LoopSignals], ca.SX] | None = None
    displacement: Callable[[ca.SX], ca.SX] | None = None
    springs: Mapping[int, LoopSpring] = field(default_factory=dict)


class CommandedArm:
    """Arm with actuators that follow commands.

    Parameters
    ----------
    tree : BodyTree
    law : ActuatorLaw
        In the joint order of the tree; unknown gains count as none.
    middle : array (n,)
        Positions about which dry friction changes [rad].
    physics : LoopPhysics, optional
        Beyond rigid bodies, friction and rotors.

    Notes
    -----
    The state holds readings and their speeds (n,) each, then for every elastic joint the torque of
    its spring and the speed of the side that the encoder does not read.
    """

    def __init__(
        self,
        tree: BodyTree,
        law: ActuatorLaw,
        middle: np.ndarray,
        physics: LoopPhysics | None = None,
    ) -> None:
        self.tree, self.law, self.middle = tree, law, np.asarray(middle, dtype=float)
        self.physics = physics or LoopPhysics()
        self.n, self._elastic = tree.n, sorted(self.physics.springs)
        # Places of the speeds of links and motors among those of readings and other sides.
        self._link, self._motor = np.arange(self.n), np.arange(self.n)
        for k, joint in enumerate(self._elastic):
            at_output = self.physics.springs[joint].encoder_at_output
            (self._motor if at_output else self._link)[joint] = self.n + k
        self._steps: dict[bytes, tuple[ca.Function, ca.Function]] = {}
        self._lanes: dict[tuple[bytes, int], ca.Function] = {}

    @property
    def size(self) -> int:
        """Number of states."""
        return 2 * (self.n + len(self._elastic))

    def begin(self, position: np.ndarray, velocity: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the state with these readings and speeds (n,), in which springs carry the weight.

        `values` (p,) are the parameters.
        """
        if not self._elastic:
            return np.concatenate([position, velocity])
        weight = np.asarray(self._weight(position, values))[:, 0]
        return np.concatenate(
            [position, velocity, weight[self._elastic], np.asarray(velocity)[self._elastic]]
        )

    @cached_property
    def _weight(self) -> ca.Function:
        """Return the torques (n,) at rest, of readings and parameters."""
        q, parameters = ca.SX.sym("q", self.n), ca.SX.sym("p", self._parameter_count)
        own, bodies = self._split(parameters)
        still = ca.SX.zeros(self.n)
        found = torque_of_bodies(
            self.tree, self.tree.gravity, q - own["zero"], still, still, *bodies
        )
        return ca.Function("weight", [q, parameters], [ca.densify(found)])

    def step_function(self, free: np.ndarray) -> ca.Function:
        """Return one step with derivatives by some parameters (indices), and by the delay.

        (state and sensitivities (size (1 + m),), command and its slope (2 n,), parameters and width
        of dry friction, step) -> the same state after the step. The last sensitivity is that by the
        delay.
        """
        return self._both_steps(free)[0]

    def lanes(self, free: np.ndarray, count: int) -> tuple[int, ca.Function]:
        """Return a number of lanes and `count` steps of all of them, side by side.

        States, commands and steps of the lanes are columns, those of a step together; parameters
        are the same in all lanes.
        """
        step, key = self._both_steps(free)[1], (free.tobytes(), count)
        if key not in self._lanes:
            self._lanes[key] = step.mapaccum(count)
        return int(step.size2_in(0)), self._lanes[key]

    def _both_steps(self, free: np.ndarray) -> tuple[ca.Function, ca.Function]:
        """Return a step of one lane, and of as many as the compiled core has."""
        key = free.tobytes()
        if key not in self._steps:
            step, path = self._build_step(free), native.library()
            several = None if path is None else read_batch(step, _SHARED_INPUTS).load(path)
            self._steps[key] = step, several or step
        return self._steps[key]

    def _build_step(self, free: np.ndarray) -> ca.Function:
        s = self._symbols()
        n, m = self.n, len(free)
        sensitivity, slope = ca.SX.sym("S", self.size, m + 1), ca.SX.sym("slope", n)
        by_state, by_command = ca.jacobian(s.next, s.state), ca.jacobian(s.next, s.command)
        by_parameter = ca.densify(ca.jacobian(s.next, s.parameters))[:, [int(k) for k in free]]
        after = ca.mtimes(by_state, sensitivity) + ca.horzcat(
            by_parameter, ca.mtimes(by_command, slope)
        )
        return ca.Function(
            "step",
            [
                ca.vertcat(s.state, ca.vec(sensitivity)),
                ca.vertcat(s.command, slope),
                ca.vertcat(s.parameters, s.width),
                s.step,
            ],
            [ca.densify(ca.vertcat(s.next, ca.vec(after)))],
        )

    @property
    def _parameter_count(self) -> int:
        return (len(JOINT_PARAMETERS) + len(BODY_PARAMETERS)) * self.n + 1

    def _split(self, parameters: ca.SX) -> tuple[dict[str, ca.SX], tuple[ca.SX, ...]]:
        """Return the parameters of joints (n,) by name, and the bodies."""
        n, joints = self.n, len(JOINT_PARAMETERS) * self.n
        columns = ca.horzsplit(ca.reshape(parameters[:joints], n, -1))
        own = dict(zip(JOINT_PARAMETERS, columns, strict=True))
        return own, self._bodies(parameters[joints : self._parameter_count - 1])

    def _symbols(self) -> LoopSymbols:
        """Return one step of ROS2 in symbols."""
        n, elastic = self.n, len(self._elastic)
        state, command = ca.SX.sym("x", self.size), ca.SX.sym("u", n)
        parameters = ca.SX.sym("p", self._parameter_count)
        width, h = ca.SX.sym("width"), ca.SX.sym("h")
        model = _Balance(self, *self._split(parameters), command, width)
        reading, rate, load, other = ca.vertsplit(
            state, [0, n, 2 * n, 2 * n + elastic, 2 * (n + elastic)]
        )
        place, speed = ca.vertcat(reading, load), ca.vertcat(rate, other)
        mass, (force, slope) = model.mass(place, speed), model.force(place, speed)
        rates, slopes = model.rates(place), model.slopes(place)
        symmetric = self.physics.torque is None  # others may depend on accelerations anyhow
        # Negative slopes, as of dry friction that a fit drives below zero, stay explicit.
        shift = _STAGE_WEIGHT * h
        implicit = _factorize(
            mass + ca.diag(shift * ca.fmax(slope, 0)) + shift**2 * ca.mtimes(slopes, rates),
            symmetric=symmetric,
        )

        def stage(rate: ca.SX, right: ca.SX) -> tuple[ca.SX, ca.SX]:
            """Solve (1 - gamma h J) k = (rate, right / mass)."""
            second = _solve(implicit, right - shift * ca.mtimes(slopes, rate))
            return rate + shift * ca.mtimes(rates, second), second

        first = stage(ca.mtimes(rates, speed), force)
        ahead, ahead_speed = place + h * first[0], speed + h * first[1]
        mass_ahead = model.mass(ahead, ahead_speed)
        force_ahead = model.force(ahead, ahead_speed)[0]
        acceleration = _solve(_factorize(mass_ahead, symmetric=symmetric), force_ahead)
        second = stage(
            ca.mtimes(model.rates(ahead), ahead_speed) - 2.0 * first[0],
            ca.mtimes(mass, acceleration - 2.0 * first[1]),
        )
        (q, s), (v, w) = (
            ca.vertsplit(before + h * (1.5 * one + 0.5 * two), [0, n, n + elastic])
            for before, one, two in zip((place, speed), first, second, strict=True)
        )
        after = ca.vertcat(q, v, s, w)
        return LoopSymbols(state, command, parameters, width, h, after)

    def _bodies(self, changes: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return masses, first moments and inertias with changes (7 n,), body by body."""
        n = self.n
        each = ca.reshape(changes, len(BODY_PARAMETERS), n)
        mass, first, inertia = own_bodies(self.tree)
        factor = 1.0 + each[0, :]
        about = ca.horzcat(*(ca.diag(each[4:, i]) for i in range(n)))
        return (
            mass * factor.T,
            first * ca.repmat(factor, 3, 1) + each[1:4, :],
            inertia * ca.kron(factor, ca.DM.ones(3, 3)) + about,
        )


class _Balance:
    """Equation of motion of a loop in its places (readings, spring torques) and speeds."""

    def __init__(
        self,
        loop: CommandedArm,
        own: Mapping[str, ca.SX],
        bodies: tuple[ca.SX, ...],
        command: ca.SX,
        width: ca.SX,
    ) -> None:
        self.loop, self.own, self.bodies, self.width = loop, own, bodies, width
        self.n, self.command = loop.n, command
        law = loop.law
        stiffness = np.where(np.isfinite(law.stiffness), law.stiffness, 0.0)
        self.kp = ca.DM(stiffness) * (1.0 + own["gain"])
        self.kd = ca.DM(law.damping) * (1.0 + own["damping"])
        count = loop.size // 2
        self._of_link, self._of_motor = (
            ca.sparsify(ca.DM(np.eye(count)[:, each])) for each in (loop._link, loop._motor)
        )

    def _links(self, place: ca.SX, speed: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Return angles and speeds of the links, their Jacobian, and accelerations at no other."""
        q, jacobian = place[: self.n], ca.SX(ca.DM.eye(self.n))
        angle, rate = q - self.own["zero"], ca.mtimes(self._of_link.T, speed)
        drift = ca.SX.zeros(self.n)
        for k, joint in enumerate(self.loop._elastic):
            spring = self.loop.physics.springs[joint]
            if not spring.encoder_at_output:
                angle[joint] -= spring.windup(place[self.n + k])
        if self.loop.physics.displacement is not None:
            reading = ca.SX.sym("q", self.n)
            wound = self.loop.physics.displacement(reading)
            by_reading = ca.jacobian(wound, reading)
            along = ca.jtimes(ca.mtimes(by_reading, rate), reading, rate)
            wound, by_reading, along = ca.substitute([wound, by_reading, along], [reading], [q])
            angle, drift = angle - wound, -along
            jacobian = jacobian - by_reading
            rate = ca.mtimes(jacobian, rate)
        return angle, rate, jacobian, drift

    def _torque_of_links(self, gravity: np.ndarray, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
        return torque_of_bodies(self.loop.tree, gravity, q, v, a, *self.bodies)

    def _inertia(self, angle: ca.SX, jacobian: ca.SX) -> ca.SX:
        """Return the torques (n, n) of the links per acceleration, both along their readings."""
        still, none = ca.SX.zeros(self.n), np.zeros(3)
        columns = [self._torque_of_links(none, angle, still, jacobian[:, i]) for i in range(self.n)]
        return ca.mtimes(jacobian.T, ca.horzcat(*columns))

    def mass(self, place: ca.SX, speed: ca.SX) -> ca.SX:
        """Return the forces of all sides per acceleration."""
        angle, _, jacobian, _ = self._links(place, speed)
        found = ca.mtimes([self._of_link, self._inertia(angle, jacobian), self._of_link.T])
        found += ca.mtimes([self._of_motor, ca.diag(self.own["armature"]), self._of_motor.T])
        if self.loop.physics.torque is not None:
            rate = ca.SX.sym("a", speed.shape[0])
            added = self._added(place, speed, rate)[0]
            found += ca.mtimes(self._of_motor, ca.jacobian(added, rate))
        return found

    def force(self, place: ca.SX, speed: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the forces that accelerate, and the slope of all losses by the speed."""
        torque, losses, slope = self._drive(place, speed)
        angle, rate, jacobian, drift = self._links(place, speed)
        # Displaced links work along their readings.
        bias = ca.mtimes(
            jacobian.T, self._torque_of_links(self.loop.tree.gravity, angle, rate, drift)
        )
        if self.loop.physics.torque is not None:
            still = ca.SX.zeros(speed.shape[0])
            more, by_speed = self._added(place, speed, still)
            losses, slope = losses + more, slope + by_speed
        found = ca.mtimes(self._of_motor, torque + self.own["offset"] - losses)
        found -= ca.mtimes(self._of_link, bias)
        slopes = ca.mtimes(self._of_motor, slope)
        for k, joint in enumerate(self.loop._elastic):
            link, motor = int(self.loop._link[joint]), int(self.loop._motor[joint])
            damping = self.loop.physics.springs[joint].damping
            carried = place[self.n + k] + damping * (speed[motor] - speed[link])
            found[link] += carried
            found[motor] -= carried
            slopes[link] += damping
            slopes[motor] += damping
        return found, slopes

    def _drive(self, place: ca.SX, speed: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return torques of the actuators, losses of the drives and the slopes of both."""
        own, law = self.own, self.loop.law
        q, v = place[: self.n], ca.mtimes(self._of_motor.T, speed)
        # An actuator damps by the speed that it reads.
        error = _clip(self.kp * (self.command - q), law.drive_max)
        torque = _clip(error - self.kd * speed[: self.n], law.torque_max)
        direction = ca.tanh(v / self.width)
        dry = own["coulomb"] + own["friction_slope"] * (q - ca.DM(self.loop.middle))
        by_speed = own["viscous"] * v + own["drag"] * v * ca.fabs(v)
        # What of the torque reaches the load, past friction by the load as well.
        past = torque - dry * direction - by_speed
        size = ca.sqrt(past**2 + _LOAD_WIDTH**2)
        against = 1.0 + own["load_friction"] * direction * past / size
        dry += own["load_friction"] * (size - _LOAD_WIDTH) / against
        losses = dry * direction + by_speed
        slope = self.kd + own["viscous"] + dry / self.width * (1.0 - direction**2)
        return torque, losses, slope

    def _added(self, place: ca.SX, speed: ca.SX, rate: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the added torques at accelerations `rate`, and their slopes by the own speed."""
        physics, own = self.loop.physics, self.own
        assert physics.torque is not None
        torque, losses, _ = self._drive(place, speed)
        angle, link_speed, jacobian, drift = self._links(place, speed)
        faster = ca.mtimes(self._of_motor.T, rate)
        along = ca.mtimes(jacobian, ca.mtimes(self._of_link.T, rate)) + drift
        spring = ca.mtimes(
            jacobian.T, self._torque_of_links(self.loop.tree.gravity, angle, link_speed, along)
        )
        for k, joint in enumerate(self.loop._elastic):
            spring[joint] = place[self.n + k]
        # Speed and direction are one: both give the slope by which stages are stable.
        v = ca.SX.sym("v", self.n)
        way = ca.tanh(v / self.width)
        drive = spring + losses + own["armature"] * faster
        signals = LoopSignals(place[: self.n], v, faster, way, torque, spring, drive)
        more = physics.torque(signals)
        by_speed = ca.diag(ca.jacobian(more, v))
        actual = ca.mtimes(self._of_motor.T, speed)
        more, by_speed = ca.substitute([more, by_speed], [v], [actual])
        return more, by_speed

    def rates(self, place: ca.SX) -> ca.SX:
        """Return the rates of the places per speed."""
        found = ca.SX(place.shape[0], place.shape[0])
        found[: self.n, : self.n] = ca.DM.eye(self.n)
        for k, joint in enumerate(self.loop._elastic):
            stiffness = 1.0 / self._compliance(joint, place[self.n + k])
            found[self.n + k, int(self.loop._motor[joint])] += stiffness
            found[self.n + k, int(self.loop._link[joint])] -= stiffness
        return found

    def slopes(self, place: ca.SX) -> ca.SX:
        """Return the decrease of the forces per place, of gains and springs alone.

        Gains count as if encoders were at the motors: so the stages stay symmetric.
        """
        count = place.shape[0]
        found = ca.SX(count, count)
        for joint in range(self.n):
            found[int(self.loop._motor[joint]), joint] = self.kp[joint]
        for k, joint in enumerate(self.loop._elastic):
            link, motor = int(self.loop._link[joint]), int(self.loop._motor[joint])
            found[motor, self.n + k] += 1.0
            found[link, self.n + k] -= 1.0
            if self.loop.physics.springs[joint].encoder_at_output:
                compliance = self._compliance(joint, place[self.n + k])
                found[motor, self.n + k] += self.kp[joint] * compliance
        return found

    def _compliance(self, joint: int, torque: ca.SX) -> ca.SX:
        load = ca.SX.sym("s")
        slope = ca.jacobian(self.loop.physics.springs[joint].windup(load), load)
        return ca.substitute(slope, load, torque)


def _clip(value: ca.SX, largest: np.ndarray) -> ca.SX:
    """Return a value within plus and minus `largest`, untouched where that is infinite."""
    return ca.vertcat(
        *(
            ca.fmax(ca.fmin(value[i], most), -most) if np.isfinite(most) else value[i]
            for i, most in enumerate(largest)
        )
    )


def _factorize(matrix: ca.SX, *, symmetric: bool) -> list[list[ca.SX]]:
    """Return triangular factors of a matrix (n, n) in one, which share their diagonal.

    Without pivots: masses outweigh what torques by accelerations add.
    """
    n = matrix.shape[0]
    factor: list[list[ca.SX]] = [[ca.SX(0)] * n for _ in range(n)]
    for i in range(n):
        for j in range(i):
            for row, column in ((i, j), (j, i)):
                rest = matrix[row, column]
                rest -= sum(factor[row][k] * factor[k][column] for k in range(j))
                factor[row][column] = rest / factor[j][j]
                if symmetric:
                    factor[j][i] = factor[i][j]
                    break
        rest = matrix[i, i] - sum(factor[i][k] * factor[k][i] for k in range(i))
        factor[i][i] = ca.sqrt(rest)
    return factor


def _solve(factor: list[list[ca.SX]], right: ca.SX) -> ca.SX:
    """Solve with the factors of a matrix."""
    n = len(factor)
    forward: list[ca.SX] = []
    for i in range(n):
        rest = right[i] - sum(factor[i][k] * forward[k] for k in range(i))
        forward.append(rest / factor[i][i])
    found: list[ca.SX] = [ca.SX(0)] * n
    for i in reversed(range(n)):
        rest = forward[i] - sum(factor[i][k] * found[k] for k in range(i + 1, n))
        found[i] = rest / factor[i][i]
    return ca.vertcat(*found)
