"""Torque constant that changes within each run, as windings and magnets warm."""

from __future__ import annotations

from stiffopt.discovery.catalogue.warming import TIME_CONSTANT, warmed_share
from stiffopt.discovery.effect import Amplitude, Effect, Term

GAIN_WARMUP = Effect(
    name="gain_warmup",
    family="sensor",
    scope="joint",
    equation="tau += eps*tau*(1 - exp(-t/tau_w))/(1 - exp(-t_end/tau_w))",
    signature="motor torque off in proportion to itself by a factor that changes from the begin of"
    " each run to its end",
    title="torque constant that changes within a run",
    phrase="a torque constant that changes within each run, as with warming: record the motor's"
    " temperature",
    needs=("torque", "torque_sensor", "moves"),
    confused_with=("friction_warmup", "gain_drift", "common_gain_drift"),
    term=lambda signals, a, s: Term(
        drive_torque=a[0] * signals.drive_torque * warmed_share(signals, s[0])
    ),
    amplitudes=(Amplitude("eps", "", 0.03, -10.0, 10.0),),
    shapes=(TIME_CONSTANT,),
    report=lambda amplitudes, shapes, constants: {"eps": amplitudes[0]},
    separate="Hold the arm still under its weight for some minutes: the torque of a constant weight"
    " changes with the torque constant, not with friction.",
)
