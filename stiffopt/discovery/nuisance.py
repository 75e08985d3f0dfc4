"""Nominal values within their tolerances: what a finding gets no credit for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from stiffopt.discovery.prepare import PreparedRun, sign
from stiffopt.discovery.robot import RobotModel
from stiffopt.recording.nominal import Tolerance


@dataclass(frozen=True)
class NuisanceColumn:
    """How one nominal value moves the channels.

    Parameters
    ----------
    name : str
        Such as "coulomb 3".
    sd : float
        Its tolerance.
    torque, deflection : array (K, n) or None
        Change of the predicted drive torque [N m] and deflection [rad] for a unit of the value.
    """

    name: str
    sd: float
    torque: np.ndarray | None
    deflection: np.ndarray | None


def nuisance_columns(
    run: PreparedRun, robot: RobotModel, tolerance: Tolerance
) -> Iterator[NuisanceColumn]:
    """Columns of all nominal values along a run; the same order for every run."""
    yield from _bodies(run, robot, tolerance)
    signals = run.signals
    compliance_free = np.zeros_like(signals.spring_torque)

    def single(j: int, values: np.ndarray) -> np.ndarray:
        column = compliance_free.copy()
        column[:, j] = values
        return column

    for j in range(robot.n):
        speed = signals.motor_velocity[:, j]
        relative = (
            ("rotor_inertia", robot.rotor_inertia[j] * signals.motor_acceleration[:, j]),
            ("coulomb", robot.coulomb[j] * sign(speed)),
            ("viscous", robot.viscous[j] * speed),
            ("torque_constant", signals.drive_torque[:, j]),
        )
        for name, values in relative:
            sd = getattr(tolerance, name)
            if sd and np.any(values):
                yield NuisanceColumn(f"{name} {j + 1}", sd, single(j, values), None)
        if tolerance.stiffness and np.any(signals.windup[:, j]):
            values = signals.windup[:, j]
            yield NuisanceColumn(f"stiffness {j + 1}", tolerance.stiffness, None, single(j, values))
        if tolerance.encoder_zero:
            values = np.ones(len(signals.time))
            yield NuisanceColumn(
                f"encoder_zero {j + 1}", tolerance.encoder_zero, None, single(j, values)
            )


def _bodies(run: PreparedRun, robot: RobotModel, tolerance: Tolerance) -> Iterator[NuisanceColumn]:
    """Mass and centre of mass of every body."""
    compliance = robot.compliance(run.signals.spring_torque)
    for position, joint in enumerate(robot.order):
        inertia = robot.model.inertias[int(joint) + 1]
        regressor = run.signals.body_regressor[:, :, 10 * position : 10 * position + 10]
        now = inertia.toDynamicParameters()
        if tolerance.mass:
            torque = regressor @ now
            yield NuisanceColumn(
                f"mass {position + 1}", tolerance.mass, torque, compliance * torque
            )
        if not tolerance.com:
            continue
        for axis in range(3):
            shift = np.zeros(3)
            shift[axis] = 1e-5
            moved = pin.Inertia(inertia.mass, inertia.lever + shift, inertia.inertia)
            torque = regressor @ ((moved.toDynamicParameters() - now) / 1e-5)
            name = f"com {position + 1} {'xyz'[axis]}"
            yield NuisanceColumn(name, tolerance.com, torque, compliance * torque)


def merged(tolerance: Tolerance, default: Tolerance) -> Tolerance:
    """Tolerances of the set, the defaults where it is silent."""
    names = vars(default)
    return Tolerance(
        **{
            name: own if (own := getattr(tolerance, name)) is not None else default_value
            for name, default_value in names.items()
        }
    )
