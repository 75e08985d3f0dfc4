"""Balances of a simulated case against its own robot without the effect, from exact signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from benchmarks.simulator import Case, build_world
from benchmarks.simulator.elasticity import SpringTable

EDGE = 5  # samples left out at both ends


def excess(case: Case) -> dict[str, np.ndarray]:
    """Root mean square of what each balance lacks, a value a joint, over the sensor noise.

    motor: torque read less inertia, healthy spring and friction; link: healthy spring less rigid
    body; deflection: read less the healthy wind-up; total: motor and link together. The robot
    compared with has the same tolerances and none of the effects, so nothing is left where
    nothing is missing.
    """
    healthy, _ = build_world(replace(case.spec, effects=()))
    trace, n, every = case.trace, case.robot.joints, case.spec.substeps
    table = SpringTable(healthy.windups, case.robot.torque_max)
    data = healthy.model.createData()
    rows: dict[str, list[np.ndarray]] = {k: [] for k in ("motor", "link", "deflection", "total")}
    for r, run in enumerate(case.runs):

        def column(letter: str, run=run) -> np.ndarray:
            return np.column_stack([run.clean[f"{letter}{j + 1}"] for j in range(n)])

        def acceleration(position: np.ndarray) -> np.ndarray:
            second = np.zeros_like(position)
            second[1:-1] = np.diff(position, 2, axis=0) / trace.step**2
            return second[::every]

        picked = slice(None, len(run.clean["t"]) * every, every)
        kept = slice(EDGE, len(run.clean["t"]) - EDGE)
        motor, link = trace.motor[r, picked], trace.link[r, picked]
        speed, rate = trace.motor_velocity[r, picked], trace.link_velocity[r, picked]
        read = column("ql") - healthy.link_zero
        damping = case.robot.joint_damping * (speed - rate)
        rigid = np.array(
            [
                pin.rnea(healthy.model, data, *state).copy()
                for state in zip(link, rate, acceleration(trace.link[r])[: len(link)], strict=True)
            ]
        )
        spring = table.torque(motor - read) + damping
        friction = healthy.coulomb * np.sign(speed) + healthy.viscous * speed
        inertia = healthy.rotor_inertia * acceleration(trace.motor[r])[: len(link)]
        given = column("tau") * healthy.torque_constant
        moving = np.abs(speed) > 0.03
        motor_rest = np.where(moving, given - inertia - spring - friction, np.nan)
        link_rest = spring - rigid
        windup = np.column_stack(
            [healthy.windups[j].deflection(rigid[:, j] - damping[:, j]) for j in range(n)]
        )
        rows["motor"].append(motor_rest[kept])
        rows["link"].append(link_rest[kept])
        rows["deflection"].append((motor - read - windup)[kept])
        rows["total"].append((motor_rest + link_rest)[kept])
    noise = {"deflection": np.full(n, case.robot.link_noise)}
    return {
        name: np.sqrt(np.nanmean(np.concatenate(parts) ** 2, axis=0))
        / noise.get(name, case.robot.torque_noise)
        for name, parts in rows.items()
    }
