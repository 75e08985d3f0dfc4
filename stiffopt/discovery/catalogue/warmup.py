"""Friction and torque constant that change within each run, as a motor and its gear warm."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.catalogue.common import dry_friction, viscous_friction
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import JointSignals
from stiffopt.symbolic import Quantity

# Time constants that are tried [s]: lubricant redistributes in seconds, windings warm in tens of
# seconds, housings in minutes, whose change within a run is a straight line.
_TIME_CONSTANT = Shape("tau_w", "s", (1.0, 4.0, 20.0), 0.3, 1e3, 20.0, reported=False)


def _warmed_share(signals: JointSignals, time_constant: Quantity) -> Quantity:
    """Return the change since the begin of the run, 0 to 1 at its end [-].

    The amplitude is then the change over the run, which is determined where the time constant and
    the end value of a longer run are not.
    """
    elapsed = signals.time - signals.time[0]
    whole = elapsed[-1]
    return np.expm1(-elapsed / time_constant) / np.expm1(-whole / time_constant)


def friction_warmup_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return (dFc sg(w) + dFv w) times the change since the begin of the run."""
    law = amplitudes[0] * signals.motor_direction + amplitudes[1] * signals.motor_velocity
    return Term(drive_torque=law * _warmed_share(signals, shapes[0]))


FRICTION_WARMUP = Effect(
    name="friction_warmup",
    family="friction",
    scope="joint",
    equation="tau += (dFc*sg(w) + dFv*w)*(1 - exp(-t/tau_w))/(1 - exp(-t_end/tau_w))",
    signature="motor torque off against the motion by an amount that grows or falls from the begin"
    " of each run to its end",
    title="friction that changes within a run",
    phrase=(
        "friction that grows within each run, by {dFc} and {dFv}",
        "friction that falls within each run, by {dFc} and {dFv}",
    ),
    remedy="Warm {where} up before recording, and record its temperature.",
    needs=("torque", "moves", "reverses"),
    confused_with=("thermal_friction", "friction_drift"),
    term=friction_warmup_term,
    amplitudes=(
        Amplitude("dFc", "N m", lambda constants: 0.3 * dry_friction(constants), -4.0, 10.0),
        Amplitude(
            "dFv", "N m s/rad", lambda constants: 0.3 * viscous_friction(constants), -4.0, 10.0
        ),
    ),
    shapes=(_TIME_CONSTANT,),
    separate="Repeat one short motion for ten minutes without a break: friction that warms settles,"
    " friction of a place or a load repeats with the motion.",
)

GAIN_WARMUP = Effect(
    name="gain_warmup",
    family="sensor",
    scope="joint",
    equation="tau += eps*tau*(1 - exp(-t/tau_w))/(1 - exp(-t_end/tau_w))",
    signature="motor torque off in proportion to itself by a factor that changes from the begin of"
    " each run to its end",
    title="torque constant that changes within a run",
    phrase=(
        "torque readings that grow by {eps:%} within each run, as with warming",
        "torque readings that fall by {eps:%} within each run, as with warming",
    ),
    remedy="Warm {where} up before recording, and record its motor's temperature.",
    needs=("torque", "torque_sensor", "moves"),
    confused_with=("friction_warmup", "gain_drift", "common_gain_drift"),
    term=lambda signals, a, s: Term(
        drive_torque=a[0] * signals.drive_torque * _warmed_share(signals, s[0])
    ),
    amplitudes=(Amplitude("eps", "", 0.03, -10.0, 10.0),),
    shapes=(_TIME_CONSTANT,),
    separate="Hold the arm still under its weight for some minutes: the torque of a constant weight"
    " changes with the torque constant, not with friction.",
)
