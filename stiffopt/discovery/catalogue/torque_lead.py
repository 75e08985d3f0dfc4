"""Torque ahead of the motion: the commanded torque, recorded in place of the measured one.

Between a command and the motion that it causes lie the current loop and the bus; a measured torque
lags the motion or is simultaneous with it, never ahead.
"""

from __future__ import annotations

from collections.abc import Sequence

from stiffopt.discovery.catalogue.time_shift import shift_samples
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term
from stiffopt.discovery.signals import RobotSignals
from stiffopt.symbolic import Quantity

# Longest lead [s]: some cycles of a slow controller.
_MAX_LEAD = 0.05


def torque_lead_term(
    signals: RobotSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Return tau(t + d) - tau(t) of all joints, linear in d about the lead of the shape."""
    needed, about = signals.drive_torque, shapes[0]
    reach = int(_MAX_LEAD / signals.dt) + 1
    early = shift_samples(needed, -about / signals.dt, -reach, 0)
    return Term(drive_torque=amplitudes[0] / about * (early - needed))


TORQUE_LEAD = Effect(
    name="torque_lead",
    family="sensor",
    scope="robot",
    equation="tau += tau(t + d) - tau(t)",
    signature="motor torques of all joints ahead of the motion by the same time, as commanded"
    " torques are",
    title="torque ahead of the motion",
    phrase="torque recorded ahead of the motion, as a commanded torque is: record the measured one",
    needs=("torque", "moves"),
    confused_with=("time_delay",),
    term=torque_lead_term,
    amplitudes=(Amplitude(name="d", unit="s", scale=5e-3, lower=0.0, upper=10.0),),
    shapes=(
        Shape(
            name="about",
            unit="s",
            starts=(1e-3, 5e-3, 0.02),
            lower=1e-4,
            upper=_MAX_LEAD,
            usual=1e-4,
        ),
    ),
    report=lambda amplitudes, shapes, constants: {"d": amplitudes[0]},
    separate="Read the name and manual of the torque column: a command is ahead of the motion by"
    " the delay of the current loop, a measurement is not. Record the measured current as well.",
)
