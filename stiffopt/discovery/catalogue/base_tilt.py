"""Tilt of the base against gravity, exact at any angle below half a turn."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.effect import (
    Amplitude,
    Effect,
    FittedEffect,
    Reported,
    RobotChange,
    Shape,
    Term,
    Values,
)
from stiffopt.discovery.signals import JointConstants, RobotConstants, RobotSignals
from stiffopt.robot.robot import Robot

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


def _describe_remedy(amplitudes: Values, shapes: Values, constants: RobotConstants) -> str:
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
        Amplitude(
            name,
            "rad",
            _TYPICAL_TILT,
            -_MAX_AMPLITUDE / _TYPICAL_TILT,
            _MAX_AMPLITUDE / _TYPICAL_TILT,
        )
        for name in ("rx", "ry")
    ),
    shapes=tuple(
        Shape(name, "rad", (0.0,), -_MAX_AMPLITUDE, _MAX_AMPLITUDE, 0.0, fit="secant")
        for name in ("about_x", "about_y")
    ),
    report=_report_tilt,
    units={"rz": "rad"},
    change_robot=change_gravity,
    remedy=_describe_remedy,
    separate="Turn the first axis once with the arm stretched: only a tilt makes its torque follow"
    " the sine of its angle.",
)
