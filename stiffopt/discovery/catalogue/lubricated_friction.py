"""Friction of a lubricated joint, as a function of load, speed and temperature together.

Bittencourt and Axelsson (2014) measured interactions that the separate laws lack: load friction
increases at low speed, where the film is thin, and a warm film is thin up to higher speeds. Their
law, as a change from dry and viscous friction at the temperature of their identification, with the
speed below which the film is thin growing as viscosity falls (one exponent for both) in place of a
linear dependence.
"""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.catalogue.common import WEIGHT, dry_friction, viscous_friction
from stiffopt.discovery.catalogue.friction import (
    LOAD_ROUNDING,
    half_dry_friction,
    is_definite_load,
    rounded_load,
    rounded_speed,
    start_slow_speeds,
)
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import JointSignals

# Exponent of the speed, as measured there.
_SPEED_EXPONENT = 1.3
# Temperature range over which the low-speed part typically doubles [K].
_TEMPERATURE_RANGE = 20.0


def lubricated_friction_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return load friction, increased where the film is thin, and falling viscous friction."""
    of_load, of_load_slow, slow, slow_by_kelvin, weight = amplitudes
    speed, exponent, rounding = shapes
    w, rise = signals.motor_velocity, signals.temperature_rise
    viscosity = np.exp(-exponent * rise)
    thin = np.exp(-((rounded_speed(w) * viscosity / speed) ** _SPEED_EXPONENT))
    load = rounded_load(signals, rounding)
    level = of_load * load + (of_load_slow * load + slow + slow_by_kelvin * rise) * thin
    viscous = viscous_friction(signals.constants) * (viscosity - 1.0)
    return Term(drive_torque=level * signals.motor_direction + weight * viscous * w)


LUBRICATED_FRICTION = Effect(
    name="lubricated_friction",
    family="friction",
    scope="joint",
    equation="tau += (mu*abs(s) + (mu_slow*abs(s) + A + A_T*(T - T0))*thin)*sg(w)"
    " + (eta - 1)*Fv*w, eta = exp(-b*(T - T0)), thin = exp(-abs(eta*w/vs)^1.3)",
    signature="motor torque off against the motion by a share of the load that is larger at low"
    " speed, or at low speed by more as the housing warms",
    phrase="friction that depends on load, speed and temperature together, {mu} of the load",
    remedy="Check oil and grease of {where}; in the model, add the friction of extended.toml.",
    needs=("torque", "moves", "reverses", "slow"),
    confused_with=("load_friction", "stribeck", "thermal_friction"),
    reference="BittencourtAxelsson2014",
    term=lubricated_friction_term,
    amplitudes=(
        Amplitude("mu", "", 0.1, 0.0, 6.0),
        Amplitude("mu_slow", "", 0.1, 0.0, 6.0, own=True),
        Amplitude("A", "N m", half_dry_friction, 0.0, 4.0),
        Amplitude(
            "A_T",
            "N m/K",
            lambda constants: 0.5 * dry_friction(constants) / _TEMPERATURE_RANGE,
            0.0,
            4.0,
            own=True,
        ),
        WEIGHT,
    ),
    shapes=(
        Shape("vs", "rad/s", start_slow_speeds, 0.005, 0.5),
        Shape("b", "1/K", (0.03,), 1e-4, 0.1),
        LOAD_ROUNDING,
    ),
    report=lambda amplitudes, shapes, constants: {
        "mu": amplitudes[0],
        "mu_slow": amplitudes[1],
        "A": amplitudes[2],
        "A_T": amplitudes[3],
        "vs": shapes[0],
        "b": amplitudes[4] * shapes[1],
    },
    possible=lambda shapes, constants: is_definite_load(shapes[2], constants),
    separate="Move at five speeds down to 0.02 rad/s, with two payloads, cold and after half an"
    " hour of work: a load that rubs more when slow, and slow friction that grows with warmth, are"
    " of the film.",
)
