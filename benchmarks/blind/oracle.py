"""What an oracle sees that knows the structure, the exact motion and the sensors' noise.

It compares a case with the true robot without its effects, in the two balances whose noise is
white: torque read against what the motion needs, link angle read against motor angle less wind-up.
Nominal values it knows as the tool does, within their tolerances, and those are profiled out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.simulator import Case, build_world
from benchmarks.simulator.robots import Robot
from benchmarks.simulator.world import TOLERANCE, World

EDGE = 5  # samples left out at both ends
STRIDE = 4  # of the samples looked at; each stands for its neighbours
MOVING = 0.03  # slower than this, dry friction has no definite value [rad/s]
ROUNDING = 12.0**-0.5  # standard deviation of a rounding to one count
VOID = 1.2  # times the stated noise left by the oracle itself: the case proves nothing


@dataclass(frozen=True)
class Balances:
    """Effect and nuisances in units of the sensor noise.

    Parameters
    ----------
    effect : array (rows,)
    nuisance : array (rows, parameters)
        One standard deviation of each nominal value.
    """

    effect: np.ndarray
    nuisance: np.ndarray

    @property
    def z(self) -> float:
        """Standard deviations at which the effect is seen, nominal values profiled out."""
        e, g = self.effect, self.nuisance
        shared = g.T @ e
        inner = np.eye(g.shape[1]) + g.T @ g
        return float(np.sqrt(max(e @ e - shared @ np.linalg.solve(inner, shared), 0.0)))


def balances(case: Case) -> Balances:
    """Both balances of the training recordings; without link encoders the first alone."""
    healthy, _ = build_world(replace(case.spec, effects=()))
    parts = [_run(case, healthy, r) for r, run in enumerate(case.runs) if run.plan.role == "train"]
    return Balances(
        np.concatenate([e for e, _ in parts]) * np.sqrt(STRIDE),
        np.concatenate([g for _, g in parts]) * np.sqrt(STRIDE),
    )


@dataclass(frozen=True)
class _Motion:
    """Exact motion of one recording at some samples, and what it needs of rigid bodies."""

    motor: np.ndarray
    speed: np.ndarray
    motor_acceleration: np.ndarray
    windup_rate: np.ndarray
    regressor: np.ndarray  # of the links (K, n, 10 n)

    @property
    def moving(self) -> np.ndarray:
        return np.asarray(np.abs(self.speed) > MOVING)

    def predicted(self, world: World) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Drive torque before its constant, torque in the springs, wind-up: each (K, n)."""
        phi = np.concatenate([body.toDynamicParameters() for body in world.model.inertias[1:]])
        rigid = self.regressor @ phi
        elastic = rigid - world.robot.joint_damping * self.windup_rate
        windup = np.column_stack([w.deflection(elastic[:, j]) for j, w in enumerate(world.windups)])
        friction = world.coulomb * np.sign(self.speed) + world.viscous * self.speed
        return world.rotor_inertia * self.motor_acceleration + friction + rigid, elastic, windup


def _motion(case: Case, model: pin.Model, r: int, samples: np.ndarray) -> _Motion:
    """Motion along a recording; the regressor holds for gravity as in the model."""
    trace, at = case.trace, samples * case.spec.substeps
    inner = np.clip(at, 1, trace.motor.shape[1] - 2)

    def acceleration(position: np.ndarray) -> np.ndarray:
        second = position[inner + 1] - 2 * position[inner] + position[inner - 1]
        return np.asarray(second / trace.step**2)

    data = model.createData()
    rate = trace.link_velocity[r, at]
    states = zip(trace.link[r, at], rate, acceleration(trace.link[r]), strict=True)
    return _Motion(
        motor=trace.motor[r, at],
        speed=trace.motor_velocity[r, at],
        motor_acceleration=acceleration(trace.motor[r]),
        windup_rate=trace.motor_velocity[r, at] - rate,
        regressor=np.array(
            [pin.computeJointTorqueRegressor(model, data, *state).copy() for state in states]
        ),
    )


def _run(case: Case, healthy: World, r: int) -> tuple[np.ndarray, np.ndarray]:
    robot, clean, n = case.robot, case.runs[r].clean, case.robot.joints
    samples = np.arange(EDGE, len(clean["t"]) - EDGE, STRIDE)
    motion = _motion(case, healthy.model, r, samples)
    speed, motor_acc, moving = motion.speed, motion.motor_acceleration, motion.moving

    def read(letter: str) -> np.ndarray:
        return np.column_stack([clean[f"{letter}{j + 1}"][samples] for j in range(n)])

    needed, elastic, windup = motion.predicted(healthy)
    given = read("tau") * healthy.torque_constant
    total = given - needed
    bodies = motion.regressor @ _body_tangents(robot)
    drive = (
        -robot.rotor_inertia * TOLERANCE["rotor_inertia"] * motor_acc,
        -robot.coulomb * TOLERANCE["coulomb"] * np.sign(speed),
        -robot.viscous * TOLERANCE["viscous"] * speed,
        given * TOLERANCE["torque_constant"],
    )
    none = np.zeros((len(samples), n, n))
    noise = robot.torque_noise * case.spec.noise
    known = np.concatenate([-bodies, *map(_diagonal, drive), none, none], axis=2)
    rows, columns = [(total / noise)[moving]], [(known / noise[:, None])[moving]]
    if case.spec.link_encoders:
        fine = np.hypot(robot.link_noise * case.spec.noise, robot.link_count * ROUNDING)
        off = motion.motor - read("ql") + healthy.link_zero - windup
        own = (windup * TOLERANCE["stiffness"], np.full_like(windup, TOLERANCE["encoder_zero"]))
        soft = -_compliance(healthy, robot, elastic)[:, :, None] * bodies
        known = np.concatenate([soft, *[none] * 4, *map(_diagonal, own)], axis=2)
        rows.append((off / fine).ravel())
        columns.append((known / fine).reshape(-1, known.shape[2]))
    return np.concatenate(rows), case.spec.tolerance * np.concatenate(columns)


def _diagonal(values: np.ndarray) -> np.ndarray:
    """(K, n) -> (K, n, n), each joint its own parameter."""
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


def _body_tangents(robot: Robot) -> np.ndarray:
    """Change of the dynamic parameters by one standard deviation of masses and centres."""
    model = robot.model()
    columns = []
    for j in range(robot.joints):
        body = model.inertias[j + 1]
        place = slice(10 * j, 10 * j + 10)
        for change in (None, *np.eye(3)):
            column = np.zeros(10 * robot.joints)
            if change is None:
                column[place] = TOLERANCE["mass"] * body.toDynamicParameters()
            else:
                moved = pin.Inertia(body.mass, body.lever + TOLERANCE["com"] * change, body.inertia)
                column[place] = moved.toDynamicParameters() - body.toDynamicParameters()
            columns.append(column)
    return np.column_stack(columns)


def _compliance(world: World, robot: Robot, torque: np.ndarray) -> np.ndarray:
    """Slope of each wind-up (K, n) [rad/(N m)]."""
    step = 1e-4 * robot.torque_rated
    return np.column_stack(
        [
            (w.deflection(torque[:, j] + step[j]) - w.deflection(torque[:, j] - step[j]))
            / (2 * step[j])
            for j, w in enumerate(world.windups)
        ]
    )


def held_out(case: Case) -> dict[str, Any]:
    """What the oracle leaves of the held-out runs: reading less exact signal, over the noise."""
    believed, robot = case.spec.noise * case.spec.stated_noise, case.robot
    fine = np.hypot(robot.link_noise * believed, robot.link_count * ROUNDING)
    stated = {"tau": robot.torque_noise * believed, "ql": np.full(robot.joints, fine)}
    runs = []
    squares: dict[str, list[float]] = {"test": [], "extrapolate": []}
    for run in case.runs:
        if run.plan.role not in squares:
            continue
        channels = {}
        for j in range(case.robot.joints):
            moving = np.abs(run.clean[f"qd{j + 1}"]) >= MOVING
            for letter, noise in stated.items():
                name = f"{letter}{j + 1}"
                if name not in run.columns:
                    continue
                left = (run.columns[name] - run.clean[name]) / noise[j]
                if letter == "tau":
                    left = left[moving]
                if len(left):
                    channels[name] = float(np.sqrt(np.mean(left**2)))
                    squares[run.plan.role] += (left**2).tolist()
        nrmse = float(np.sqrt(np.mean([v**2 for v in channels.values()])))
        runs.append(
            {"run": run.plan.name, "role": run.plan.role, "nrmse": nrmse, "channels": channels}
        )
    whole = {
        role: float(np.sqrt(np.mean(values))) if values else None
        for role, values in squares.items()
    }
    return {"runs": runs, **whole, "void": (whole["test"] or 0.0) > VOID}


def without_effects(case: Case, r: int, *, tolerances: bool) -> dict[str, np.ndarray]:
    """Signals that a recording's exact motion would give in a robot that lacks nothing.

    Parameters
    ----------
    case : Case
    r : int
        Of the recording.
    tolerances : bool
        Of the true robot less its effects; otherwise of the nominal one.

    Returns
    -------
    dict
        Columns "t", and for each joint "tau" and, with link encoders, "ql".
    """
    scale = case.spec.tolerance if tolerances else 0.0
    world, _ = build_world(replace(case.spec, effects=(), tolerance=scale))
    time = case.runs[r].clean["t"]
    motion = _motion(case, world.model, r, np.arange(len(time)))
    needed, _, windup = motion.predicted(world)
    torque, link = needed / world.torque_constant, motion.motor - windup + world.link_zero
    columns = {"t": time}
    for j in range(case.robot.joints):
        columns[f"tau{j + 1}"] = torque[:, j]
        if case.spec.link_encoders:
            columns[f"ql{j + 1}"] = link[:, j]
    return columns
