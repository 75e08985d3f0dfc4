"""The true robot of a case: nominal values within tolerance, and what effects changed in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from .elasticity import Creep, Sliders, Windup, nominal_windups
from .robots import Robot
from .spec import CaseSpec, RunPlan

# One standard deviation of the true robot about the nominal one.
TOLERANCE = {
    "mass": 0.002,
    "com": 2e-4,
    "rotor_inertia": 0.005,
    "coulomb": 0.015,
    "viscous": 0.02,
    "stiffness": 0.01,
    "torque_constant": 0.002,
    "encoder_zero": 1e-5,
}
IDENTIFIED_AT = 22.0  # temperature of the nominal friction [degC]


@dataclass
class State:
    """What a law may depend on at one step; arrays (runs, n)."""

    time: float
    motor: np.ndarray
    motor_velocity: np.ndarray
    link: np.ndarray
    link_velocity: np.ndarray
    spring: np.ndarray
    temperature: np.ndarray
    step: float


FrictionLaw = Callable[[State, np.ndarray, np.ndarray], None]  # adds to levels up, down
Load = Callable[[State, np.ndarray], None]  # adds to a torque (runs, n)
DriveLaw = Callable[[np.ndarray, float], np.ndarray]  # commanded -> given torque
SensorLaw = Callable[["Signals"], None]


class Gear(Protocol):
    """Kinematic part of a transmission: moves the spring's motor end, returns its torque."""

    def shift(self, state: State, end: np.ndarray) -> None: ...
    def back(self, state: State, spring: np.ndarray, torque: np.ndarray) -> None: ...


@dataclass
class Signals:
    """What the sensors would read without noise, at every step: (runs, steps, n)."""

    torque: np.ndarray
    link: np.ndarray
    step: float
    plans: tuple[RunPlan, ...]


@dataclass
class World:
    """The true robot, open to be changed by effects before the integration begins."""

    robot: Robot
    spec: CaseSpec
    plans: tuple[RunPlan, ...]
    step: float
    model: pin.Model
    rotor_inertia: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    torque_constant: np.ndarray
    link_zero: np.ndarray
    windups: list[Windup]
    tolerances: dict[str, Any]
    reference: np.ndarray  # motions asked for (runs, steps, n)
    nominal_torque: np.ndarray  # drive torque that they need (runs, samples, n)
    friction: list[FrictionLaw] = field(default_factory=list)
    motor_loads: list[Load] = field(default_factory=list)  # against the motor
    link_loads: list[Load] = field(default_factory=list)  # on the link
    gears: list[Gear] = field(default_factory=list)
    sliders: list[Sliders] = field(default_factory=list)
    creeps: list[Creep] = field(default_factory=list)
    drive: list[DriveLaw] = field(default_factory=list)
    sensors: list[SensorLaw] = field(default_factory=list)

    @property
    def runs(self) -> int:
        return len(self.plans)

    @property
    def training(self) -> list[int]:
        """Places of the training runs."""
        return [r for r, plan in enumerate(self.plans) if plan.role == "train"]

    @property
    def tool_joint(self) -> int:
        return int(self.robot.joints)

    def windup_at(self, joint: int, torque: float) -> float:
        """Nominal deflection of a joint under a torque: a size to scale effects with [rad]."""
        nominal = nominal_windups(self.robot)[joint]
        return float(nominal.deflection(np.array([torque]))[0])


def true_world(
    spec: CaseSpec,
    robot: Robot,
    plans: tuple[RunPlan, ...],
    reference: np.ndarray,
    nominal_torque: np.ndarray,
    rng: np.random.Generator,
) -> World:
    """The robot as built: every nominal number off by its tolerance."""
    n = robot.joints

    def factor(key: str) -> np.ndarray:
        return 1.0 + spec.tolerance * TOLERANCE[key] * rng.standard_normal(n)

    mass, rotor, coulomb, viscous = (
        factor(key) for key in ("mass", "rotor_inertia", "coulomb", "viscous")
    )
    stiffness, constant = factor("stiffness"), factor("torque_constant")
    com = spec.tolerance * TOLERANCE["com"] * rng.standard_normal((n, 3))
    zero = spec.tolerance * TOLERANCE["encoder_zero"] * rng.standard_normal(n)
    model = robot.model()
    for j in range(n):
        body = model.inertias[j + 1]
        model.inertias[j + 1] = pin.Inertia(
            body.mass * mass[j], body.lever + com[j], body.inertia * mass[j]
        )
    windups = nominal_windups(robot)
    for windup, k in zip(windups, stiffness, strict=True):
        windup.factor = float(k)
    tolerances = {
        "mass": mass.tolist(),
        "com": com.tolist(),
        "jm": rotor.tolist(),
        "fc": coulomb.tolist(),
        "fv": viscous.tolist(),
        "k": stiffness.tolist(),
        "kt": constant.tolist(),
        "enc": zero.tolist(),
    }
    return World(
        robot=robot,
        spec=spec,
        plans=plans,
        step=1.0 / (spec.rate * spec.substeps),
        model=model,
        rotor_inertia=robot.rotor_inertia * rotor,
        coulomb=robot.coulomb * coulomb,
        viscous=robot.viscous * viscous,
        torque_constant=constant,
        link_zero=zero,
        windups=windups,
        tolerances=tolerances,
        reference=reference,
        nominal_torque=nominal_torque,
    )
