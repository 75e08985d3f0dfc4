"""UR10 with 5 kg and the stand-in stiffness of its problem data, as a robot of stiffopt.

The stand-in law is no shipped connection: it shows how a user's own `Connection` is plugged in.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from common import numbers as data
from common import urdf_model

from stiffopt.connection.connection import Connection
from stiffopt.connection.reducer import Reducer
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.robot.frames import link_frame
from stiffopt.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class SquareRootContact(Connection):
    """Stiffness k = factor * sqrt((|T| + floor)/rated)."""

    kind: ClassVar[str] = "square_root_contact"
    factor: float
    rated: float

    @property
    def floor(self) -> float:
        return 0.02 * self.rated

    def windup(self, torque: Any, *, preload: Any = None, smoothing: Any = 1.0) -> Any:
        width = 1e-3 * self.torque_max * smoothing
        size = np.sqrt(torque * torque + width * width)
        root = np.sqrt(size + self.floor) + np.sqrt(self.floor)
        # 2 sqrt(rated)/factor (sqrt(s + floor) - sqrt(floor)) T/s, without the cancellation.
        return 2.0 * np.sqrt(self.rated) / self.factor * torque / root

    def tangent_compliance(self, torque: Any, *, preload: Any = None, smoothing: Any = 1.0) -> Any:
        from stiffopt.symbolic import elementwise_derivative

        return elementwise_derivative(lambda t: self.windup(t, smoothing=smoothing), torque)

    def exact_tangent_compliance(
        self, torque: np.ndarray, *, preload: float | None = None
    ) -> np.ndarray:
        return np.sqrt(self.rated) / self.factor / np.sqrt(np.abs(torque) + self.floor)


def standin_robot() -> Robot:
    """UR10 with 5 kg, limits of the problem data, stand-in stiffness."""
    numbers = data()
    model = urdf_model()
    law = numbers["dynamic_deflection"]["stand_in_stiffness"]
    n = model.nv
    torque = np.array(numbers["torque_max"])
    chains = tuple(
        Chain(
            (
                Stage(
                    Reducer(
                        name="reducer",
                        torque_max=torque[j],
                        K1=law["K1"][j],
                        K2=law["K2"][j],
                        K3=law["K3"][j],
                        T1=law["T1"][j],
                        T2=law["T2"][j],
                    ),
                    1.0,
                ),
                Stage(
                    SquareRootContact(
                        name="contact",
                        torque_max=torque[j],
                        factor=law["KC"][j],
                        rated=law["RATED"][j],
                    ),
                    1.0,
                ),
            )
        )
        for j in range(n)
    )
    return Robot(
        name="ur10_standin",
        model=model,
        position_lower=model.lowerPositionLimit.copy(),
        position_upper=model.upperPositionLimit.copy(),
        velocity_max=np.array(numbers["velocity_max"]),
        acceleration_max=np.array(numbers["dynamic_deflection"]["acceleration_max"]),
        jerk_max=np.full(n, np.inf),
        torque_max=torque,
        rotor_inertia=np.zeros(n),
        coulomb=np.zeros(n),
        viscous=np.zeros(n),
        chains=chains,
        tool=link_frame(model, numbers["tool"]["link"], numbers["tool"]["offset"]),
        flange=link_frame(model, numbers["tool"]["link"]),
    )
