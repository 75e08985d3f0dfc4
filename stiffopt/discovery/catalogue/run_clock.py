"""One run whose torques are on another clock than its positions."""

from __future__ import annotations

from functools import partial

from stiffopt.discovery.catalogue.time_shift import delay_term
from stiffopt.discovery.effect import Amplitude, Effect, Shape

# Longest offset of the clock [s]; the plausibility check finds longer ones.
_MAX_OFFSET = 0.2


RUN_CLOCK = Effect(
    name="run_clock",
    family="sensor",
    scope="recording",
    equation="tau += tau(t - d) - tau(t) in one run",
    signature="motor torques of all joints late or early by the same time, in one run alone",
    title="torque of one run on another clock",
    phrase=(
        "torque of one run recorded late: shift its torque columns or leave the run out",
        "torque of one run recorded early: shift its torque columns or leave the run out",
    ),
    needs=("torque", "torque_sensor", "moves", "runs"),
    confused_with=("time_delay",),
    term=partial(delay_term, _MAX_OFFSET),
    amplitudes=(Amplitude(name="d", unit="s", scale=0.02, lower=-10.0, upper=10.0),),
    shapes=(
        Shape(
            name="about",
            unit="s",
            starts=(-0.08, -0.02, -0.005, 0.005, 0.02, 0.08),
            lower=-_MAX_OFFSET,
            upper=_MAX_OFFSET,
            usual=1e-4,
        ),
    ),
    linear_about=True,
    report=lambda amplitudes, shapes, constants: {"d": amplitudes[0]},
    separate="Repeat the run with one clock for all signals: a cause in the robot stays.",
)
