"""A pendulum on a servo that follows commands, simulated with a formula of its own."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np

URDF = """<?xml version="1.0"?>
<robot name="pendulum"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 -0.14"/>
<mass value="0.75"/><inertia ixx="0.002" iyy="0.002" izz="0.0002" ixy="0" ixz="0" iyz="0"/>
</inertial></link><joint name="servo" type="revolute"><parent link="base"/><child link="arm"/>
<origin xyz="0 0 0.5"/><axis xyz="0 1 0"/><limit lower="-3.1" upper="3.1" effort="8" velocity="8"/>
</joint></robot>
"""
MASS, LEVER, INERTIA, GRAVITY = 0.75, 0.14, 0.002, 9.81
KP, VISCOUS, COULOMB, ARMATURE, DELAY = 9.0, 0.25, 0.12, 0.015, 0.012
STEP, HELD = 0.01, 2
STRIBECK_SPEED = 0.1  # [rad/s]
WARMUP_SECONDS = 4.0
_SUBSTEPS = 200


@cache
def commanded_motion(
    seed: int,
    seconds: float = 8.0,
    gravity: float = GRAVITY,
    limit: float = np.inf,
    coulomb: float = COULOMB,
    stribeck: float = 0.0,
    integral: float = 0.0,
    warmup: float = 0.0,
    deadband: float = 0.0,
) -> tuple[np.ndarray, ...]:
    """Return time, held commands and positions (K,) of one run.

    `integral`: gain of the error's integral over that of the error [1/s]. `warmup`: dry friction
    that grows from the beginning of the run to its end [N m]. `deadband`: error that gives no
    torque [rad].
    """
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds / STEP)) * STEP
    smooth = sum(
        rng.uniform(0.3, 0.5) * np.sin(2.0 * np.pi * f * time + rng.uniform(0.0, 6.0))
        for f in (0.11, 0.23, 0.51, 0.9)
    )
    smooth = smooth * np.minimum(time / 0.5, 1.0)
    command = np.repeat(smooth[::HELD], HELD)[: len(time)]
    h, position = STEP / _SUBSTEPS, np.empty(len(time))
    q = v = lasting = 0.0
    about = INERTIA + MASS * LEVER**2 + ARMATURE
    late = round(DELAY / h)
    sent = np.repeat(command, _SUBSTEPS).tolist()
    warmed = np.expm1(-time / WARMUP_SECONDS) / np.expm1(-time[-1] / WARMUP_SECONDS)
    for k in range(len(time)):
        position[k] = q
        dry = coulomb + warmup * float(warmed[k])
        for s in range(_SUBSTEPS):
            u = sent[max(k * _SUBSTEPS + s - late, 0)]
            # Leapfrog, dry friction as an impulse that at most stops the link.
            q += 0.5 * h * v
            error = math.copysign(max(abs(u - q) - deadband, 0.0), u - q)
            lasting += h * integral * KP * error
            given = min(max(KP * error + lasting, -limit), limit)
            drive = given - MASS * gravity * LEVER * math.sin(q)
            slow = 0.5 * h * VISCOUS / about
            free = ((1.0 - slow) * v + h * drive / about) / (1.0 + slow)
            most = h * (dry + stribeck * math.exp(-((v / STRIBECK_SPEED) ** 2))) / about
            v = 0.0 if abs(free) < most else free - math.copysign(most, free)
            q += 0.5 * h * v
    return time, command, position + 2e-5 * rng.normal(size=len(time))


def write_servo_set(
    folder: Path, *, actuator: str = "", signals: str = "", runs: int = 3, **physics: float
) -> Path:
    """Write a set of runs, the last one held out; `signals` and `actuator` are TOML lines."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(URDF, encoding="utf-8")
    lines = ["schema = 1", 'name = "servo"', 'robot = "robot.urdf"', 'joints = ["servo"]']
    lines += [
        "[signals]",
        'time = "t"',
        'position = ["present_position"]',
        'command = ["goal_position"]',
        signals,
    ]
    lines += ["[actuator]", 'kind = "position_servo"', actuator] if actuator else []
    for k in range(runs):
        time, command, position = commanded_motion(k, **physics)
        np.savez(folder / f"run{k}.npz", t=time, goal_position=command, present_position=position)
        role = "test" if k == runs - 1 else "train"
        lines += ["[[runs]]", f'file = "run{k}.npz"', f'role = "{role}"']
    (folder / "recordings.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def state_drive(folder: Path) -> None:
    """State friction and rotor of the servo with narrow tolerances."""
    file = folder / "recordings.toml"
    stated = {"coulomb": COULOMB, "viscous": VISCOUS, "rotor_inertia": ARMATURE}
    lines = ["[nominal]", *(f"{key} = [{value}]" for key, value in stated.items())]
    lines += ["[tolerance]", "mass = 0.01", "com = 0.001", *(f"{key} = 0.05" for key in stated)]
    text = file.read_text()
    file.write_text(text.replace("[actuator]", "\n".join([*lines, "[actuator]"])))
