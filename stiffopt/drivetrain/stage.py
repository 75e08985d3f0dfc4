"""One element of a drivetrain, referred through its ratio to the joint's output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from stiffopt.connection.connection import Connection
from stiffopt.declaration import FRACTION, POSITIVE, Doc, Ratio, check_fields
from stiffopt.symbolic import Quantity

Preloads = Mapping[str, Quantity] | None


@dataclass(frozen=True)
class Stage:
    """One element of a chain and where it sits.

    The element carries T/(ratio efficiency) and its wind-up counts 1/ratio. `reflect` is that of
    the `stiffopt.drivetrain.chain.Chain`, which sets it for all its stages.
    """

    element: Connection
    ratio: Annotated[Ratio, POSITIVE, Doc("Turns of the element for one turn of the joint.")] = 1.0
    efficiency: Annotated[
        Ratio, FRACTION, Doc("Of the way from the element to the joint; 1 is without losses.")
    ] = 1.0
    group: Annotated[
        str | None,
        Doc("Group of elements that act in parallel; without it in series with the rest."),
    ] = None
    reflect: bool = True

    def __post_init__(self) -> None:
        check_fields(self, self.element.owner)

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
            own, preload=self._select_preload(preloads), smoothing=smoothing
        )

    def tangent_compliance(
        self, torque: Quantity, preloads: Preloads, smoothing: Quantity
    ) -> Quantity:
        """Slope of `windup` [rad/(N m)]."""
        own = torque / self.reduction
        slope = self.element.tangent_compliance(
            own, preload=self._select_preload(preloads), smoothing=smoothing
        )
        return self.counts / self.reduction * slope

    def secant_compliance(
        self, torque: Quantity, preloads: Preloads, smoothing: Quantity
    ) -> Quantity:
        """Wind-up over torque [rad/(N m)], with its limit at zero."""
        own = torque / self.reduction
        stiffness = self.element.secant_stiffness(
            own, preload=self._select_preload(preloads), smoothing=smoothing
        )
        return self.counts / self.reduction / stiffness

    def slip_torque(self, preloads: Preloads = None) -> float:
        """Joint torque at which this stage alone would slip [N m]."""
        return float(self.element.slip_torque(self._select_preload(preloads))) * self.reduction

    def _select_preload(self, preloads: Preloads) -> Quantity | None:
        return (preloads or {}).get(self.element.name)
