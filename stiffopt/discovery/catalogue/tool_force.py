"""Constant force at the tool, as of a hose or a cable, fixed in the base or in the tool."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.effect import Amplitude, Effect, Term, Values
from stiffopt.discovery.signals import RobotConstants

_FORCE_COMPONENTS = tuple(
    Amplitude(
        name,
        "N",
        # 3 % of the weight of the arm.
        lambda constants: max(0.03 * 9.81 * float(np.sum(constants.masses)), 0.5),
        -40.0,
        40.0,
    )
    for name in ("fx", "fy", "fz")
)


def _describe_remedy(amplitudes: Values, shapes: Values, constants: RobotConstants) -> str:
    parts = ", ".join(f"{value:.1f}" for value in amplitudes)
    return (
        f"A force of ({parts}) N pulls at the tool in every run: look for a hose, a cable or a"
        " balancer there, and record without it if it is not part of the arm."
    )


TOOL_FORCE = Effect(
    name="tool_force",
    family="contact",
    scope="robot",
    equation="s += -J^T*f, f constant in the base",
    signature="torques of several joints off as under one force on the tool of constant direction",
    phrase="a constant force at the tool",
    needs=("torque", "moves", "tool_frame"),
    confused_with=("payload", "external_contact", "base_tilt"),
    term=lambda signals, a, s: Term(link_torque=-(signals.tool_levers[..., :3] @ np.asarray(a))),
    amplitudes=_FORCE_COMPONENTS,
    remedy=_describe_remedy,
    separate="Accelerate the tool in the direction of the force: a payload's torque grows with the"
    " acceleration, that of a pulling hose does not.",
)

TURNING_TOOL_FORCE = Effect(
    name="turning_tool_force",
    family="contact",
    scope="robot",
    equation="s += -J^T*R*f, f constant in the tool",
    signature="torques of several joints off as under one force on the tool that turns with it",
    phrase="a force that is fixed to the tool",
    needs=("torque", "moves", "tool_frame"),
    confused_with=("payload", "tool_force"),
    term=lambda signals, a, s: Term(link_torque=-(signals.tool_levers[..., 3:] @ np.asarray(a))),
    amplitudes=_FORCE_COMPONENTS,
    remedy=_describe_remedy,
    separate="Turn the wrist by half a turn at one place: the force of a spring in the tool turns"
    " with it, that of a hose and of a payload does not.",
)

TOOL_FORCES = (TOOL_FORCE, TURNING_TOOL_FORCE)
