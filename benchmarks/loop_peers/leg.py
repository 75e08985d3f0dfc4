"""A recorded leg in MuJoCo: its runs, its model with servos, its simulation from commands."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

JOINTS = ("hip", "thigh", "calf")
# Servo gains that the recording's description states [N m/rad], [N m s/rad], torque limits [N m].
STIFFNESS, DAMPING, TORQUE_MAX = 20.0, 1.5, (23.7, 23.7, 45.43)
# The manufacturer's own guess of each joint [kg m^2], [N m s/rad], [N m].
GUESS = {"armature": 0.01, "damping": 0.6, "frictionloss": 0.2}
TIMESTEP = 2e-3  # [s]
# Commands at the beginning of a run that bound its initial velocity [s].
_BEGINNING_SECONDS = 0.05


@dataclass(frozen=True, eq=False)
class Run:
    """Recorded time (K,) [s], commands and positions (K, 3) [rad]."""

    time: np.ndarray
    command: np.ndarray
    position: np.ndarray

    @property
    def grid(self) -> np.ndarray:
        """Return the times (S,) at which simulation steps end [s]."""
        return TIMESTEP * np.arange(1, 1 + int(np.ceil(self.time[-1] / TIMESTEP)))

    def mean_command(self, delay: float) -> np.ndarray:
        """Return the commands (S, 3) of simulation steps, late by a delay [s], as step means."""
        ends = np.append(self.time[1:], 2.0 * self.time[-1] - self.time[-2])
        whole = np.cumsum(self.command * (ends - self.time)[:, None], axis=0)
        knots, sums = np.append(self.time[0], ends), np.vstack([np.zeros(3), whole])
        steps = np.append(0.0, self.grid) - delay
        early = np.minimum(steps, 0.0)[:, None] * self.command[0]
        at = np.column_stack([np.interp(steps, knots, own) for own in sums.T]) + early
        return np.diff(at, axis=0) / TIMESTEP


def read_run(path: Path) -> Run:
    """Read a run from its CSV."""
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))

    def columns(kind: str) -> np.ndarray:
        return np.array([[float(row[f"{kind}_{joint}"]) for joint in JOINTS] for row in rows])

    time = np.array([float(row["time"]) for row in rows])
    return Run(time - time[0], columns("command"), columns("position"))


def build_spec(urdf: Path) -> Any:
    """Return the leg with the manufacturer's friction and rotors, and position servos."""
    spec = mujoco.MjSpec.from_file(str(urdf))
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for name, largest in zip(JOINTS, TORQUE_MAX, strict=True):
        joint = spec.joint(name)
        for key, value in GUESS.items():
            set_value(joint, key, value)
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=STIFFNESS, kv=DAMPING)
        servo.forcerange = [-largest, largest]
        servo.forcelimited = True
        sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_JOINTPOS, objname=name)
        sensor.objtype = mujoco.mjtObj.mjOBJ_JOINT
    return spec


def set_value(joint: Any, key: str, value: float) -> None:
    """Set a value of a joint, of a polynomial its first coefficient: newer versions hold some."""
    own = getattr(joint, key)
    setattr(joint, key, [value, *own[1:]] if np.ndim(own) else value)


def initial_velocity(model: Any, run: Run, bias: np.ndarray) -> np.ndarray:
    """Return the velocity (3,) [rad/s] at which servos balance weight and friction at first.

    It lies between zero and the rate of the commands that follow: no second position is seen.
    """
    span = int(np.searchsorted(run.time, _BEGINNING_SECONDS))
    rate = (run.command[span] - run.command[0]) / run.time[span]
    data = mujoco.MjData(model)
    data.qpos[:] = run.position[0] - bias
    mujoco.mj_forward(model, data)
    driving = STIFFNESS * (run.command[0] - run.position[0]) - data.qfrc_bias
    driving -= np.sign(driving) * np.minimum(np.abs(driving), model.dof_frictionloss)
    viscous = np.reshape(model.dof_damping, (len(JOINTS), -1))[:, 0]
    found = driving / (DAMPING + viscous)
    return np.asarray(np.clip(found, np.minimum(rate, 0.0), np.maximum(rate, 0.0)))


def initial_state(model: Any, run: Run, bias: np.ndarray) -> np.ndarray:
    """Return the full physics state at the first row."""
    data = mujoco.MjData(model)
    data.qpos[:] = run.position[0] - bias
    data.qvel[:] = initial_velocity(model, run, bias)
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    return state


def simulate(
    models: Sequence[Any], run: Run, controls: Sequence[np.ndarray], biases: Sequence[np.ndarray]
) -> np.ndarray:
    """Return simulated readings (m, K, 3) of some models under their controls (S, 3) each."""
    starts = np.array([initial_state(each, run, b) for each, b in zip(models, biases, strict=True)])
    given = np.stack([c - b for c, b in zip(controls, biases, strict=True)])
    states, _ = rollout.rollout(list(models), [mujoco.MjData(models[0])], starts, given)
    count = len(JOINTS)
    time = np.append(0.0, run.grid)
    found = np.empty((len(models), len(run.time), count))
    for k, (path, start, bias) in enumerate(zip(states, starts, biases, strict=True)):
        angles = np.vstack([start[1 : 1 + count], path[:, 1 : 1 + count]]) + bias
        for j in range(count):
            found[k, :, j] = np.interp(run.time, time, angles[:, j])
    return found
