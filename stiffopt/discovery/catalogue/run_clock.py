"""One run whose torques are on another clock than its positions."""

from __future__ import annotations

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
    term=delay_term,
    amplitudes=(Amplitude("d", "s", 0.02, -10.0, 10.0),),
    shapes=(
        Shape(
            "about",
            "s",
            (-0.08, -0.02, -0.005, -1e-3, 1e-3, 0.005, 0.02, 0.08),
            -_MAX_OFFSET,
            _MAX_OFFSET,
            1e-4,
        ),
    ),
    linear_about=True,
    report=lambda amplitudes, shapes, constants: {"d": amplitudes[0]},
    separate="Repeat the run with one clock for all signals: a cause in the robot stays.",
)
