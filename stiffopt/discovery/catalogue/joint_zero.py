"""Wrong zero of a joint (mastering), seen in weight and inertia without a link encoder."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import HARMONICS_PER_JOINT, JointConstants, RobotSignals
from stiffopt.symbolic import Quantity

# Typical error [rad]: between a mastering beside the mark and another convention, a quarter turn.
_TYPICAL_ZERO, _MAX_ZERO = 0.1, np.pi
# Angles about which a search begins [rad]; a secant converges from the next of them.
_INITIAL_ZEROS = (0.0, 1.5, -1.5, 3.0)


def joint_zero_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the torques at q + x less those at q, x at the located joint, linear about the shape.

    Torques are harmonics of x up to the second: x is split into an amplitude, and a shape in the
    ratio of a harmonic to x; a fit makes both equal.
    """
    about, first = shapes[0], HARMONICS_PER_JOINT * signals.link
    torque: Quantity = 0.0
    for order in (1, 2):
        half = 0.5 * order * about
        sine = order * np.sinc(order * about / np.pi)
        # (cos x - 1)/x = -sin(x/2) sin(x/2)/(x/2)
        cosine = -order * np.sin(half) * np.sinc(half / np.pi)
        for k, ratio in enumerate((sine, cosine), start=2 * order - 2):
            torque = torque + amplitudes[0] * ratio * signals.zero_harmonics[..., first + k]
    return Term(link_torque=torque)


def _turns(constants: JointConstants) -> bool:
    return not constants.prismatic


def _describe_remedy(amplitudes: Values, shapes: Values, constants: JointConstants) -> str:
    offsets = ["0"] * constants.joints
    offsets[constants.joint - 1] = f"{amplitudes[0]:.5f}"
    return (
        f"Joint {constants.joint} stands {np.degrees(amplitudes[0]):+.2f} degrees from where its"
        " encoder says: check its mastering mark, and write"
        f" offset = [{', '.join(offsets)}] in [signals] of recordings.toml, added to one that is"
        " there."
    )


JOINT_ZERO = Effect(
    name="joint_zero",
    family="geometry",
    scope="joint",
    couples_joints=True,
    shifts_weight=True,
    moves_zero=True,
    equation="s += f(q + dq, v, a) - f(q, v, a)",
    signature="weight of the joint and of those before it off as if the joint stood at another"
    " angle, the same in every run",
    title="joint zero",
    phrase="a joint zero that is off (mastering)",
    needs=("torque", "moves"),
    term=joint_zero_term,
    amplitudes=(
        Amplitude(
            "dq", "rad", _TYPICAL_ZERO, -_MAX_ZERO / _TYPICAL_ZERO, _MAX_ZERO / _TYPICAL_ZERO
        ),
    ),
    shapes=(
        Shape("about", "rad", _INITIAL_ZEROS, -_MAX_ZERO, _MAX_ZERO, 0.0, "secant", reported=False),
    ),
    applies=_turns,
    remedy=_describe_remedy,
    separate="Move the joint to both sides of the vertical with the next joints bent and stretched:"
    " a wrong mass keeps the angle of no torque, a wrong zero moves it.",
)
