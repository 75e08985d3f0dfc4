"""Entries that all kinds of actuator share: gains a joint, delay, tolerance of the gains."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

import numpy as np

from stiffopt.actuator.law import ActuatorLaw
from stiffopt.declaration import NOT_NEGATIVE, Doc, Unit
from stiffopt.errors import InputError
from stiffopt.validation import Section

Number = Annotated[float, Unit("ratio", bare=True)]
Frequency = Number
Stiffness = Annotated[float, Unit("stiffness", joint=True, bare=True)]
Damping = Annotated[float, Unit("viscous friction", joint=True, bare=True)]
_Time = Annotated[float, Unit("time", bare=True)]

# Deviation of a gain that a manufacturer states: torque constants scatter by as much.
STATED_GAIN_TOLERANCE = 0.05


class ActuatorSection(Section):
    """Base of the kinds of actuator, which follow commanded positions."""

    delay: Annotated[
        _Time | None,
        NOT_NEGATIVE,
        Doc("From a command to the torque that follows it; left out, it is estimated."),
    ] = None
    tolerance: Annotated[
        Number, NOT_NEGATIVE, Doc("One standard deviation of the stated gains, relative.")
    ] = STATED_GAIN_TOLERANCE

    @abstractmethod
    def law(self, torque_max: np.ndarray) -> ActuatorLaw:
        """Return the law of joints with these largest torques (n,)."""

    def _build_law(
        self,
        *,
        stiffness: np.ndarray,
        damping: np.ndarray,
        drive_max: np.ndarray,
        torque_max: np.ndarray,
        damping_stated: bool = True,
    ) -> ActuatorLaw:
        """Return the law with the entries that all kinds share."""
        return ActuatorLaw(
            stiffness=stiffness,
            damping=damping,
            damping_stated=damping_stated,
            drive_max=drive_max,
            torque_max=np.where(np.isfinite(torque_max) & (torque_max > 0.0), torque_max, np.inf),
            delay=np.nan if self.delay is None else self.delay,
            integral=np.zeros(len(torque_max)),
            tolerance=np.full(len(torque_max), self.tolerance),
        )

    def _per_joint(self, key: str, n: int, default: float) -> np.ndarray:
        """Return the entries of a key (n,), or the default where it is left out."""
        values = getattr(self, key)
        if values is None:
            return np.full(n, default)
        if len(values) != n:
            raise InputError(f"{key} needs one number a joint ({n}), got {len(values)}.")
        return np.array(values, dtype=float)
