"""Effects periodic in the rotor angle: kinematic error of the gear, torque ripple."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.discovery.catalogue.common import CHANGED_SCALE_RATIO, Constants
from stiffopt.discovery.effect import Amplitude, Effect, Report, Reported, Shape, Term, Values
from stiffopt.discovery.signals import JointSignals
from stiffopt.symbolic import Quantity

_GEAR_ORDERS = (1, 2, 4)
_RIPPLE_ORDERS = (1, 6)
# Frequency over the sampling rate at which half of a wave is included, and exponent of the
# roll-off: faster waves alias to slow ones, and the motor's inertia carries them, which its
# recorded motion does not show.
# The exponent is a power of two: so many squares.
_HALF_SHARE_RATE, _ROLL_OFF_SQUARES = 0.24, 3


def _sampled_share(signals: JointSignals, order: Quantity) -> Quantity:
    """Return the included share of a wave of this order of the joint angle."""
    over = order * signals.motor_velocity * (signals.dt / (2.0 * np.pi * _HALF_SHARE_RATE))
    for _ in range(_ROLL_OFF_SQUARES):
        over = over * over
    return 1.0 / (1.0 + over)


def _is_absent(*amplitudes: Quantity) -> bool:
    """Return True where all amplitudes are the number zero, as those beside a unit amplitude."""
    return all(isinstance(each, float) and each == 0.0 for each in amplitudes)


def transmission_error_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the error of the ratio at 1, 2 and 4 times the rotor angle.

    The drive carries the load through the instantaneous ratio 1 - TE'(th), by virtual work.
    """
    ratio = signals.constants.ratio
    error: Quantity = 0.0
    slope: Quantity = 0.0
    for k, order in enumerate(_GEAR_ORDERS):
        turn = order * ratio * signals.motor_position
        a, b = amplitudes[2 * k], amplitudes[2 * k + 1]
        if _is_absent(a, b):
            continue
        shown = _sampled_share(signals, order * ratio)
        error = error + shown * (a * np.sin(turn) + b * np.cos(turn))
        slope = slope + shown * order * ratio * (a * np.cos(turn) - b * np.sin(turn))
    return Term(deflection=error, drive_torque=-signals.spring_torque * slope)


def torque_ripple_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return ripple at 1 and 6 times the electrical angle."""
    constants = signals.constants
    turns = (constants.pole_pairs or 1.0) * constants.ratio
    ripple: Quantity = 0.0
    for k, order in enumerate(_RIPPLE_ORDERS):
        a, b = amplitudes[2 * k], amplitudes[2 * k + 1]
        if _is_absent(a, b):
            continue
        turn = order * turns * signals.motor_position
        wave = a * np.sin(turn) + b * np.cos(turn)
        ripple = ripple + _sampled_share(signals, order * turns) * wave
    return Term(drive_torque=ripple)


def rotor_ripple_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return torque waves over the rotor turn, as many as the shape gives."""
    turns = shapes[0] * signals.constants.ratio
    turn = turns * signals.motor_position
    wave = amplitudes[0] * np.sin(turn) + amplitudes[1] * np.cos(turn)
    return Term(drive_torque=_sampled_share(signals, turns) * wave)


def _report_harmonics(letter: str, orders: Sequence[int]) -> Report:
    def report(amplitudes: Values, shapes: Values, constants: Constants) -> Reported:
        return {
            f"{letter}{order}": float(np.hypot(amplitudes[2 * k], amplitudes[2 * k + 1]))
            for k, order in enumerate(orders)
        }

    return report


def _wave_amplitude(name: str) -> Amplitude:
    """Return the amplitude of one wave of the motor torque."""
    return Amplitude(
        name,
        "N m",
        lambda constants: 0.02 * constants.torque_rated,
        -20.0,
        20.0,
        CHANGED_SCALE_RATIO,
    )


TRANSMISSION_ERROR = Effect(
    name="transmission_error",
    family="periodic",
    scope="joint",
    equation="d += sum_k A_k*sin(k*N*th + phase_k), k = 1, 2, 4",
    signature="motor and link angle apart in waves of 1, 2 or 4 a turn of the rotor",
    phrase="transmission error, {A1} once a rotor turn",
    remedy="Check the gear of {where} for runout of its input shaft.",
    needs=("sensor", "moves", "gear_ratio", "rotor_slow"),
    reference="TuttleSeering1996",
    term=transmission_error_term,
    amplitudes=tuple(
        Amplitude(f"{wave}{order}", "rad", 1e-4, -10.0, 10.0)
        for order in _GEAR_ORDERS
        for wave in ("sin", "cos")
    ),
    report=_report_harmonics("A", _GEAR_ORDERS),
    units={f"A{order}": "rad" for order in _GEAR_ORDERS},
    applies=lambda constants: constants.ratio > 1.0,
    separate="Turn slowly at two constant speeds: the waves keep their order of the rotor angle,"
    " a resonance keeps its frequency, ripple comes with the pole pairs.",
)

TORQUE_RIPPLE = Effect(
    name="torque_ripple",
    family="periodic",
    scope="joint",
    equation="tau += sum_k B_k*sin(k*p*N*th + phase_k), k = 1, 6",
    signature="motor torque in waves of 1 or 6 an electrical turn of the motor",
    phrase="torque ripple of the motor, {B1} once and {B6} six times an electrical turn",
    remedy="Check the current sensors and commutation offset of the motor of {where}.",
    needs=("torque", "moves", "gear_ratio", "pole_pairs", "ripple_slow"),
    term=torque_ripple_term,
    amplitudes=tuple(
        _wave_amplitude(f"{wave}{order}") for order in _RIPPLE_ORDERS for wave in ("sin", "cos")
    ),
    report=_report_harmonics("B", _RIPPLE_ORDERS),
    units={f"B{order}": "N m" for order in _RIPPLE_ORDERS},
    applies=lambda constants: constants.ratio > 1.0 and constants.pole_pairs is not None,
    separate="Turn slowly at two constant speeds in both directions: ripple leaves the link angle"
    " where it is, an error of the gear moves it.",
)

ROTOR_RIPPLE = Effect(
    name="rotor_ripple",
    family="periodic",
    scope="joint",
    equation="tau += B*sin(k*N*th + phase)",
    signature="motor torque in waves of some whole number a turn of the rotor",
    phrase="torque ripple with the turns of the rotor, {B} at {waves} waves a turn",
    remedy="Check motor and gear input of {where} for parts with that number of teeth, poles"
    " or rollers.",
    needs=("torque", "moves", "gear_ratio", "rotor_slow"),
    only_without=("pole_pairs",),
    confused_with=("torque_ripple",),
    term=rotor_ripple_term,
    amplitudes=(_wave_amplitude("sin"), _wave_amplitude("cos")),
    # Strain-wave gears have two a turn, motors their poles and slots.
    shapes=(
        Shape(
            "waves", "", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 14.0, 24.0), 0.5, 60.0
        ),
    ),
    report=lambda a, s, constants: {"B": float(np.hypot(a[0], a[1])), "waves": s[0]},
    units={"B": "N m"},
    applies=lambda constants: constants.ratio > 1.0 and constants.pole_pairs is None,
    separate="Turn slowly at two constant speeds: the waves keep their number a turn, a resonance"
    " keeps its frequency.",
)

PERIODIC = (TRANSMISSION_ERROR, TORQUE_RIPPLE, ROTOR_RIPPLE)
