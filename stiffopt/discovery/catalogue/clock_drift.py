"""Clock of the torques that runs fast or slow against that of the positions."""

from __future__ import annotations

from stiffopt.discovery.catalogue.time_shift import shift_slope
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import RobotSignals

# Largest relative difference of two clocks: 1 % is a rate in the place of another; crystals agree
# to 1e-4.
_MAX_RATE_DIFFERENCE = 0.01


def clock_drift_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return tau(t - d - e t) - tau(t) of all joints, linear in e about the shape, and in d."""
    elapsed = signals.time - signals.time[0]
    drift = shift_slope(signals.drive_torque, signals.dt, shapes[0], elapsed)
    return Term(drive_torque=amplitudes[0] * drift - amplitudes[1] * signals.drive_torque_rate)


CLOCK_DRIFT = Effect(
    name="clock_drift",
    family="sensor",
    scope="robot",
    equation="tau += tau(t - d - e*t) - tau(t)",
    signature="motor torques of all joints late or early by a time that grows in proportion to the"
    " time of the run",
    title="clock drift between torque and position",
    phrase="torque and position recorded on clocks of different rate: use one clock for both",
    needs=("torque", "torque_sensor", "moves"),
    confused_with=("time_delay",),
    term=clock_drift_term,
    amplitudes=(
        Amplitude("e", "", 1e-3, -10.0, 10.0, own=True),
        Amplitude("d", "s", 5e-3, -10.0, 10.0),
    ),
    shapes=(
        Shape(
            "about",
            "",
            (-4e-3, -1e-3, -2e-4, 2e-4, 1e-3, 4e-3),
            -_MAX_RATE_DIFFERENCE,
            _MAX_RATE_DIFFERENCE,
            1e-5,
        ),
    ),
    linear_about=True,
    report=lambda amplitudes, shapes, constants: {"e": amplitudes[0], "d": amplitudes[1]},
    separate="Record one short motion at the start and again at the end of a long run: the delay of"
    " a constant offset is equal in both, that of two clocks is not.",
)
