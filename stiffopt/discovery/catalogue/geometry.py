"""Geometry against gravity: a tilted base, exact at any angle below half a turn; joint zeros."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.catalogue.common import symmetric_amplitude
from stiffopt.discovery.effect import (
    Effect,
    FittedEffect,
    Reported,
    RobotChange,
    Shape,
    Term,
    Values,
)
from stiffopt.discovery.signals import (
    HARMONICS_PER_JOINT,
    JointConstants,
    RobotConstants,
    RobotSignals,
)
from stiffopt.robot.robot import Robot
from stiffopt.symbolic import Quantity

# Typical tilt [rad]: between a base that is not level and one on a slanted plate.
_TYPICAL_TILT = 0.05
# Largest tilt about either axis: 2 tan of half an angle of 127 degrees.
_MAX_AMPLITUDE = 4.0
# Share of gravity along a base axis from which a rotation about it is not reported.
_ALONG_GRAVITY = 1.0 - 1e-9


def base_tilt_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the torques of gravity rotated against the base.

    For a rotation of the base by the angle r about a unit vector n normal to gravity g, and with
    u = 2 tan(r/2) n, gravity in the base is g - (u x g + |u|^2/2 g)/(1 + |u|^2/4). The square is
    split into amplitude and shape, which a fit makes equal.
    """
    gravity = np.asarray(signals.constants.gravity, dtype=float)
    axes = tilt_axes(gravity)
    size = 1.0 + 0.25 * sum(shape * shape for shape in shapes)
    along = 0.5 * sum(a * s for a, s in zip(amplitudes, shapes, strict=True))
    turned = sum(a * axis for a, axis in zip(amplitudes, axes, strict=True))
    change = -(np.cross(turned, gravity) + along * gravity) / size
    return Term(link_torque=signals.weight @ change)


def tilt_axes(gravity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors normal to gravity and to each other: x and y where it is vertical."""
    size = float(np.linalg.norm(gravity))
    down = gravity / size if size > 0.0 else np.array([0.0, 0.0, -1.0])
    # The base axis most across gravity comes first, x before y before z where equal.
    first = np.eye(3)[int(np.argmin(np.round(np.abs(down), 9)))]
    first = first - (first @ down) * down
    first /= np.linalg.norm(first)
    second = np.cross(first, down)
    return first, second if second.sum() > 0.0 else -second


def tilted_gravity(amplitudes: Values, gravity: np.ndarray) -> np.ndarray:
    """Return gravity (3,) in the axes of the tilted base [m/s^2]."""
    vector = _rotation_vector(amplitudes, gravity)
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return gravity
    axis = vector / angle
    return np.asarray(gravity * np.cos(angle) - np.cross(axis, gravity) * np.sin(angle))


def _rotation_vector(amplitudes: Values, gravity: np.ndarray) -> np.ndarray:
    """Return the rotation of the base [rad] about base axes (3,)."""
    turned = sum(a * axis for a, axis in zip(amplitudes, tilt_axes(gravity), strict=True))
    half_tangent = 0.5 * float(np.linalg.norm(turned))
    share = np.arctan(half_tangent) / half_tangent if half_tangent > 0.0 else 1.0
    return np.asarray(share * turned)


def _report_tilt(amplitudes: Values, shapes: Values, constants: RobotConstants) -> Reported:
    gravity = np.asarray(constants.gravity, dtype=float)
    vector = _rotation_vector(amplitudes, gravity)
    along = np.abs(gravity) >= _ALONG_GRAVITY * np.linalg.norm(gravity)
    return {
        f"r{name}": float(value)
        for name, value, hidden in zip("xyz", vector, along, strict=True)
        if not hidden
    }


def _describe_tilt(amplitudes: Values, shapes: Values, constants: RobotConstants) -> str:
    gravity = np.asarray(constants.gravity, dtype=float)
    angle = np.degrees(np.linalg.norm(_rotation_vector(amplitudes, gravity)))
    values = ", ".join(f"{value:.3f}" for value in tilted_gravity(amplitudes, gravity))
    return (
        f"The base stands {angle:.2g} degrees off its stated orientation: check it with a level"
        f" and write gravity = [{values}] in recordings.toml."
    )


def change_gravity(
    robot: Robot, found: FittedEffect, joint: int, constants: JointConstants
) -> RobotChange:
    """Return the robot with gravity in the axes of the tilted base."""
    before = np.asarray(robot.tree.gravity, dtype=float)
    after = tilted_gravity(found.amplitudes, before)
    text = " to ".join(f"({', '.join(f'{x:.3f}' for x in g)})" for g in (before, after))
    return RobotChange(robot.with_gravity(tuple(after)), f"Gravity: {text} m/s^2.")


BASE_TILT = Effect(
    name="base_tilt",
    family="inertial",
    scope="robot",
    equation="s += g(q; base turned by rx, ry) - g(q)",
    signature="weight on an upright first axis, which should carry none, and a fitting change on"
    " the next joints",
    phrase="a base that is not level",
    needs=("torque", "moves"),
    confused_with=("encoder_offset", "joint_zero"),
    shifts_weight=True,
    turned_gravity=tilted_gravity,
    term=base_tilt_term,
    amplitudes=tuple(
        symmetric_amplitude(name, "rad", _TYPICAL_TILT, _MAX_AMPLITUDE) for name in ("rx", "ry")
    ),
    shapes=tuple(
        Shape(name, "rad", (0.0,), -_MAX_AMPLITUDE, _MAX_AMPLITUDE, 0.0, fit="secant")
        for name in ("about_x", "about_y")
    ),
    report=_report_tilt,
    units={"rz": "rad"},
    change_robot=change_gravity,
    remedy=_describe_tilt,
    separate="Turn the first axis once with the arm stretched: only a tilt makes its torque follow"
    " the sine of its angle.",
)


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


def _describe_zero(amplitudes: Values, shapes: Values, constants: JointConstants) -> str:
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
    phrase="a joint zero (mastering) off by {dq}",
    needs=("torque", "moves"),
    term=joint_zero_term,
    amplitudes=(symmetric_amplitude("dq", "rad", _TYPICAL_ZERO, _MAX_ZERO),),
    shapes=(
        Shape("about", "rad", _INITIAL_ZEROS, -_MAX_ZERO, _MAX_ZERO, 0.0, "secant", reported=False),
    ),
    applies=lambda constants: not constants.prismatic,
    remedy=_describe_zero,
    separate="Move the joint to both sides of the vertical with the next joints bent and stretched:"
    " a wrong mass keeps the angle of no torque, a wrong zero moves it.",
)
