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

from tests.simulator import Case, build_world
from tests.simulator.robots import Robot
from tests.simulator.world import TOLERANCE, World

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


def _run(case: Case, healthy: World, r: int) -> tuple[np.ndarray, np.ndarray]:
    trace, robot, every = case.trace, case.robot, case.spec.substeps
    clean, n = case.runs[r].clean, robot.joints
    samples = np.arange(EDGE, len(clean["t"]) - EDGE, STRIDE)
    at = samples * every

    def read(letter: str) -> np.ndarray:
        return np.column_stack([clean[f"{letter}{j + 1}"][samples] for j in range(n)])

    def acceleration(position: np.ndarray) -> np.ndarray:
        return (position[at + 1] - 2 * position[at] + position[at - 1]) / trace.step**2

    motor, link = trace.motor[r], trace.link[r]
    speed, rate = trace.motor_velocity[r, at], trace.link_velocity[r, at]
    motor_acc, link_acc = acceleration(motor), acceleration(link)
    data = healthy.model.createData()
    phi = np.concatenate([body.toDynamicParameters() for body in healthy.model.inertias[1:]])
    regressor = np.array(
        [
            pin.computeJointTorqueRegressor(healthy.model, data, q, v, a)
            for q, v, a in zip(link[at], rate, link_acc, strict=True)
        ]
    )
    rigid = regressor @ phi
    damping = robot.joint_damping * (speed - rate)
    elastic = rigid - damping
    windup = np.column_stack([healthy.windups[j].deflection(elastic[:, j]) for j in range(n)])
    given = read("tau") * healthy.torque_constant
    friction = healthy.coulomb * np.sign(speed) + healthy.viscous * speed
    total = given - healthy.rotor_inertia * motor_acc - friction - rigid
    moving = np.abs(speed) > MOVING
    bodies = regressor @ _body_tangents(robot)
    drive = [
        -bodies,
        *(
            _diagonal(column)
            for column in (
                -robot.rotor_inertia * TOLERANCE["rotor_inertia"] * motor_acc,
                -robot.coulomb * TOLERANCE["coulomb"] * np.sign(speed),
                -robot.viscous * TOLERANCE["viscous"] * speed,
                given * TOLERANCE["torque_constant"],
            )
        ),
    ]
    noise = np.asarray(robot.torque_noise) * case.spec.noise
    rows = [_masked(total / noise, moving)]
    columns = [_masked(np.concatenate(drive, axis=2) / noise[:, None], moving)]
    elastic_columns = 2 * n
    if case.spec.link_encoders:
        slope = _compliance(healthy, robot, elastic)
        fine = np.hypot(robot.link_noise * case.spec.noise, robot.link_count * ROUNDING)
        off = motor[at] - read("ql") + healthy.link_zero - windup
        known = np.concatenate(
            [
                -slope[:, :, None] * bodies,
                np.zeros((len(at), n, 4 * n)),
                _diagonal(windup * TOLERANCE["stiffness"]),
                _diagonal(np.full_like(windup, TOLERANCE["encoder_zero"])),
            ],
            axis=2,
        )
        rows.append((off / fine).ravel())
        columns.append((known / fine).reshape(-1, known.shape[2]))
    else:
        elastic_columns = 0
    padded = np.zeros((len(columns[0]), elastic_columns))
    columns[0] = np.hstack([columns[0], padded])
    return np.concatenate(rows), case.spec.tolerance * np.concatenate(columns)


def _masked(values: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """(K, n, ...) -> rows of what is kept."""
    return np.asarray(values[kept])


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
