"""Motions to record: random, smooth, within limits, with slow passages, reversals and dwells."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.signal import fftconvolve

from .robots import Robot
from .spec import CaseSpec, RunPlan

LEAD = 0.25  # at rest before the recording begins [s]
TORQUE_USED = 0.62  # of the peak torque, at most


def run_plans(spec: CaseSpec, joints: int, rng: np.random.Generator) -> tuple[RunPlan, ...]:
    """Names, roles and the moments in the session: the robot warms up from 22 degC."""
    rise = rng.uniform(13.0, 18.0, joints)
    train = np.linspace(0.0, 1.0, max(spec.train, 2))[: spec.train] ** 1.7 * 2000.0
    plans = [(f"train_{i + 1}", "train", t) for i, t in enumerate(train)]
    later = np.linspace(1100.0, 2700.0, max(spec.test, 1))[: spec.test]
    plans += [(f"test_{i + 1}", "test", t) for i, t in enumerate(later)]
    plans += [
        (f"extrap_{i + 1}", "extrapolate", 3000.0 + 300.0 * i) for i in range(spec.extrapolate)
    ]
    return tuple(
        RunPlan(
            name=name,
            role=role,
            session_time=round(float(time), 1),
            temperature=22.0 + rise * (1.0 - np.exp(-time / 1000.0)),
        )
        for name, role, time in plans
    )


def _bell(width: float, step: float) -> np.ndarray:
    """Smooth averaging window, three times continuously differentiable."""
    half = max(round(width / step / 2), 2)
    bell = np.cos(np.linspace(-np.pi / 2, np.pi / 2, 2 * half + 1)) ** 4
    return np.asarray(bell / bell.sum())


def _one_joint(
    steps: int, step: float, speed: float, reach: float, width: float, rng: np.random.Generator
) -> np.ndarray:
    """Ramps of random speed between turning points, some slow, some at rest; then smoothed."""
    path = np.empty(steps)
    place, k = float(rng.uniform(-0.5, 0.5) * reach), int(LEAD / step)
    path[:k] = place
    while k < steps:
        kind = rng.uniform()
        if kind < 0.13:
            rate, seconds = 0.0, rng.uniform(0.15, 0.45)
        else:
            slow = kind < 0.38
            rate = rng.uniform(0.02, 0.16) if slow else speed * rng.uniform(0.3, 1.0)
            seconds = rng.uniform(0.35, 0.9) if slow else rng.uniform(0.25, 0.9)
            # Away from the middle the way back is likelier.
            rate *= (
                -np.sign(place)
                if rng.uniform() < 0.5 + 0.5 * abs(place) / reach
                else np.sign(place)
            )
        end = float(np.clip(place + rate * seconds, -reach, reach))
        count = min(
            int(abs(end - place) / abs(rate) / step) if rate else int(seconds / step), steps
        )
        count = max(count, 1)
        stop = min(k + count, steps)
        path[k:stop] = place + (end - place) * np.arange(1, stop - k + 1) / count
        place, k = float(path[stop - 1]), stop
    bell = _bell(width, step)
    half = len(bell) // 2
    padded = np.concatenate([np.full(half, path[0]), path, np.full(half, path[-1])])
    return np.asarray(fftconvolve(padded, bell, mode="valid"))


def references(
    spec: CaseSpec, robot: Robot, plans: tuple[RunPlan, ...], rng: np.random.Generator
) -> np.ndarray:
    """Positions asked of each joint at every integration step: (runs, steps, n) [rad].

    The extrapolating runs are half again as fast, a quarter wider and turn more sharply.
    """
    step = 1.0 / (spec.rate * spec.substeps)
    steps = round((spec.seconds + LEAD) / step) + 1
    result = np.empty((len(plans), steps, robot.joints))
    seeds = rng.integers(0, 2**63, size=len(plans))
    for r, plan in enumerate(plans):
        beyond = plan.role == "extrapolate"
        wide, fast, sharp = (1.25, 1.5, 0.8) if beyond else (1.0, 1.0, 1.0)
        pace = 1.0
        for _ in range(12):
            draw = np.random.default_rng(seeds[r])
            for j in range(robot.joints):
                speed = 0.5 * robot.speed_max[j] * fast * pace
                result[r, :, j] = robot.centre[j] + _one_joint(
                    steps, step, speed, robot.reach[j] * wide, spec.smoothing * sharp / pace, draw
                )
            peak = np.abs(nominal_torque(robot, result[r], step, 10)).max(axis=0)
            if np.all(peak <= TORQUE_USED * robot.torque_max * (1.2 if beyond else 1.0)):
                break
            pace *= 0.88
    return result


def nominal_torque(robot: Robot, motion: np.ndarray, step: float, stride: int) -> np.ndarray:
    """Drive torque of the rigid nominal robot along one motion, every stride-th step (k, n)."""
    model = robot.model()
    data = model.createData()
    velocity = np.gradient(motion, step, axis=0)
    acceleration = np.gradient(velocity, step, axis=0)[::stride]
    motion, velocity = motion[::stride], velocity[::stride]
    torque = np.array(
        [
            pin.rnea(model, data, q, v, a).copy()
            for q, v, a in zip(motion, velocity, acceleration, strict=True)
        ]
    )
    return np.asarray(
        torque
        + robot.rotor_inertia * acceleration
        + robot.viscous * velocity
        + robot.coulomb * np.clip(velocity / 0.03, -1.0, 1.0)
    )
