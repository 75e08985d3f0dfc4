"""Torque that is late or ahead of the motion by a constant time.

A measured torque is late by its filter and its way through the bus. It is never ahead of the motion
that it causes: a torque that is ahead was commanded, and recorded in place of the measured one.
"""

from __future__ import annotations

from stiffopt.discovery.catalogue.time_shift import delay_term
from stiffopt.discovery.effect import Amplitude, Effect, Shape

# Longest delay and lead [s]: some cycles of a slow controller.
_MAX_DELAY = 0.05


TIME_DELAY = Effect(
    name="time_delay",
    family="sensor",
    scope="robot",
    equation="tau += tau(t - d) - tau(t)",
    signature="motor torques of all joints late by the same time, or early as commanded torques"
    " are",
    phrase=(
        "torque recorded {d} late",
        "torque recorded {d} ahead of the motion, as a commanded torque is",
    ),
    remedy="Shift the torque channels by {d}, use one clock for all signals, and record the"
    " measured torque where it is ahead of the motion.",
    needs=("torque", "torque_sensor", "moves"),
    term=delay_term,
    amplitudes=(Amplitude("d", "s", 5e-3, -10.0, 10.0),),
    shapes=(
        Shape(
            "about",
            "s",
            (-0.02, -5e-3, -1e-3, -2e-4, 2e-4, 1e-3, 5e-3, 0.02),
            -_MAX_DELAY,
            _MAX_DELAY,
            1e-4,
        ),
    ),
    linear_about=True,
    signals_key="torque_delay",
    report=lambda amplitudes, shapes, constants: {"d": amplitudes[0]},
    separate="Change speed quickly, then hold it: a delay shows while the torque changes, friction"
    " and inertia do not depend on how fast it does. Ahead of the motion is a command: read the"
    " name of its column in the manual, and record the measured current as well.",
)
