"""Sizes of effects: severity 1 is what an oracle sees at a set number of standard deviations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.simulator import EFFECTS, CaseSpec, simulate

from .oracle import balances

AIM = 26.0
ALLOWED = (15.0, 40.0)
CLOSE = (18.0, 35.0)  # near enough to the aim to need no further simulation
SIMULATIONS = 3
SMALLEST, LARGEST = 0.004, 4.0  # of the simulator's own sizes, at severity 1

# First guesses of the size at severity 1, from the three-axis robot.
START = {
    "asym_friction": 0.17,
    "backlash": 0.07,
    "base_tilt": 1.2,
    "belt_creep": 0.4,
    "cable_spring": 0.13,
    "clock_drift": 0.3,
    "common_gain_drift": 0.15,
    "coulomb": 1.1,
    "crosstalk": 0.6,
    "dragging_brake": 0.1,
    "encoder_offset": 0.5,
    "encoder_skew": 0.2,
    "encoder_zero_change": 0.2,
    "external_contact": 0.1,
    "friction_drift": 0.17,
    "friction_warmup": 0.3,
    "gain_drift": 0.3,
    "gain_warmup": 0.5,
    "gravity_spring": 0.09,
    "hysteresis": 0.11,
    "inertial_error": 2.0,
    "joint_delay": 0.3,
    "joint_zero": 1.0,
    "k1_softening": 0.2,
    "load_friction": 0.23,
    "lubricated_friction": 0.25,
    "neighbour_friction": 0.1,
    "payload": 1.0,
    "position_friction": 0.07,
    "preload_loss": 0.85,
    "pulsing_load": 0.1,
    "quadratic_drag": 0.5,
    "reading_limit": 0.2,
    "rotor_inertia": 0.9,
    "run_clock": 0.3,
    "saturation": 0.2,
    "slew_limit": 0.2,
    "slosh": 0.2,
    "stiffness_linear": 1.0,
    "stribeck": 0.25,
    "stroke_friction": 0.1,
    "thermal_friction": 0.5,
    "time_delay": 0.2,
    "tool_force": 0.3,
    "torque_gain": 0.6,
    "torque_offset": 0.2,
    "torque_ripple": 0.1,
    "torque_sensor_drift": 0.1,
    "transmission_error": 0.06,
    "turning_tool_force": 0.3,
    "viscous": 1.1,
    "wrist_coupling": 0.03,
}

# Of a law that was never drawn.
UNKNOWN_START = 0.1


@dataclass(frozen=True)
class Sized:
    """An effect of a size that severity 1 stands for.

    Parameters
    ----------
    size : float
        The simulator's.
    z : float
        Of the oracle at this size, nothing else being different.
    """

    size: float
    z: float


def oracle_z(spec: CaseSpec) -> float:
    """What the oracle sees in the training recordings of a case; 0 where it cannot be simulated."""
    try:
        return balances(simulate(replace(spec, test=0, extrapolate=0))).z
    except (FloatingPointError, np.linalg.LinAlgError, ValueError):
        return 0.0


def sized(spec: CaseSpec, name: str, joint: int | None, start: float) -> Sized | None:
    """Size of an effect at severity 1 in the robot and motions of a case.

    Parameters
    ----------
    spec : CaseSpec
        Of the case; its own effects do not count.
    name : str
    joint : int or None
        From 1.
    start : float
        A first guess of the size.

    Returns
    -------
    Sized or None
        None where no sensible size of it is seen as it should be.
    """
    if name not in EFFECTS:
        raise KeyError(name)
    size, best = start, None
    for _ in range(SIMULATIONS):
        z = oracle_z(replace(spec, effects=((name, joint, size),)))
        if ALLOWED[0] <= z <= ALLOWED[1]:
            best = Sized(size, z)
        if CLOSE[0] <= z <= CLOSE[1]:
            break
        tried = size
        size = float(np.clip(size * AIM / z, SMALLEST, LARGEST)) if z else size / 4.0
        if size == tried:
            break
    return best
