"""One element of a drivetrain, referred through its ratio to the joint's output."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from stiffopt.connection.connection import Connection
from stiffopt.errors import InputError
from stiffopt.symbolic import Quantity

Preloads = Mapping[str, Quantity] | None


@dataclass(frozen=True)
class Stage:
    """One element of a chain and where it sits.

    Parameters
    ----------
    element : Connection
    ratio : float
        Turns of the element for one turn of the joint [-].
    efficiency : float
        Of the way from the element to the joint: it carries T/(ratio efficiency) [-].
    group : str or None
        Stages of the same group are in parallel; None: in series with the rest.
    reflect : bool
        See `stiffopt.drivetrain.chain.Chain`, which sets it for all its stages.
    """

    element: Connection
    ratio: float = 1.0
    efficiency: float = 1.0
    group: str | None = None
    reflect: bool = True

    def __post_init__(self) -> None:
        name = self.element.name
        if not (math.isfinite(self.ratio) and self.ratio > 0.0):
            raise InputError(
                f"{name}: ratio = {self.ratio:g} must be a number above 0. "
                "Give the turns of the element for one turn of the joint."
            )
        if not 0.0 < self.efficiency <= 1.0:
            raise InputError(
                f"{name}: efficiency = {self.efficiency:g} must be above 0 and at most 1. "
                "Give 1 for a stage without losses."
            )

    @property
    def reduction(self) -> float:
        """Joint torque for a unit of the element's torque [-]."""
        return self.ratio * self.efficiency

    @property
    def counts(self) -> float:
        """Wind-up of the joint for a unit of the element's wind-up [-]."""
        return 1.0 / self.ratio if self.reflect else self.reduction

    def windup(self, torque: Quantity, preloads: Preloads, smoothing: Quantity) -> Quantity:
        """Wind-up at the joint [rad] for the joint torque [N m] that flows through this stage."""
        own = torque / self.reduction
        return self.counts * self.element.windup(
            own, preload=self._preload(preloads), smoothing=smoothing
        )

    def tangent_compliance(
        self, torque: Quantity, preloads: Preloads, smoothing: Quantity
    ) -> Quantity:
        """Slope of `windup` [rad/(N m)]."""
        own = torque / self.reduction
        slope = self.element.tangent_compliance(
            own, preload=self._preload(preloads), smoothing=smoothing
        )
        return self.counts / self.reduction * slope

    def secant_compliance(
        self, torque: Quantity, preloads: Preloads, smoothing: Quantity
    ) -> Quantity:
        """Wind-up over torque [rad/(N m)], with its limit at zero."""
        own = torque / self.reduction
        stiffness = self.element.secant_stiffness(
            own, preload=self._preload(preloads), smoothing=smoothing
        )
        return self.counts / self.reduction / stiffness

    def slip_torque(self, preloads: Preloads = None) -> float:
        """Joint torque at which this stage alone would slip [N m]."""
        return float(self.element.slip_torque(self._preload(preloads))) * self.reduction

    def _preload(self, preloads: Preloads) -> Quantity | None:
        return (preloads or {}).get(self.element.name)
