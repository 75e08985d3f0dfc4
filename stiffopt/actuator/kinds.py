"""Kinds of actuator that a recording set can name: position servo, cascade, DC motor."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from stiffopt.actuator.gains import ActuatorSection, Damping, Frequency, Number, Stiffness
from stiffopt.actuator.law import ActuatorLaw
from stiffopt.declaration import NOT_NEGATIVE, POSITIVE, Doc


class VoltageMotor(ActuatorSection):
    """DC motor at a voltage of at most U, tau = kt / R (clip(gain (command - q), U) - kt v).

    The torque constant kt is at the output, times the gear ratio, and is the back-EMF as well.
    """

    kind: Annotated[Literal["voltage_motor"], Doc("Kind of actuator.")]
    gain: Annotated[
        tuple[Annotated[Number, POSITIVE], ...], Doc("Voltage per position error, in V/rad.")
    ]
    voltage_max: Annotated[
        tuple[Annotated[Number, POSITIVE], ...], Doc("Largest voltage at the motor, in V.")
    ]
    torque_constant: Annotated[
        tuple[Annotated[Number, POSITIVE], ...],
        Doc("Torque at the output per current, in N m/A: of the motor, times the gear ratio."),
    ]
    resistance: Annotated[
        tuple[Annotated[Number, POSITIVE], ...], Doc("Resistance of the winding, in ohm.")
    ]

    def law(self, torque_max: np.ndarray) -> ActuatorLaw:
        """Return the law of joints with these largest torques (n,)."""
        n = len(torque_max)
        constant = self._per_joint("torque_constant", n, np.nan)
        per_volt = constant / self._per_joint("resistance", n, np.nan)
        return self._build_law(
            stiffness=per_volt * self._per_joint("gain", n, np.nan),
            damping=per_volt * constant,
            drive_max=per_volt * self._per_joint("voltage_max", n, np.nan),
            torque_max=torque_max,
        )


class Cascade(ActuatorSection):
    """Cascade without integral part, tau = velocity_gain (position_gain (command - q) - v)."""

    kind: Annotated[Literal["cascade"], Doc("Kind of actuator.")]
    position_gain: Annotated[
        tuple[Annotated[Frequency, POSITIVE], ...],
        Doc("Commanded velocity per position error (Kv), in 1/s."),
    ]
    velocity_gain: Annotated[
        tuple[Annotated[Damping, POSITIVE], ...], Doc("Torque per velocity error.")
    ]

    def law(self, torque_max: np.ndarray) -> ActuatorLaw:
        """Return the law of joints with these largest torques (n,)."""
        n = len(torque_max)
        gain = self._per_joint("velocity_gain", n, np.nan)
        return self._build_law(
            stiffness=gain * self._per_joint("position_gain", n, np.nan),
            damping=gain,
            drive_max=np.full(n, np.inf),
            torque_max=torque_max,
        )


class PositionServo(ActuatorSection):
    """Position servo, tau = kp (command - q) - kd v, clipped at the largest torque."""

    kind: Annotated[Literal["position_servo"], Doc("Kind of actuator.")]
    kp: Annotated[
        tuple[Annotated[Stiffness, POSITIVE], ...] | None,
        Doc("Torque per position error; left out, it is estimated from the arm's weight."),
    ] = None
    kd: Annotated[
        tuple[Annotated[Damping, NOT_NEGATIVE], ...] | None,
        Doc(
            "Torque per velocity; left out, it counts as viscous friction, of which nominal values"
            " then tell nothing."
        ),
    ] = None

    def law(self, torque_max: np.ndarray) -> ActuatorLaw:
        """Return the law of joints with these largest torques (n,)."""
        n = len(torque_max)
        return self._build_law(
            stiffness=self._per_joint("kp", n, np.nan),
            damping=self._per_joint("kd", n, 0.0),
            damping_stated=self.kd is not None,
            drive_max=np.full(n, np.inf),
            torque_max=torque_max,
        )


ActuatorKind = Annotated[PositionServo | Cascade | VoltageMotor, Field(discriminator="kind")]
