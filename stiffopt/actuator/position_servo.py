"""Position servo: torque proportional to the position error, damped by the velocity."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from stiffopt.actuator.gains import ActuatorSection, Damping, Stiffness
from stiffopt.actuator.law import ActuatorLaw
from stiffopt.declaration import NOT_NEGATIVE, POSITIVE, Doc


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
