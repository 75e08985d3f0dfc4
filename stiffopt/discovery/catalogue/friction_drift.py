"""Friction that is another one from run to run: a random effect by run, about what all share.

The housing of yesterday, the grease that has settled, a night of rest: no signal of a recording
tells. Every run is off by an amount of its own from the mean of all, which is friction like any
other and that of other effects; what a further run has is the mean, give or take the spread. As
mixed models have it (Laird and Ware 1982), what single runs have counts as drawn, not as
parameters of the robot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from stiffopt.discovery.catalogue.common import dry_friction, viscous_friction
from stiffopt.discovery.catalogue.friction import rounded_load
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.symbolic import Quantity, smooth_abs

# Before a name of a run, in the names of amplitudes.
RUN_PREFIX = "of "
# Share of friction that differs from run to run, typically.
_TYPICAL_SHARE = 0.2
# Of the speed in the law of any friction, its rounding at standstill [rad/s], and that of the load.
_SPEED_POWERS, _SPEED_ROUNDING, _LOAD_ROUNDING = (0.0, 0.5, 1.0, 2.0), 1e-2, 0.02
# Of the curve over the time of a run that its friction may follow instead.
_CURVE_KNOTS = 5


def _drift_term(
    seen: Sequence[str],
    signals: JointSignals,
    amplitudes: Sequence[Quantity],
    shapes: Sequence[Quantity],
) -> Term:
    """What a run that was seen has beside the mean of all; nothing in any other."""
    if signals.run not in seen:
        return Term()
    off = amplitudes[seen.index(signals.run)] - sum(amplitudes) / len(amplitudes)
    constants, w, viscous = signals.constants, signals.motor_velocity, shapes[0]
    dry = (1.0 - viscous) * dry_friction(constants) * signals.motor_direction
    return Term(drive_torque=off * (dry + viscous * viscous_friction(constants) * w))


def _report_spread(
    amplitudes: Sequence[float], shapes: Sequence[float], constants: JointConstants
) -> Mapping[str, float]:
    spread = float(np.std(amplitudes, ddof=1)) if len(amplitudes) > 1 else 0.0
    return {
        "dFc_spread": spread * (1.0 - shapes[0]) * dry_friction(constants),
        "dFv_spread": spread * shapes[0] * viscous_friction(constants),
    }


def _sampling_error(
    amplitudes: Sequence[float], shapes: Sequence[float], constants: JointConstants
) -> Mapping[str, float]:
    """What the spread of so few runs may be off by from that of all [N m], [N m s/rad]."""
    found = _report_spread(amplitudes, shapes, constants)
    return {k: v / np.sqrt(2.0 * max(len(amplitudes) - 1, 1)) for k, v in found.items()}


def _any_friction_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Friction by any powers of the speed, and by the load."""
    w = signals.motor_velocity
    speed = smooth_abs(w, _SPEED_ROUNDING)
    *powers, of_load = amplitudes
    law = sum(a * speed**power for a, power in zip(powers, _SPEED_POWERS, strict=True))
    dry = law * dry_friction(signals.constants) + of_load * rounded_load(signals, _LOAD_ROUNDING)
    return Term(drive_torque=dry * signals.motor_direction)


# Runs that are driven at other speeds and loads differ by a law that is not quite the model's.
ANY_FRICTION = Effect(
    name="any_friction",
    family="friction",
    scope="joint",
    equation="tau += sg(w)*(sum of c*abs(w)^p + mu*abs(s))",
    signature="motor torque off against the motion, by any law of speed and load",
    needs=("torque", "moves", "reverses"),
    reference="BittencourtAxelsson2014",
    term=_any_friction_term,
    amplitudes=(
        *(
            Amplitude(name=f"c{power:g}", unit="", scale=2.0, lower=-50.0, upper=50.0)
            for power in _SPEED_POWERS
        ),
        Amplitude(name="mu", unit="", scale=0.1, lower=-6.0, upper=6.0),
    ),
)


def _drift_within_term(
    runs: Sequence[str],
    signals: JointSignals,
    amplitudes: Sequence[Quantity],
    shapes: Sequence[Quantity],
) -> Term:
    """Dry friction along a curve over the time of each run, straight between its knots."""
    if signals.run not in runs:
        return Term()
    first = _CURVE_KNOTS * runs.index(signals.run)
    time = np.asarray(signals.time, dtype=float)
    knots = np.linspace(time.min(), time.max(), _CURVE_KNOTS)
    levels = np.interp(
        time, knots, np.asarray(amplitudes[first : first + _CURVE_KNOTS], dtype=float)
    )
    dry = dry_friction(signals.constants) * signals.motor_direction
    return Term(drive_torque=levels * dry)


def friction_within_runs(runs: Sequence[str]) -> Effect:
    """What drift is told from: friction that also changes while a run lasts.

    That of a hose which another joint pinches, or of a brake that drags now and then, is another
    one in every run as well, since runs have other motions.

    Parameters
    ----------
    runs : sequence of str
    """
    return Effect(
        name="friction_within_runs",
        family="friction",
        scope="joint",
        equation="tau += a_run(t)*Fc*sg(w)",
        signature="motor torque off against the motion by an amount that changes within runs",
        needs=("torque", "moves", "reverses"),
        reference="LairdWare1982",
        term=partial(_drift_within_term, tuple(runs)),
        amplitudes=tuple(
            Amplitude(
                name=f"{RUN_PREFIX}{run} {k}",
                unit="",
                scale=_TYPICAL_SHARE,
                lower=-50.0,
                upper=50.0,
            )
            for run in runs
            for k in range(_CURVE_KNOTS)
        ),
    )


def friction_drift(runs: Sequence[str], *, seen: bool = True) -> Effect:
    """The effect with an amount for each of some runs.

    Parameters
    ----------
    runs : sequence of str
    seen : bool
        Whether runs of these names are those that the amounts are of.
    """
    return Effect(
        name="friction_drift",
        family="friction",
        scope="joint",
        equation="tau += a_run*(share of Fc*sg(w) + share of Fv*w), a_run ~ N(0, spread^2), sum 0",
        signature="motor torque off against the motion by an amount that is another one in"
        " every run, whatever the motion and the temperature",
        title="friction drift between runs",
        phrase="friction that differs from run to run",
        needs=("torque", "moves", "reverses", "three_runs"),
        confused_with=("thermal_friction",),
        beside=ANY_FRICTION,
        likelier_than=friction_within_runs(runs),
        reference="LairdWare1982",
        term=partial(_drift_term, tuple(runs) if seen else ()),
        amplitudes=tuple(
            Amplitude(
                name=f"{RUN_PREFIX}{run}", unit="", scale=_TYPICAL_SHARE, lower=-5.0, upper=25.0
            )
            for run in runs
        ),
        shapes=(Shape(name="viscous", unit="", starts=(0.0, 0.5, 1.0), lower=0.0, upper=1.0),),
        report=_report_spread,
        drawn=_sampling_error,
        units={"dFc_spread": "N m", "dFv_spread": "N m s/rad"},
        of_runs=friction_drift,
        separate="Repeat one motion on several days, and several times on one: what differs"
        " between days alone is drift, what goes with the housing's warmth is oil.",
    )


# Signals of no recording have a run without a name.
FRICTION_DRIFT = friction_drift(("", "another"))
