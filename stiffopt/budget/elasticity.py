"""Errors of the tool by the joints: wind-up, bearings and links, payload, hysteresis and servo.

Quasi-static: every spring carries the load of the motion, without vibration.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stiffopt.budget.sources import ErrorSource, KnownError, States, ToolJacobians
from stiffopt.elastic.simulate import TYPICAL_HALF_LOOP
from stiffopt.elastic.springs import joint_springs
from stiffopt.elastic.uncertainty import UNIFORM_MEAN_SQUARE, Uncertainty
from stiffopt.robot.bearings import bearing_deflections, correcting_joints
from stiffopt.robot.robot import Robot

# Standard deviation of a parameter that lies evenly between its bounds, over the bound.
_DEVIATION_OVER_BOUND = np.sqrt(UNIFORM_MEAN_SQUARE)
# Standard deviation of a uniform distribution over its width.
_UNIFORM_DEVIATION = 1.0 / np.sqrt(12.0)


def elastic_errors(
    tool: ToolJacobians,
    states: States,
    uncertainty: Uncertainty,
    force: np.ndarray,
    *,
    compensated: bool,
) -> Iterator[ErrorSource | KnownError]:
    """Yield errors by wind-up and bearings: their mean, by uncertain stiffness and payload.

    `force` (3,): on the tool, base axes [N]. `compensated`: the motors lead by the wind-up and,
    where joints reach, against the bearings: these are then no error.
    """
    robot = tool.robot
    windup = _windups(robot, tool, states, force)
    if not compensated:
        yield KnownError(group="torsion", effect=-tool.moved(windup))
    shares = _DEVIATION_OVER_BOUND * uncertainty.shares(robot.n)
    for j in np.flatnonzero(np.any(windup != 0.0, axis=0) & (shares > 0.0)):
        yield ErrorSource(
            name=f"stiffness of {robot.joint_names[j]}",
            group="torsion",
            effect=shares[j] * windup[:, j, None] * tool.jacobian[:, :, j],
        )
    tilt = _bearing_deflections(robot, states, force)
    if robot.tilts:
        whole = tilt.sum(axis=1)
        led = correcting_joints(robot, states.position, whole) if compensated else 0.0 * windup
        yield KnownError(group="tilt", effect=whole + tool.moved(led))
    share = _DEVIATION_OVER_BOUND * uncertainty.bearing_stiffness
    for j in np.flatnonzero(np.any(tilt != 0.0, axis=(0, 2)) & (share > 0.0)):
        yield ErrorSource(
            name=f"{_name_mounts(robot, int(j))} of {robot.joint_names[j]}",
            group="tilt",
            effect=share * tilt[:, j],
        )
    if robot.payload is not None and uncertainty.payload > 0.0:
        heavier = robot.with_payload_times(1.0 + _DEVIATION_OVER_BOUND * uncertainty.payload)
        added = _windups(heavier, tool, states, force) - windup
        tilted = _bearing_deflections(heavier, states, force) - tilt
        yield ErrorSource(
            name="payload", group="payload", effect=tilted.sum(axis=1) - tool.moved(added)
        )


def hysteresis_sources(tool: ToolJacobians) -> Iterator[ErrorSource]:
    """Yield one source a joint: anywhere in its loop, of the typical width where none is stated."""
    half = _half_loops(tool.robot)
    for j in np.flatnonzero(half):
        yield ErrorSource(
            name=f"hysteresis of {tool.robot.joint_names[j]}",
            group="hysteresis",
            effect=2.0 * half[j] * _UNIFORM_DEVIATION * tool.jacobian[:, :, j],
        )


def servo_errors(tool: ToolJacobians, states: States) -> Iterator[ErrorSource | KnownError]:
    """Yield the mean lag of the servos and its spread, between none and that of the worst."""
    if np.any(states.lag):
        lag = tool.moved(states.lag)
        yield KnownError(group="servo", effect=0.5 * lag)
        yield ErrorSource(name="servo", group="servo", effect=_UNIFORM_DEVIATION * lag)


def _half_loops(robot: Robot) -> np.ndarray:
    """Half widths (n,) [rad] of the hysteresis loops of the joints."""
    springs = np.array([spring is not None for spring in joint_springs(robot)])
    if robot.hysteresis is not None and np.any(robot.hysteresis):
        return np.asarray(springs * robot.hysteresis)
    return np.asarray(TYPICAL_HALF_LOOP * (springs & ~robot.prismatic))


def _name_mounts(robot: Robot, joint: int) -> str:
    """Name the elastic parts behind a joint (from 0)."""
    bearing = bool(robot.bearings) and robot.bearings[joint] is not None
    link = bool(robot.links) and robot.links[joint] is not None
    return "bearing and link" if bearing and link else "link" if link else "bearing"


def _bearing_deflections(robot: Robot, states: States, force: np.ndarray) -> np.ndarray:
    """Displacement and rotation (K, n, 6) of the tool by each bearing, weight included."""
    return bearing_deflections(robot, states.position, states.velocity, states.acceleration, force)


def _windups(robot: Robot, tool: ToolJacobians, states: States, force: np.ndarray) -> np.ndarray:
    """Wind-ups (K, n) [rad] under the torques of the motion."""
    torque = robot.bodies_in_motion().torque(states.position, states.velocity, states.acceleration)
    torque = torque - np.einsum("kij,i->kj", tool.jacobian[:, :3], force)
    columns = [
        np.zeros(len(torque)) if spring is None else spring.windup(torque[:, j])
        for j, spring in enumerate(joint_springs(robot))
    ]
    return np.stack(columns, axis=1)
