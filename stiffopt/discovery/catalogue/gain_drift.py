"""Torque constant that differs from run to run, as magnets and windings warm.

Ferrite magnets lose 0.2 % of their flux a kelvin, rare-earth ones 0.1 %: the same current gives
less torque in a warm motor, and a torque that is computed from the current reads too large or too
small. Each run has a factor of its own about the mean of all; the mean is a nominal value or a
torque gain. Runs are in the order of the set: the trend is per run.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Literal

import numpy as np

from stiffopt.discovery.catalogue.common import Constants, amplitudes_of_runs, deviation_from_state
from stiffopt.discovery.effect import Effect, Reported, Term, Values
from stiffopt.discovery.signals import JointSignals, RobotSignals

# Typical relative deviation of a torque constant: 20 to 30 K of warming.
_TYPICAL_DEVIATION = 0.03


def _drift_term(
    seen: Sequence[str],
    states: Sequence[str],
    signals: JointSignals | RobotSignals,
    amplitudes: Values,
    shapes: Values,
) -> Term:
    """Return the deviation of a recorded run from the mean of its state; zero in any other run."""
    if signals.run not in seen:
        return Term()
    off = deviation_from_state(amplitudes, states, seen.index(signals.run))
    return Term(drive_torque=off * signals.drive_torque)


def _report_trend(amplitudes: Values, shapes: Values, constants: Constants) -> Reported:
    """Return the change from run to run, by a straight line, and the spread of all runs."""
    values, count = np.asarray(amplitudes, dtype=float), len(amplitudes)
    trend = float(np.polyfit(np.arange(count), values, 1)[0]) if count > 1 else 0.0
    spread = float(np.std(values, ddof=1)) if count > 1 else 0.0
    return {"per_run": trend, "spread": spread}


def gain_drift(
    scope: Literal["joint", "robot"],
    runs: Sequence[str],
    *,
    seen: bool = True,
    states: Sequence[str] | None = None,
) -> Effect:
    """Return the effect with one amplitude per run.

    `scope` {"joint", "robot"}: one torque constant, or that of all joints alike. `seen`: True where
    runs of these names are those of the amplitudes. `states`: state of the robot in each run, where
    two are compared.
    """
    states = tuple(states) if states is not None else ("",) * len(runs)
    common = scope == "robot"
    whose = "of all joints alike" if common else "of one joint"
    return Effect(
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
        confused_with=("friction_drift", "thermal_friction")
        if common
        else ("common_gain_drift", "friction_drift", "thermal_friction"),
        term=partial(_drift_term, tuple(runs) if seen else (), states),
        amplitudes=amplitudes_of_runs(runs, _TYPICAL_DEVIATION, -10.0, 10.0),
        report=_report_trend,
        units={"per_run": "", "spread": ""},
        of_runs=partial(gain_drift, scope),
        separate="Hold the arm still in one posture, cold and after half an hour of work: weight"
        " does not change, a torque constant does; friction does not act at rest.",
    )


# Signals without a recording have an empty run name.
GAIN_DRIFTS = tuple(gain_drift(scope, ("", "another")) for scope in ("robot", "joint"))
