"""What is asked of the simulator and what it hands back."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .robots import Robot

Effect = tuple[str, int | None, float]


@dataclass(frozen=True, kw_only=True)
class CaseSpec:
    """One case: a robot, what is different in the true one, and how it is recorded.

    Parameters
    ----------
    robot : str
        One of `ROBOTS`, such as "small3" or "big6".
    effects : tuple of (name, joint from 1 or None, severity)
        For inertial_error the joint is the link that it moves.
    seed : int
        Every draw follows from it, each purpose from its own stream: the same seed with and
        without an effect has the same tolerances, motions and sensor noise.
    train, test, extrapolate : int
        Recordings of each role.
    seconds, rate : float
        Length of each [s] and recording rate [Hz].
    noise, tolerance : float
        Scale of the sensor noise and of the deviations of the true robot from the nominal one.
    stated_noise : float
        What the set states over what the noise is.
    substeps : int
        Integration steps a recorded sample.
    payload : float, optional
        Mass of the load of nominal and true robot [kg]; default the robot's own.
    smoothing : float
        Time over which the corners of the motion are rounded [s].
    """

    robot: str = "planar2"
    effects: tuple[Effect, ...] = ()
    seed: int = 0
    link_encoders: bool = True
    train: int = 4
    test: int = 3
    extrapolate: int = 1
    seconds: float = 10.0
    rate: float = 500.0
    noise: float = 1.0
    tolerance: float = 1.0
    stated_noise: float = 1.0
    substeps: int = 4
    payload: float | None = None
    smoothing: float = 0.42
    name: str = ""

    @property
    def case_name(self) -> str:
        return self.name or f"{self.robot}_{self.seed}"


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """One recording to make."""

    name: str
    role: str
    session_time: float  # [s]
    temperature: np.ndarray  # of the housings (n,) [degC]


@dataclass(frozen=True, kw_only=True, eq=False)
class RunRecord:
    """One recording as the sensors gave it, and the same without noise and counts."""

    plan: RunPlan
    columns: dict[str, np.ndarray]
    clean: dict[str, np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """What truly happened at every integration step, (runs, steps, n), time from the begin.

    `velocity` of motor and link are those at the step; accelerations are second differences of
    the positions, exactly.
    """

    step: float
    motor: np.ndarray
    motor_velocity: np.ndarray
    link: np.ndarray
    link_velocity: np.ndarray
    spring: np.ndarray
    command: np.ndarray
    torque: np.ndarray
    friction: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A recording set in memory, with the truth that an engineer does not have."""

    spec: CaseSpec
    robot: Robot
    runs: tuple[RunRecord, ...]
    truth: dict[str, Any]
    trace: Trace
    noise: dict[str, Any] = field(default_factory=dict)
