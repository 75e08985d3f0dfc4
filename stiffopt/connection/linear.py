"""Connections with one constant stiffness."""

from __future__ import annotations

import abc
from dataclasses import dataclass

from stiffopt.connection.connection import Connection
from stiffopt.symbolic import Quantity


@dataclass(frozen=True, kw_only=True)
class LinearConnection(Connection):
    """Connection whose wind-up is proportional to torque."""

    @property
    @abc.abstractmethod
    def compliance(self) -> float:
        """Wind-up per torque [rad/(N m)]."""

    def windup(
        self, torque: Quantity, *, preload: Quantity | None = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Wind-up angle [rad]."""
        return self.compliance * torque

    def tangent_compliance(
        self, torque: Quantity, *, preload: Quantity | None = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Constant compliance [rad/(N m)], shape as `torque`."""
        return self.compliance + 0.0 * torque
