"""Friction that grows or falls within each run, with its time."""

from __future__ import annotations

from stiffopt.discovery.catalogue.common import dry_friction, viscous_friction
from stiffopt.discovery.catalogue.warming import TIME_CONSTANT, warmed_share
from stiffopt.discovery.effect import Amplitude, Effect, Term, Values
from stiffopt.discovery.signals import JointSignals


def friction_warmup_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return (dFc sg(w) + dFv w) times the change since the begin of the run."""
    law = amplitudes[0] * signals.motor_direction + amplitudes[1] * signals.motor_velocity
    return Term(drive_torque=law * warmed_share(signals, shapes[0]))


FRICTION_WARMUP = Effect(
    name="friction_warmup",
    family="friction",
    scope="joint",
    equation="tau += (dFc*sg(w) + dFv*w)*(1 - exp(-t/tau_w))/(1 - exp(-t_end/tau_w))",
    signature="motor torque off against the motion by an amount that grows or falls from the begin"
    " of each run to its end",
    title="friction that changes within a run",
    phrase=(
        "friction that grows within each run",
        "friction that falls within each run: warm the arm up before recording",
    ),
    needs=("torque", "moves", "reverses"),
    confused_with=("thermal_friction", "friction_drift"),
    term=friction_warmup_term,
    amplitudes=(
        Amplitude("dFc", "N m", lambda constants: 0.3 * dry_friction(constants), -4.0, 10.0),
        Amplitude(
            "dFv", "N m s/rad", lambda constants: 0.3 * viscous_friction(constants), -4.0, 10.0
        ),
    ),
    shapes=(TIME_CONSTANT,),
    report=lambda amplitudes, shapes, constants: {"dFc": amplitudes[0], "dFv": amplitudes[1]},
    separate="Repeat one short motion for ten minutes without a break: friction that warms settles,"
    " friction of a place or a load repeats with the motion.",
)
