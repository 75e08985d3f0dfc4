"""Cascade of industrial drives: position loop, velocity loop, torque."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from stiffopt.actuator.gains import ActuatorSection, Damping, Frequency
from stiffopt.actuator.law import ActuatorLaw
from stiffopt.declaration import POSITIVE, Doc


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
