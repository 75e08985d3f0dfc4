"""Equation of motion of a loop: forces, masses and rates by readings, spring torques and speeds."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from stiffopt.closed_loop.dry_friction import Levels, friction_torque
from stiffopt.closed_loop.physics import LoopSignals, factorize, solve
from stiffopt.dynamics.newton_euler import torque_of_bodies

if TYPE_CHECKING:
    from stiffopt.closed_loop.arm import CommandedArm

# Rounding of the magnitude of the torque that load friction goes with [N m].
_LOAD_WIDTH = 0.02


class Balance:
    """Equation of motion of a loop at a place (readings, spring torques) and a speed."""

    def __init__(
        self,
        loop: CommandedArm,
        own: Mapping[str, ca.SX],
        bodies: tuple[ca.SX, ...],
        command: ca.SX,
        place: ca.SX,
        speed: ca.SX,
    ) -> None:
        self.loop, self.own, self.bodies = loop, own, bodies
        self.n, self.command = loop.n, command
        self.place, self.speed = place, speed
        law = loop.law
        stiffness = np.where(np.isfinite(law.stiffness), law.stiffness, 0.0)
        self.kp = ca.DM(stiffness) * (1.0 + own["gain"])
        self.kd = ca.DM(law.damping) * (1.0 + own["damping"])
        count = loop.n + len(loop.elastic)
        self._of_link, self.of_motor = (
            ca.sparsify(ca.DM(np.eye(count)[:, each]))
            for each in (loop.link_sides, loop.motor_sides)
        )

    def _links(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Return angles and speeds of the links, their Jacobian, and accelerations at no other."""
        q, jacobian = self.place[: self.n], ca.SX(ca.DM.eye(self.n))
        angle, rate = q - self.own["zero"], ca.mtimes(self._of_link.T, self.speed)
        drift = ca.SX.zeros(self.n)
        for k, joint in enumerate(self.loop.elastic):
            spring = self.loop.physics.springs[joint]
            if not spring.encoder_at_output:
                angle[joint] -= spring.windup(self.place[self.n + k])
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

    @cached_property
    def _still(self) -> tuple[ca.SX, ca.SX]:
        """Inertia (n, n) of the links, and their torques without acceleration."""
        angle, rate, jacobian, drift = self._links()
        bias = self._torque_of_links(self.loop.tree.gravity, angle, rate, drift)
        # Displaced links work along their readings.
        return self._inertia(angle, jacobian), ca.mtimes(jacobian.T, bias)

    @cached_property
    def mass(self) -> ca.SX:
        """Forces of all sides per acceleration."""
        found = ca.mtimes([self._of_link, self._still[0], self._of_link.T])
        found += ca.mtimes([self.of_motor, ca.diag(self.own["armature"]), self.of_motor.T])
        if self.loop.physics.torque is not None:
            rate = ca.SX.sym("a", self.speed.shape[0])
            added, _ = self._added(rate, ca.sign(self.motor_speed))
            found += ca.mtimes(self.of_motor, ca.jacobian(added, rate))
        return found

    def factorize(self, matrix: ca.SX) -> list[list[ca.SX]]:
        """Return triangular factors of the mass, or of it with gains and springs added."""
        # Torques of the physics may depend on accelerations anyhow.
        return factorize(matrix, symmetric=self.loop.physics.torque is None)

    @property
    def motor_speed(self) -> ca.SX:
        """Speeds (n,) of the motors."""
        return ca.mtimes(self.of_motor.T, self.speed)

    def acceleration(self, friction: ca.SX) -> ca.SX:
        """Return the accelerations of all sides with some dry friction (n,)."""
        return solve(self._factor, self.force[0] - ca.mtimes(self.of_motor, friction))

    @cached_property
    def _factor(self) -> list[list[ca.SX]]:
        return self.factorize(self.mass)

    @cached_property
    def force(self) -> tuple[ca.SX, ca.SX]:
        """Forces that accelerate but for dry friction, and the slopes of all losses by the speeds.

        Negative slopes are left out: they stay explicit.
        """
        torque, losses, slope = self._drive
        past, bias = torque + self.own["offset"] - losses, self._still[1]
        found = ca.mtimes(self.of_motor, past) - ca.mtimes(self._of_link, bias)
        if self.loop.physics.torque is not None:
            still = ca.SX.zeros(self.speed.shape[0])
            found -= ca.mtimes(self.of_motor, self._added(still, ca.SX.zeros(self.n))[0])
            slope += self._added(still, ca.sign(self.motor_speed))[1]
        slopes = ca.diag(ca.mtimes(self.of_motor, ca.fmax(slope, 0.0)))
        for k, joint in enumerate(self.loop.elastic):
            link, motor = int(self.loop.link_sides[joint]), int(self.loop.motor_sides[joint])
            damping = self.loop.physics.springs[joint].damping
            carried = self.place[self.n + k] + damping * (self.speed[motor] - self.speed[link])
            found[link] += carried
            found[motor] -= carried
            for side, other in ((link, motor), (motor, link)):
                slopes[side, side] += damping
                slopes[side, other] -= damping
        return found, slopes

    @cached_property
    def _own_levels(self) -> Levels:
        """Dry friction (n,) against either direction but for that by load."""
        if self.loop.physics.torque is None:
            return self._dry, self._dry
        still = ca.SX.zeros(self.speed.shape[0])
        rest, forth, back = (
            self._added(still, way * ca.SX.ones(self.n))[0] for way in (0.0, 1.0, -1.0)
        )
        return self._dry + forth - rest, self._dry + rest - back

    def friction_levels(self, share: ca.SX) -> Levels:
        """Return the dry friction (n,) against motion in the positive and the negative direction.

        `share` (n,): of the friction without that by load, -1 to 1, at which gears transmit their
        loads. That by load goes with the torque that a gear transmits to its link; a rotor takes
        its share of it, and of the friction.
        """
        own, levels = self.own, self._own_levels
        friction = friction_torque(share, levels)
        torque, losses, _ = self._drive
        past = torque + own["offset"] - losses - friction
        turned = ca.mtimes(self.of_motor.T, self.acceleration(friction))
        load = past - own["armature"] * turned
        taken = 1.0 - own["armature"] / ca.mtimes(self.of_motor.T, ca.diag(self.mass))
        for k, joint in enumerate(self.loop.elastic):
            load[joint], taken[joint] = self.place[self.n + k], 0.0
        found = []
        for way, level in zip((1.0, -1.0), levels, strict=True):
            there = load - taken * (way * level - friction)
            size = ca.sqrt(there**2 + _LOAD_WIDTH**2)
            against = 1.0 + own["load_friction"] * taken * way * there / size
            found.append(level + own["load_friction"] * there**2 / size / against)
        return found[0], found[1]

    @property
    def _dry(self) -> ca.SX:
        """Dry friction (n,) of the drives by no load; none where its slope leads below that."""
        away = self.place[: self.n] - ca.DM(self.loop.middle)
        level = self.own["coulomb"] + self.own["friction_slope"] * away
        # Not `fmax`, whose slope at none, where fits begin, is a half.
        return ca.if_else(level < 0.0, 0.0, level)

    @cached_property
    def _drive(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Torques of the actuators, viscous losses of the drives, and their slopes."""
        own, law, v = self.own, self.loop.law, self.motor_speed
        # An actuator damps by the speed that it reads.
        error = self.command - self.place[: self.n]
        error -= _within(error, own["deadband"])
        drive = _clip(self.kp * error, law.drive_max)
        torque = _clip(drive - self.kd * self.speed[: self.n], law.torque_max)
        for joint, largest in self.loop.physics.limits.items():
            within = self.loop.physics.damped.get(joint, 0.0) * own["viscous"][joint] * v[joint]
            torque[joint] = _within(torque[joint] - within, largest) + within
        losses = own["viscous"] * v + own["drag"] * v * ca.fabs(v)
        return torque, losses, self.kd + own["viscous"]

    def _added(self, rate: ca.SX, direction: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the added torques at accelerations `rate`, and their slopes by the own speed.

        `direction` (n,): of motion, -1 to 1.
        """
        physics, own = self.loop.physics, self.own
        assert physics.torque is not None
        torque, losses, _ = self._drive
        inertia, bias = self._still
        faster = ca.mtimes(self.of_motor.T, rate)
        spring = bias + ca.mtimes([inertia, self._of_link.T, rate])
        for k, joint in enumerate(self.loop.elastic):
            spring[joint] = self.place[self.n + k]
        v = ca.SX.sym("v", self.n)
        drive = spring + losses + self._dry * direction + own["armature"] * faster
        signals = LoopSignals(self.place[: self.n], v, faster, direction, torque, spring, drive)
        more = physics.torque(signals)
        by_speed = ca.diag(ca.jacobian(more, v))
        more, by_speed = ca.substitute([more, by_speed], [v], [self.motor_speed])
        return more, by_speed

    @property
    def rates(self) -> ca.SX:
        """Rates of the places per speed."""
        count = self.place.shape[0]
        found = ca.SX(count, count)
        found[: self.n, : self.n] = ca.DM.eye(self.n)
        for k, joint in enumerate(self.loop.elastic):
            stiffness = 1.0 / self._compliance(joint, self.place[self.n + k])
            found[self.n + k, int(self.loop.motor_sides[joint])] += stiffness
            found[self.n + k, int(self.loop.link_sides[joint])] -= stiffness
        return found

    @property
    def slopes(self) -> ca.SX:
        """Decrease of the forces per place, of gains and springs alone.

        Gains count as if encoders were at the motors: so the stages stay symmetric.
        """
        count = self.place.shape[0]
        found = ca.SX(count, count)
        for joint in range(self.n):
            found[int(self.loop.motor_sides[joint]), joint] = self.kp[joint]
        for k, joint in enumerate(self.loop.elastic):
            link, motor = int(self.loop.link_sides[joint]), int(self.loop.motor_sides[joint])
            found[motor, self.n + k] += 1.0
            found[link, self.n + k] -= 1.0
            if self.loop.physics.springs[joint].encoder_at_output:
                compliance = self._compliance(joint, self.place[self.n + k])
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
            _within(value[i], most) if np.isfinite(most) else value[i]
            for i, most in enumerate(largest)
        )
    )


def _within(value: ca.SX, largest: ca.SX | float) -> ca.SX:
    """Return a value within plus and minus `largest`."""
    return ca.fmax(ca.fmin(value, largest), -largest)
