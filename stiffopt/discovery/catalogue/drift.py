"""Friction and torque constants that differ from run to run, or change within each run.

Housing temperature of the day before, settled grease, a night of rest: no recorded signal
determines the friction of a run. Ferrite magnets lose 0.2 % of their flux a kelvin, rare-earth ones
0.1 %: a torque that is computed from the current reads too large or too small in a warm motor.

Every run deviates from the mean of all, which belongs to other effects; a further run is predicted
by the mean, with the spread as uncertainty. As in mixed models (Laird and Ware 1982), deviations of
runs are random, not parameters of the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np

from stiffopt.discovery.catalogue.common import Constants, dry_friction, viscous_friction
from stiffopt.discovery.catalogue.friction import rounded_load
from stiffopt.discovery.catalogue.sensors import TORQUE_GAIN
from stiffopt.discovery.effect import Amplitude, Effect, Reported, Shape, Term, Values
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.symbolic import Quantity, smooth_abs

# Prefix of run names in names of amplitudes.
_RUN_PREFIX = "of "
# Typical relative deviation between runs: of friction, and of a torque constant by 20 to 30 K.
_TYPICAL_FRICTION_DEVIATION, _TYPICAL_GAIN_DEVIATION = 0.2, 0.03
# Powers of the speed in a general friction law, rounding of the speed at rest [rad/s], and of the
# load over the rated torque.
_SPEED_POWERS, _SPEED_ROUNDING, _LOAD_ROUNDING = (0.0, 0.5, 1.0, 2.0), 1e-2, 0.02
# Knots of the friction curve over the time of a run.
_CURVE_KNOTS = 5


# ---- deviations of runs


def _amplitudes_of_runs(
    runs: Iterable[str], scale: float, lower: float, upper: float
) -> tuple[Amplitude, ...]:
    """Return one relative amplitude per run with its typical size, and its bounds over that."""
    return tuple(Amplitude(f"{_RUN_PREFIX}{run}", "", scale, lower, upper) for run in runs)


def _deviation_from_state(amplitudes: Values, states: Sequence[str], run: int) -> Quantity:
    """Return the deviation of a run from the mean of the runs of its state."""
    own = [a for a, state in zip(amplitudes, states, strict=True) if state == states[run]]
    return amplitudes[run] - sum(own) / len(own)


# (signals, shapes) -> torque of which each run has a share more or less.
TorqueLaw = Callable[[Any, Values], Quantity]


def _effect_of_runs(
    law: TorqueLaw,
    deviation: tuple[float, float, float],
    runs: Sequence[str],
    states: Sequence[str],
    **entry: Any,
) -> Effect:
    """Return an effect with one amplitude per run, which deviates from the mean of its state.

    `deviation`: typical size of an amplitude, and its bounds over that. The term is zero in any
    other run.
    """

    def term(signals: Any, amplitudes: Values, shapes: Values) -> Term:
        if signals.run not in runs:
            return Term()
        off = _deviation_from_state(amplitudes, states, runs.index(signals.run))
        return Term(drive_torque=off * law(signals, shapes))

    return Effect(term=term, amplitudes=_amplitudes_of_runs(runs, *deviation), **entry)


def deviations_of_runs(
    effect: Effect, amplitudes: Sequence[float]
) -> tuple[tuple[str, float], ...]:
    """Return the runs of a drift with their deviations from the mean, over the standard one."""
    off = np.asarray(amplitudes, dtype=float) - np.mean(amplitudes)
    spread = np.std(off, ddof=1) if len(off) > 1 and off.any() else 1.0
    runs = [each.name.removeprefix(_RUN_PREFIX) for each in effect.amplitudes]
    return tuple(zip(runs, (off / spread).tolist(), strict=True))


def of_other_runs(effect: Effect, names: Iterable[str]) -> Effect:
    """Return an effect of runs with amplitudes of these names, which acts in no run.

    Runs of the same name in another set are different runs.
    """
    assert effect.of_runs is not None
    runs = [name.removeprefix(_RUN_PREFIX) for name in names if name.startswith(_RUN_PREFIX)]
    return replace(effect.of_runs(tuple(runs)), term=lambda *_: Term())


def _drifting_friction(signals: JointSignals, shapes: Values) -> Quantity:
    constants, w, viscous = signals.constants, signals.motor_velocity, shapes[0]
    dry = (1.0 - viscous) * dry_friction(constants) * signals.motor_direction
    return dry + viscous * viscous_friction(constants) * w


def _report_spread(
    states: Sequence[str], amplitudes: Values, shapes: Values, constants: JointConstants
) -> Reported:
    free = len(amplitudes) - len(set(states))
    off = [float(_deviation_from_state(amplitudes, states, run)) for run in range(len(amplitudes))]
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
        amplitudes=_amplitudes_of_runs(
            (f"{run} {k}" for run in runs for k in range(_CURVE_KNOTS)),
            _TYPICAL_FRICTION_DEVIATION,
            -50.0,
            50.0,
        ),
    )


def friction_drift(runs: Sequence[str], states: Sequence[str] = ()) -> Effect:
    """Return friction that differs between runs, with one amplitude per run.

    `states`: state of the robot in each run: deviations are from the mean of each state, and their
    difference is a change of the robot. Default: one state.
    """
    states = states or ("",) * len(runs)
    return _effect_of_runs(
        _drifting_friction,
        (_TYPICAL_FRICTION_DEVIATION, -5.0, 25.0),
        runs,
        states,
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
        shapes=(Shape("viscous", "", (0.0, 0.5, 1.0), 0.0, 1.0),),
        report=partial(_report_spread, states),
        drawn=partial(_sampling_error, states),
        units={"dFc_spread": "N m", "dFv_spread": "N m s/rad"},
        of_runs=friction_drift,
        separate="Repeat one motion on several days, and several times on one: a difference"
        " between days alone is drift, one with the housing's warmth is oil.",
    )


def _report_trend(amplitudes: Values, shapes: Values, constants: Constants) -> Reported:
    """Return the change from run to run, by a straight line, and the spread of all runs.

    Runs are in the order of the set: the trend is per run.
    """
    values, count = np.asarray(amplitudes, dtype=float), len(amplitudes)
    trend = float(np.polyfit(np.arange(count), values, 1)[0]) if count > 1 else 0.0
    spread = float(np.std(values, ddof=1)) if count > 1 else 0.0
    return {"per_run": trend, "spread": spread}


def gain_drift(
    scope: Literal["joint", "robot"], runs: Sequence[str], states: Sequence[str] = ()
) -> Effect:
    """Return a torque constant that differs between runs, with one amplitude per run.

    `scope` {"joint", "robot"}: one torque constant, or that of all joints alike. `states`: as of
    `friction_drift`.
    """
    common = scope == "robot"
    whose = "of all joints alike" if common else "of one joint"
    others = ("friction_drift", "thermal_friction")
    return _effect_of_runs(
        lambda signals, shapes: signals.drive_torque,
        (_TYPICAL_GAIN_DEVIATION, -10.0, 10.0),
        runs,
        states or ("",) * len(runs),
        name="common_gain_drift" if common else "gain_drift",
        family="sensor",
        scope=scope,
        equation="tau += eps_run*tau, eps_run ~ N(0, spread^2), sum 0",
        signature=f"motor torque {whose} off in proportion to itself, by a factor that differs"
        " between runs",
        title=f"torque constant {whose} that drifts between runs",
        phrase=f"torque constant {whose} that changes from run to run, as with warming: record"
        " motor temperature, and runs of one warmth in one set",
        needs=("torque", "torque_sensor", "moves", "three_runs"),
        confused_with=others if common else ("common_gain_drift", *others),
        report=_report_trend,
        units={"per_run": "", "spread": ""},
        of_runs=partial(gain_drift, scope),
        separate="Hold the arm still in one posture, cold and after half an hour of work: weight"
        " does not change, a torque constant does; friction does not act at rest.",
    )


# Signals without a recording have an empty run name.
FRICTION_DRIFT = friction_drift(("", "another"))
GAIN_DRIFTS = tuple(gain_drift(scope, ("", "another")) for scope in ("robot", "joint"))


# ---- friction of some runs


def _runs_of(runs: Sequence[str], shapes: Values) -> Sequence[str]:
    """Return the runs from the first to the last of the shapes, which count from 1."""
    return runs[round(float(shapes[0])) - 1 : round(float(shapes[1]))]


def friction_in_runs(runs: Sequence[str], states: Sequence[str] = ()) -> Effect:
    """Return friction that is another one in consecutive runs than in all others.

    Runs of the latest state are the others: it is the state of further runs, and of a plan. A
    change that stays is thus that of the runs before it.
    """
    numbers = tuple(float(k + 1) for k in range(len(runs)))

    def term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
        if signals.run not in _runs_of(runs, shapes):
            return Term()
        return Term(drive_torque=_added_friction(signals, amplitudes))

    def possible(shapes: Sequence[float], constants: JointConstants) -> bool:
        return 1.0 <= shapes[0] <= shapes[1] < len(runs)

    def remedy(amplitudes: Values, shapes: Values, constants: JointConstants) -> str:
        own = _runs_of(runs, shapes)
        when = f"from {own[0]} to {own[-1]}" if len(own) > 1 else f"in {''.join(own)}"
        what = "higher" if amplitudes[0] > 0.0 else "lower"
        return (
            f"The friction of joint {constants.joint} was {what} {when} than in all other runs: ask"
            " what was different then (brake, hose, grease, temperature), and plan with the"
            " friction of the last run."
        )

    return Effect(
        name="friction_in_runs",
        family="friction",
        scope="joint",
        equation="tau += dFc*sg(w) + dFv*w in the runs from first to last",
        signature="motor torque off against the motion in one run, or in runs that follow one"
        " another, and in no other",
        title="friction of some runs",
        phrase=(
            "{dFc} and {dFv} more friction in runs {first} to {last} than in all others",
            "{dFc} and {dFv} less friction in runs {first} to {last} than in all others",
        ),
        remedy=remedy,
        needs=("torque", "moves", "reverses", "three_runs"),
        confused_with=("friction_drift", "cold_start", "untimed_cold_start"),
        beside=ANY_FRICTION,
        reference="LairdWare1982",
        amplitudes=FRICTION_WARMUP.amplitudes,
        shapes=tuple(Shape(name, "", numbers, 1.0, 1e3, fit="held") for name in ("first", "last")),
        possible=possible,
        term=term,
        report=lambda amplitudes, shapes, constants: {
            **dict(zip(("dFc", "dFv"), amplitudes, strict=True)),
            "first": float(shapes[0]),
            "last": float(shapes[1]),
        },
        of_runs=friction_in_runs,
        separate="Repeat one motion in every run: friction of a place, a load or a speed is then"
        " alike in all of them.",
    )


# ---- changes within each run


# Time constants that are tried [s]: lubricant redistributes in seconds, windings warm in tens of
# seconds, housings in minutes, whose change within a run is a straight line.
_TIME_CONSTANT = Shape("tau_w", "s", (1.0, 4.0, 20.0), 0.3, 1e3, 20.0, reported=False)


def _added_friction(signals: JointSignals, amplitudes: Values) -> Quantity:
    """Return dry and viscous friction of amplitudes [N m], [N m s/rad]."""
    return amplitudes[0] * signals.motor_direction + amplitudes[1] * signals.motor_velocity


def _warmed_share(signals: JointSignals, time_constant: Quantity) -> Quantity:
    """Return the change since the begin of the run, 0 to 1 at its end [-].

    The amplitude is then the change over the run, which is determined where the time constant and
    the end value of a longer run are not.
    """
    elapsed = signals.time - signals.time[0]
    whole = elapsed[-1]
    return np.expm1(-elapsed / time_constant) / np.expm1(-whole / time_constant)


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
    # With a short time constant it is another constant friction.
    beside=ANY_FRICTION,
    term=lambda signals, a, s: Term(
        drive_torque=_added_friction(signals, a) * _warmed_share(signals, s[0])
    ),
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

COLD_START = Effect(
    name="cold_start",
    family="friction",
    scope="joint",
    equation="tau += (dFc*sg(w) + dFv*w)*exp(-t_session/tau_w)",
    signature="motor torque off against the motion by an amount that falls or grows over all runs"
    " of a session",
    title="friction that changes over the session",
    phrase=(
        "{dFc} and {dFv} more friction at the begin of the session, which falls within {tau_w}",
        "{dFc} and {dFv} less friction at the begin of the session, which grows within {tau_w}",
    ),
    remedy="Warm {where} up for three times {tau_w} before work that has to be accurate, and plan"
    " with its warm friction.",
    needs=("torque", "moves", "reverses", "session"),
    confused_with=("friction_warmup", "thermal_friction", "friction_drift"),
    beside=ANY_FRICTION,
    term=lambda signals, a, s: Term(
        drive_torque=_added_friction(signals, a) * np.exp(-signals.session_time / s[0])
    ),
    amplitudes=FRICTION_WARMUP.amplitudes,
    shapes=(Shape("tau_w", "s", (10.0, 60.0, 300.0, 1500.0), 1.0, 2e4, 300.0),),
    separate="Repeat one short motion for an hour: friction of a cold joint settles and does not"
    " come back with the next run.",
)

UNTIMED_COLD_START = replace(
    COLD_START,
    name="untimed_cold_start",
    equation="tau += (dFc*sg(w) + dFv*w)*exp(-(t + k*period)/tau_w), run k = 0, 1, ... of the set",
    signature="motor torque off against the motion by an amount that falls or grows from run to run"
    " and within each, in the order of the set",
    title="friction that changes over the session, in the order of the runs",
    phrase=(
        "{dFc} and {dFv} more friction at the begin of the session, which falls within {tau_w} if"
        " the runs followed one another every {period}",
        "{dFc} and {dFv} less friction at the begin of the session, which grows within {tau_w} if"
        " the runs followed one another every {period}",
    ),
    needs=("torque", "moves", "reverses", "untimed_session"),
    confused_with=("cold_start", *COLD_START.confused_with),
    term=lambda signals, a, s: Term(
        drive_torque=_added_friction(signals, a)
        * np.exp(-(signals.time - signals.time[0] + signals.run_number * s[1]) / s[0])
    ),
    shapes=(*COLD_START.shapes, Shape("period", "s", (20.0, 80.0, 400.0), 1.0, 1e4, 60.0)),
    separate="Write session_time of every run, in seconds since the first, into recordings.toml."
    f" {COLD_START.separate}",
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
    beside=TORQUE_GAIN,
    term=lambda signals, a, s: Term(
        drive_torque=a[0] * signals.drive_torque * _warmed_share(signals, s[0])
    ),
    amplitudes=(Amplitude("eps", "", 0.03, -10.0, 10.0),),
    shapes=(_TIME_CONSTANT,),
    separate="Hold the arm still under its weight for some minutes: the torque of a constant weight"
    " changes with the torque constant, not with friction.",
)

FRICTION_IN_RUNS = friction_in_runs(("", "another"))
