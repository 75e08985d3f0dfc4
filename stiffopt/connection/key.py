"""Parallel key between shaft and hub: two rough flanks under pressure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np

from stiffopt.connection.connection import ContactConnection
from stiffopt.contact.surface import LOWEST_PRESSURE, SurfacePair
from stiffopt.contact.surrogate import ContactLaw, LawName, contact_law
from stiffopt.contact.validate import require_ordered
from stiffopt.declaration import DETAIL, NOT_NEGATIVE, PART, Doc, Length, Named, Pressure
from stiffopt.symbolic import Quantity

# Parallel flanks need quadrature: six Gauss-Legendre points in ln(1 + T/Tc) are accurate to 1e-9.
_GAUSS_NODES, _GAUSS_WEIGHTS = (array.tolist() for array in np.polynomial.legendre.leggauss(6))


@dataclass(frozen=True, kw_only=True)
class Key(ContactConnection):
    """Parallel key (DIN 6885): flanks at r1 = d/2 - h1/2 and r2 = d/2 + h2/2 carry the torque.

    Flank i has the area A_i = length * h_i, the pressure p_i = |T|/(r_i A_i) + p0 and the torsional
    stiffness k_n(p_i) A_i r_i^2. Clearance at reversal is not part of the model. Source of the
    layout: DIN 6892 (flank pressures); wind-up by integrating the tangent compliance over torque.
    """

    kind: ClassVar[str] = "key"
    shaft_diameter: Annotated[Length, PART, Doc("Diameter d of the shaft.")]
    length: Annotated[Length, PART, Doc("Bearing length of the key.")]
    shaft_flank_height: Annotated[
        Length, DETAIL, Doc("Bearing height h1 of the flank in the shaft.")
    ]
    hub_flank_height: Annotated[Length, DETAIL, Doc("Bearing height h2 of the flank in the hub.")]
    surface: Annotated[SurfacePair, Doc("Pair of surfaces of the flanks.")]
    prepressure: Annotated[
        Pressure,
        NOT_NEGATIVE,
        Doc(
            "Pressure p0 of the fit without torque. At 0 the exact compliance is infinite at zero "
            "torque and the smoothed one depends on the smoothing width."
        ),
    ] = LOWEST_PRESSURE
    flanks: Annotated[
        Literal["series", "parallel"],
        Doc(
            "Series: shaft, key and hub in one load path. Parallel: flank stiffnesses add, as in "
            "some literature; roughly four times stiffer."
        ),
    ] = "series"
    # Smooth law of the optimisation; the exact compliance always uses the fractal law.
    contact_law: LawName | ContactLaw = "log_cubic"
    hub_material: Annotated[
        str,
        Named("material"),
        Doc("Material of the hub; sets the permissible flank pressure, not the stiffness."),
    ] = "steel"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_ordered(
            self.owner,
            shaft_flank_height=self.shaft_flank_height,
            shaft_diameter=self.shaft_diameter,
        )

    @cached_property
    def law(self) -> ContactLaw:
        """Smooth contact law of the flanks."""
        return contact_law(self.surface, self.contact_law)

    @property
    def radii(self) -> tuple[float, float]:
        """Mean radii of the flanks in shaft and hub [m]."""
        half = self.shaft_diameter / 2
        return half - self.shaft_flank_height / 2, half + self.hub_flank_height / 2

    @property
    def areas(self) -> tuple[float, float]:
        """Areas of the two flanks [m^2]."""
        return self.length * self.shaft_flank_height, self.length * self.hub_flank_height

    def flank_pressures(self, torque: Quantity) -> tuple[Quantity, Quantity]:
        """Return the pressures of shaft and hub flank [Pa] for torque >= 0."""
        (r1, r2), (a1, a2) = self.radii, self.areas
        return torque / (r1 * a1) + self.prepressure, torque / (r2 * a2) + self.prepressure

    def pressure(self, torque: Quantity) -> Quantity:
        """Return the larger flank pressure [Pa]."""
        return np.maximum(*self.flank_pressures(np.absolute(torque)))

    def loading_windup(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Return the integral of the flank compliances from 0 to `torque` [rad]."""
        if self.flanks == "parallel":
            return self._parallel_windup(torque)
        # Integrated over pressure the area cancels: phi_i = (1/r_i) int dp/k_n.
        return sum(
            self.law.approach(self.prepressure, pressure) / radius
            for pressure, radius in zip(self.flank_pressures(torque), self.radii, strict=True)
        )

    def loading_compliance(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Return the compliance of the two flanks [rad/(N m)]."""
        k1, k2 = (
            self.law.stiffness(pressure) * area * radius**2
            for pressure, area, radius in zip(
                self.flank_pressures(torque), self.areas, self.radii, strict=True
            )
        )
        return 1 / (k1 + k2) if self.flanks == "parallel" else 1 / k1 + 1 / k2

    def _parallel_windup(self, torque: Quantity) -> Quantity:
        reach = [radius * area for radius, area in zip(self.radii, self.areas, strict=True)]
        # Panels end where a flank pressure enters the range of the fitted law.
        room = self.law.lower - self.prepressure
        edges = [room * lever for lever in sorted(reach)] if room > 0.0 else []
        start, total = 0.0, 0.0
        if self.prepressure == 0.0:
            # Up to the first edge both flanks follow one power law: closed form from zero.
            start = np.minimum(torque, edges.pop(0))
            exponent = self.law.log_slope(self.law.lower)
            total = start * self.loading_compliance(start, None) / (1 - exponent)
        for edge in edges:
            end = np.minimum(torque, edge)
            total = total + self._parallel_panel(start, end, min(reach))
            start = end
        return total + self._parallel_panel(start, torque, min(reach))

    def _parallel_panel(self, start: Quantity, end: Quantity, reach: float) -> Quantity:
        """Return the integral of the compliance between two torques, in ln(p0 r A + T) [rad]."""
        shift = self.prepressure * reach
        origin = np.log(start + shift)
        span = np.log((end + shift) / (start + shift))
        total = 0.0
        for node, weight in zip(_GAUSS_NODES, _GAUSS_WEIGHTS, strict=True):
            shifted = np.exp(origin + 0.5 * (1 + node) * span)
            total = total + 0.5 * weight * shifted * self.loading_compliance(shifted - shift, None)
        return span * total
