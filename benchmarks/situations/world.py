"""A run of an arm under its servo: friction that holds at rest, sensors with noise and counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from .arms import GRAVITY, Arm

STEP = 0.002  # of the simulation [s]
BANDWIDTH = 25.0  # of the position loop [rad/s]
INTEGRAL = 4.0  # rate of its integral part [1/s]
SWEEPS = 12  # of projected Gauss-Seidel over the joints' friction, a step


@dataclass
class World:
    """The true arm with what is concealed; arrays (n,) by joint."""

    arm: Arm
    tilt: np.ndarray = field(default_factory=lambda: np.zeros(2))  # about x and y of the base [rad]
    payload: float = 0.0  # [kg] at `payload_at` [m] from the tool
    payload_at: np.ndarray = field(default_factory=lambda: np.zeros(3))
    carried: float = 0.0  # [kg], in part of every run
    carried_at: np.ndarray = field(default_factory=lambda: np.zeros(3))
    carried_share: tuple[float, float] = (0.3, 0.7)  # of the run
    force: np.ndarray = field(default_factory=lambda: np.zeros(3))  # at the tool, base axes [N]
    push_run: int = -1  # in which somebody pushes
    push: np.ndarray = field(default_factory=lambda: np.zeros(3))  # [N]
    asymmetry: np.ndarray | float = 0.0  # share of friction added forward, taken off backward
    drag: np.ndarray | float = 0.0  # [N m s^2/rad^2]
    spring: np.ndarray | float = 0.0  # of a balancer, k (q - q1) [N m/rad]
    spring_at: float = 0.0
    limits: np.ndarray | float = np.inf  # of the drives [N m]
    friction: Callable[[int, float], np.ndarray | float] = lambda run, session: 1.0
    zeros: np.ndarray | float = 0.0  # added to the angle read [rad]
    gains: np.ndarray | float = 1.0  # of the torque read
    delays: np.ndarray | float = 0.0  # of the torque read [s]
    lag: float = 0.0  # time constant of the torque read [s]
    leak: tuple[int, int, float] | None = None  # (to, from, share)
    dead: int = -1

    def run(
        self, number: int, start: float, way: np.ndarray, rng: np.random.Generator, every: int
    ) -> np.ndarray:
        """Time, angles and torques (K, 1 + 2 n) as logged; `way` (T, n) is asked for."""
        angles, torques = self._simulate(number, start, way)
        n, peak = way.shape[1], np.max(np.abs(torques), axis=0)
        read = torques * self.gains
        delays = np.broadcast_to(self.delays, n)
        for k in range(n):
            late = round(delays[k] / STEP)
            read[:, k] = np.concatenate([np.repeat(read[:1, k], late), read[:, k]])[: len(read)]
        if self.lag:
            kept = np.exp(-STEP / self.lag)
            within = 0.5 * (read[1:] + read[:-1])
            for k in range(1, len(read)):
                read[k] = kept * read[k - 1] + (1.0 - kept) * within[k - 1]
        read = read + rng.normal(0.0, 0.006 * peak + 1e-9, read.shape)
        if self.leak:
            to, source, share = self.leak
            read[:, to] += share * read[:, source]
        if self.dead >= 0:
            read[:, self.dead] = 0.0
        seen = np.round((angles + self.zeros + rng.normal(0.0, 1e-5, angles.shape)) / 2e-5) * 2e-5
        time = start + STEP * np.arange(len(way))
        return np.column_stack([time, seen, read])[::every]

    def _simulate(
        self, number: int, start: float, way: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        arm, n = self.arm, way.shape[1]
        model = arm.model()
        tilted = pin.exp3(np.array([*self.tilt, 0.0])).T @ np.array([0.0, 0.0, -GRAVITY])
        model.gravity.linear = tilted
        _load(model, n, self.payload, arm.tool + self.payload_at)
        with_part = model.copy()
        _load(with_part, n, self.carried, arm.tool + self.carried_at)
        own = arm.model()  # as the controller knows it
        frame, ticks = own.getFrameId("tool"), len(way)
        velocity = np.gradient(way, STEP, axis=0)
        acceleration = np.gradient(velocity, STEP, axis=0)
        q, v, wound = way[0].copy(), np.zeros(n), np.zeros(n)
        datas = model.createData(), with_part.createData(), own.createData()
        angles, torques = np.empty((ticks, n)), np.empty((ticks, n))
        for k in range(ticks):
            part = self.carried_share[0] <= k / ticks < self.carried_share[1]
            true, data = (with_part, datas[1]) if part else (model, datas[0])
            mass = pin.crba(true, data, q)
            mass = np.triu(mass) + np.triu(mass, 1).T + np.diag(arm.rotors)
            error, slip = way[k] - q, velocity[k] - v
            wound += INTEGRAL * STEP * error
            lead = pin.rnea(own, datas[2], way[k], velocity[k], acceleration[k])
            stiff = BANDWIDTH**2 * np.diag(mass)
            asked = lead + arm.rotors * acceleration[k] + stiff * (error + wound)
            asked = asked + 2.0 * BANDWIDTH * np.diag(mass) * slip
            drive = np.clip(asked, -self.limits, self.limits)
            outside = np.zeros(n)
            outside += self.spring * (q - self.spring_at)
            force = self.force + (self.push if self._pushed(number, k / ticks) else 0.0)
            if np.any(force):
                jacobian = pin.computeFrameJacobian(
                    own, datas[2], q, frame, pin.LOCAL_WORLD_ALIGNED
                )[:3]
                outside = outside - jacobian.T @ force
            bias = pin.nonLinearEffects(true, data, q, v) + outside
            inverse = np.linalg.inv(mass)
            free = v + STEP * inverse @ (drive - bias)
            v = free - inverse @ self._rubbing(number, start + k * STEP, v, free, inverse)
            angles[k], torques[k] = q, drive
            q = q + STEP * v
        return angles, torques

    def _pushed(self, number: int, share: float) -> bool:
        return number == self.push_run and 0.4 <= share < 0.55

    def _rubbing(
        self, number: int, session: float, v: np.ndarray, free: np.ndarray, inverse: np.ndarray
    ) -> np.ndarray:
        """Impulses of friction (n,) [N m s] that stop a joint where they can."""
        arm, speed = self.arm, np.abs(v)
        level = arm.dry + arm.viscous * speed + self.drag * speed**2
        level = level + arm.slow * np.exp(-((speed / arm.slow_speed) ** 2))
        level = STEP * level * self.friction(number, session)
        aside = (level * self.asymmetry).tolist()
        most, rows, given = level.tolist(), inverse.tolist(), [0.0] * len(v)
        now = free.tolist()
        for _ in range(SWEEPS):
            for j, row in enumerate(rows):
                own = now[j] + row[j] * given[j]
                new = min(max(own / row[j], aside[j] - most[j]), aside[j] + most[j])
                if new != given[j]:
                    change, given[j] = new - given[j], new
                    now = [value - other * change for value, other in zip(now, row, strict=True)]
        return np.array(given)


def _load(model: pin.Model, joint: int, mass: float, place: np.ndarray) -> None:
    if mass:
        small = 0.4 * mass * 0.03**2 * np.eye(3)
        model.appendBodyToJoint(joint, pin.Inertia(mass, place, small), pin.SE3.Identity())


def program(
    rng: np.random.Generator, arm: Arm, seconds: float, stations: np.ndarray, pace: float
) -> np.ndarray:
    """Angles (T, n) asked for: quintic moves from station to station with rests between."""
    parts, here, ticks = [], stations[0], 0
    turn = 0
    while ticks * STEP < seconds:
        turn += 1
        there = stations[turn % len(stations)]
        least = np.max(np.abs(there - here) / arm.speeds) * 1.875
        moving = max(int(np.ceil(least / pace / STEP)), 50)
        s = np.linspace(0.0, 1.0, moving)[:, None]
        parts += [here + (10 * s**3 - 15 * s**4 + 6 * s**5) * (there - here)]
        parts += [np.repeat(there[None], int(rng.uniform(0.25, 0.9) / STEP), axis=0)]
        ticks += len(parts[-1]) + moving
        here = there
    return np.vstack(parts)
