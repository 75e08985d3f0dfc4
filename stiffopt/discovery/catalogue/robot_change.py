"""Changes of the robot that a planner computes with: values, bodies, drivetrains."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from stiffopt.connection.connection import Connection
from stiffopt.connection.constant import Constant
from stiffopt.discovery.effect import FittedEffect, RobotChange
from stiffopt.discovery.signals import JointConstants
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.exact.chain import exact_windup
from stiffopt.robot.robot import Robot

# Torques over the rated one at which wind-ups are matched.
TORQUE_SHARES = np.linspace(0.05, 1.0, 20)
ADDED_SPRING_NAME = "found_compliance"


def add_to_nominal_value(
    robot: Robot, found: FittedEffect, joint: int, constants: JointConstants
) -> RobotChange:
    """Add the first amplitude to the robot's value that the effect names."""
    effect = found.effect
    values = np.array(getattr(robot, effect.nominal), dtype=float)
    before = float(values[joint])
    # Friction and rotor inertia are not negative.
    values[joint] = max(before + found.amplitudes[0], 0.0)
    changed: dict[str, Any] = {effect.nominal: values}
    return RobotChange(
        replace(robot, **changed),
        f"Joint {joint + 1}: {effect.nominal.replace('_', ' ')} {before:.4g} to"
        f" {values[joint]:.4g} {effect.amplitudes[0].unit}.",
    )


def add_to_body(robot: Robot, found: FittedEffect, joint: int, subject: str) -> RobotChange:
    """Add inertial parameters to the body of a joint (from 0)."""
    before = robot.tree.bodies[joint]
    values = before.inertial_parameters + np.asarray(found.amplitudes)
    if values[0] <= 0.0:
        return RobotChange(None, "the mass of the link would not be positive")
    changed = robot.with_inertial_parameters(joint + 1, values)
    body = changed.tree.bodies[joint]
    old, new = (f"({', '.join(f'{1e3 * x:.0f}' for x in each.centre)})" for each in (before, body))
    mass = f"{before.mass:.4g} to {body.mass:.4g} kg"
    if f"{before.mass:.4g}" == f"{body.mass:.4g}":
        mass = f"{body.mass:.4g} kg as before"
    return RobotChange(
        changed, f"{subject} of link {joint + 1}: {mass}, centre from {old} to {new} mm."
    )


def chain_of(robot: Robot, joint: int) -> Chain:
    """Return the drivetrain of a joint, empty where the joint is rigid."""
    return robot.chains[joint] or Chain(())


def with_chain(robot: Robot, joint: int, chain: Chain, sentence: str) -> RobotChange:
    """Return the robot with another drivetrain in one joint."""
    chains: list[Chain | None] = list(robot.chains)
    chains[joint] = chain
    return RobotChange(replace(robot, chains=tuple(chains)), f"Joint {joint + 1}: {sentence}")


def mean_windup(chain: Chain, torques: np.ndarray) -> float:
    """Return the mean exact wind-up [rad] of a drivetrain over torques [N m]."""
    return float(np.mean(exact_windup(chain, torques))) if chain.stages else 0.0


def with_element(chain: Chain, position: int, element: Connection) -> Chain:
    """Return the drivetrain with one element replaced."""
    stages = list(chain.stages)
    stages[position] = replace(stages[position], element=element)
    return replace(chain, stages=tuple(stages))


def with_series_spring(chain: Chain, added: float, constants: JointConstants) -> tuple[Chain, str]:
    """Return the drivetrain with a spring in series of a mean wind-up [rad], and a sentence."""
    stiffness = float(np.mean(TORQUE_SHARES)) * constants.torque_rated / added
    names = chain.elements
    name = next(
        n
        for k in range(len(names) + 1)
        if (n := ADDED_SPRING_NAME + (f"_{k + 1}" if k else "")) not in names
    )
    element = Constant(name=name, torque_max=constants.torque_max, stiffness=stiffness)
    return (
        replace(chain, stages=(*chain.stages, Stage(element))),
        f"a spring of {stiffness:.4g} N m/rad in series.",
    )
