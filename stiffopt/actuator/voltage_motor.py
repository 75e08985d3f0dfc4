"""Voltage-limited DC motor, as of hobby servos: voltage from the error, less the back-EMF."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from stiffopt.actuator.gains import ActuatorSection, Number
from stiffopt.actuator.law import ActuatorLaw
from stiffopt.declaration import POSITIVE, Doc


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
