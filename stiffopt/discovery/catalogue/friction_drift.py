"""Friction that differs from run to run: a random effect of the run about a common mean.

Housing temperature of the day before, settled grease, a night of rest: no recorded signal
determines it. Every run deviates from the mean of all, which is friction like any other and belongs
to other effects; a further run is predicted by the mean, with the spread as uncertainty. As in
mixed models (Laird and Ware 1982), deviations of runs are random, not parameters of the robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from stiffopt.discovery.catalogue.common import (
    amplitudes_of_runs,
    deviation_from_state,
    dry_friction,
    viscous_friction,
)
from stiffopt.discovery.catalogue.friction import rounded_load
from stiffopt.discovery.effect import Amplitude, Effect, Reported, Shape, Term, Values
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.symbolic import smooth_abs

# Typical relative deviation of friction between runs.
_TYPICAL_SHARE = 0.2
# Powers of the speed in a general friction law, rounding of the speed at rest [rad/s], and of the
# load over the rated torque.
_SPEED_POWERS, _SPEED_ROUNDING, _LOAD_ROUNDING = (0.0, 0.5, 1.0, 2.0), 1e-2, 0.02
# Knots of the friction curve over the time of a run.
_CURVE_KNOTS = 5


def _drift_term(
    seen: Sequence[str],
    states: Sequence[str],
    signals: JointSignals,
    amplitudes: Values,
    shapes: Values,
) -> Term:
    """Return the deviation of a recorded run from the mean; zero in any other run."""
    if signals.run not in seen:
        return Term()
    off = deviation_from_state(amplitudes, states, seen.index(signals.run))
    constants, w, viscous = signals.constants, signals.motor_velocity, shapes[0]
    dry = (1.0 - viscous) * dry_friction(constants) * signals.motor_direction
    return Term(drive_torque=off * (dry + viscous * viscous_friction(constants) * w))


def _report_spread(
    states: Sequence[str], amplitudes: Values, shapes: Values, constants: JointConstants
) -> Reported:
    free = len(amplitudes) - len(set(states))
    off = [float(deviation_from_state(amplitudes, states, run)) for run in range(len(amplitudes))]
    spread = float(np.sqrt(np.sum(np.square(off)) / free)) if free else 0.0
    return {
        "dFc_spread": spread * (1.0 - shapes[0]) * dry_friction(constants),
        "dFv_spread": spread * shapes[0] * viscous_friction(constants),
    }


def _sampling_error(
    states: Sequence[str], amplitudes: Values, shapes: Values, constants: JointConstants
) -> Reported:
    """Return the sampling error of the spread from so few runs [N m], [N m s/rad]."""
    found = _report_spread(states, amplitudes, shapes, constants)
    free = max(len(amplitudes) - len(set(states)), 1)
    return {k: v / np.sqrt(2.0 * free) for k, v in found.items()}


def _any_friction_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return friction by several powers of the speed and by the load."""
    w = signals.motor_velocity
    speed = smooth_abs(w, _SPEED_ROUNDING)
    *powers, of_load = amplitudes
    law = sum(a * speed**power for a, power in zip(powers, _SPEED_POWERS, strict=True))
    dry = law * dry_friction(signals.constants) + of_load * rounded_load(signals, _LOAD_ROUNDING)
    return Term(drive_torque=dry * signals.motor_direction)


# Runs at other speeds and loads also differ where the friction law of the model is inexact.
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
        *(Amplitude(f"c{power:g}", "", 2.0, -50.0, 50.0) for power in _SPEED_POWERS),
        Amplitude("mu", "", 0.1, -6.0, 6.0),
    ),
)


def _drift_within_term(
    runs: Sequence[str], signals: JointSignals, amplitudes: Values, shapes: Values
) -> Term:
    """Return dry friction piecewise linear over the time of each run."""
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
    """Return the alternative to drift: friction that also changes within a run.

    A hose pinched by another joint or a brake that drags at times also differs between runs, since
    runs have other motions.
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
        amplitudes=amplitudes_of_runs(
            (f"{run} {k}" for run in runs for k in range(_CURVE_KNOTS)), _TYPICAL_SHARE, -50.0, 50.0
        ),
    )


def friction_drift(
    runs: Sequence[str], *, seen: bool = True, states: Sequence[str] | None = None
) -> Effect:
    """Return the effect with one amplitude per run.

    `seen`: True where runs of these names are those of the amplitudes. `states`: state of the robot
    in each run: deviations are from the mean of each state, and their difference is a change of the
    robot. Default: one state.
    """
    states = tuple(states) if states is not None else ("",) * len(runs)
    return Effect(
        name="friction_drift",
        family="friction",
        scope="joint",
        equation="tau += a_run*(share of Fc*sg(w) + share of Fv*w), a_run ~ N(0, spread^2), sum 0",
        signature="motor torque off against the motion by an amount that differs between"
        " runs, whatever the motion and the temperature",
        title="friction drift between runs",
        phrase="friction that differs from run to run, by {dFc_spread}",
        remedy="Warm {where} up alike before each run, and check its brake and hoses; plan"
        " with a margin of twice this friction.",
        needs=("torque", "moves", "reverses", "three_runs"),
        confused_with=("thermal_friction",),
        beside=ANY_FRICTION,
        likelier_than=friction_within_runs(runs),
        reference="LairdWare1982",
        term=partial(_drift_term, tuple(runs) if seen else (), states),
        amplitudes=amplitudes_of_runs(runs, _TYPICAL_SHARE, -5.0, 25.0),
        shapes=(Shape("viscous", "", (0.0, 0.5, 1.0), 0.0, 1.0),),
        report=partial(_report_spread, states),
        drawn=partial(_sampling_error, states),
        units={"dFc_spread": "N m", "dFv_spread": "N m s/rad"},
        of_runs=friction_drift,
        separate="Repeat one motion on several days, and several times on one: a difference"
        " between days alone is drift, one with the housing's warmth is oil.",
    )


# Signals without a recording have an empty run name.
FRICTION_DRIFT = friction_drift(("", "another"))
