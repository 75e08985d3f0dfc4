"""Diagnosis of ten minutes at 1 kHz and seven joints: time, memory, silence.

    python -m benchmarks.long_recording --work out/long [--seconds 600] [--runs 1]

The set is made once: a rigid arm of seven joints whose masses and centres are off, with friction of
which the model knows Coulomb and viscous alone. The diagnosis is a process of its own, of one
thread; its peak memory is that of the system's accounting.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.simulator import machines
from benchmarks.simulator.motion import _one_joint
from benchmarks.simulator.robots import Body, Robot

RATE = 1000.0  # [Hz]
TRAINED = 0.8  # share of the time
# Wanted: CPU time [s], memory [GiB], longest silence [s].
MOST = (180.0, 2.0, 5.0)
# Of the model, beside friction that it does not know: masses [-] and centres [m] are off.
MASS, CENTRE = 0.1, 0.01
SEED = 5
SINGLE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def seven_axes() -> Robot:
    """The simulator's six-axis arm with an upper arm that rolls."""
    arm = machines.ARM6
    bodies = list(arm.bodies)
    roll = Body(
        origin=(0, 0, 0.14),
        axis=(0.0, 0.0, 1.0),
        mass=2.6,
        com=(0.01, 0.005, 0.07),
        inertia=(0.02, 0.02, 0.008),
    )
    bodies[1] = replace(bodies[1], mass=3.4, com=(0, -0.01, 0.07))
    bodies[2:3] = [roll, replace(bodies[2], origin=(0, 0, 0.14))]
    of_joint = {
        name: np.insert(np.asarray(value), 2, value[..., 2], axis=-1)
        for name, value in vars(arm).items()
        if isinstance(value, np.ndarray) and value.shape[-1] == arm.joints
    }
    of_joint["centre"] = np.array([0.0, 0.4, 0.0, 0.1, 0.0, 0.6, 0.0])
    joints = (*arm.connections[:3], *arm.connections[2:])
    return replace(arm, name="arm7", bodies=tuple(bodies), connections=joints, **of_joint)


def write_set(folder: Path, seconds: float, runs: int) -> None:
    """Write the recording set, its training part cut into as many runs."""
    arm, rng = seven_axes(), np.random.default_rng(SEED)
    model = arm.model()
    for body in range(1, model.njoints):
        own = model.inertias[body]
        mass = own.mass * (1.0 + MASS * rng.standard_normal())
        lever = own.lever + CENTRE * rng.standard_normal(3)
        model.inertias[body] = pin.Inertia(mass, lever, own.inertia)
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text(arm.urdf(), encoding="utf-8")
    text = _head(arm)
    plan = [(f"train_{k + 1}", "train", TRAINED * seconds / runs) for k in range(runs)]
    for name, role, length in (*plan, ("test_1", "test", (1.0 - TRAINED) * seconds)):
        np.savez_compressed(folder / f"{name}.npz", **_recorded(arm, model, length, rng))
        text += f'\n[[runs]]\nfile = "{name}.npz"\nrole = "{role}"\n'
    (folder / "recordings.toml").write_text(text, encoding="utf-8")


def _head(arm: Robot) -> str:
    def named(letter: str) -> str:
        return ", ".join(f'"{letter}{j + 1}"' for j in range(arm.joints))

    return (
        'schema = 1\nname = "long"\ncitation = "made"\nlicence = "MIT"\nrobot = "robot.urdf"\n'
        f'joints = [{named("joint")}]\ntool_frame = "tool0"\n\n[signals]\ntime = "t"\n'
        f'position = [{named("q")}]\ntorque = [{named("tau")}]\ntorque_side = "motor"\n\n'
        f"[nominal]\ngear_ratio = {arm.gear_ratio.tolist()}\n"
        f"torque_max = {arm.torque_max.tolist()}\n"
    )


def _recorded(
    arm: Robot, model: Any, seconds: float, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Columns of one run; joint 2 has friction of its load, joint 4 that of Stribeck besides."""
    step, data = 1.0 / RATE, model.createData()
    steps = int(seconds / step)
    q = np.column_stack(
        [
            arm.centre[j] + _one_joint(steps, step, 0.5 * arm.speed_max[j], arm.reach[j], 0.42, rng)
            for j in range(arm.joints)
        ]
    )
    v = np.gradient(q, step, axis=0)
    a = np.gradient(v, step, axis=0)
    load = np.array([pin.rnea(model, data, *x).copy() for x in zip(q, v, a, strict=True)])
    sign = np.tanh(v / 2e-3)
    tau = load + arm.rotor_inertia * a + arm.coulomb * sign + arm.viscous * v
    tau[:, 1] += 0.06 * np.abs(load[:, 1]) * sign[:, 1]
    tau[:, 3] += 2.0 * sign[:, 3] * np.exp(-np.abs(v[:, 3]) / 0.08)
    tau += arm.torque_noise * rng.standard_normal(tau.shape)
    counted = np.round(q / arm.motor_count) * arm.motor_count
    return {
        "t": np.arange(steps) * step,
        **{f"q{j + 1}": counted[:, j] for j in range(arm.joints)},
        **{f"tau{j + 1}": tau[:, j] for j in range(arm.joints)},
    }


def diagnosed(folder: Path) -> Iterator[str]:
    """Diagnose a set in this process; a line a step, and what it took at the end."""
    from stiffopt.discovery.diagnose import diagnose

    begin = last = time.monotonic()
    silence = 0.0

    def said(what: str) -> None:
        nonlocal last, silence
        now = time.monotonic()
        silence, last = max(silence, now - last), now
        print(f"{now - begin:7.1f} s {_memory():5.2f} GiB  {what}", flush=True)

    diagnosis = diagnose(folder, progress=said)
    said("done")
    for finding in diagnosis.findings:
        label = finding.estimated.located.label
        yield f"{label} {finding.probability:.2f}"
    measured = (time.process_time(), _memory(), silence)
    for name, value, most in zip(("CPU s", "GiB", "s of silence"), measured, MOST, strict=True):
        yield f"{name}: {value:.2f} (at most {most:g})"


def _memory() -> float:
    """Largest so far [GiB]; Linux counts in KiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2.0**20


def main() -> None:
    """Make the set where it is not there yet, and diagnose it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--diagnose", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    folder = given.work / f"long_{given.seconds:g}_{given.runs}"
    if given.diagnose:
        for line in diagnosed(folder):
            print(line)
        return
    if not (folder / "recordings.toml").exists():
        write_set(folder, given.seconds, given.runs)
    command = [sys.executable, "-m", "benchmarks.long_recording", *sys.argv[1:], "--diagnose"]
    raise SystemExit(subprocess.run(command, env=os.environ | SINGLE, check=False).returncode)


if __name__ == "__main__":
    main()
