"""Set screws or pins that press on a shaft and hold it by friction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from stiffopt.connection.connection import ContactConnection
from stiffopt.connection.fastener import SetScrew
from stiffopt.contact.shear import SHEAR_LAWS, ShearLaw, shear_softening, shear_travel
from stiffopt.contact.surface import SurfacePair
from stiffopt.contact.surrogate import ContactLaw, LawName, contact_law, require_law
from stiffopt.contact.validate import require_one_of, require_positive
from stiffopt.symbolic import Quantity

# Pin tips work at hundreds of MPa, up to indentation of a hardened shaft.
_LOWEST_PRESSURE = 1e6
_HIGHEST_PRESSURE = 2e9


@dataclass(frozen=True, kw_only=True)
class ClampingPins(ContactConnection):
    """Pins with flat tips, all with the same preload, at the surface of a shaft.

    Each contact yields tangentially by its rough face and by the half space under the small tip,
    1/(8 G* a) with a the tip radius, one after the other.

    Parameters
    ----------
    pin_count : int
    shaft_radius : float
        Lever of the friction forces [m].
    tip_diameter : float
        Diameter of the flat tip [m].
    preload : float
        Force of one pin [N].
    surface : SurfacePair
    friction : float or None
        None takes the surface's.
    both_sides : bool
        One-sided screws also press the far side of the shaft against the bore: twice as many
        contacts. False for opposed pins.
    half_space : bool
        Count the half space under the tip.
    shear : {"mindlin", "load"}
    contact_law : {"log_cubic", "power_law"} or ContactLaw
    screw : SetScrew or None
        What presses one tip; sets its limits and its loss of preload, not the stiffness.

    Notes
    -----
    Valid up to 0.95 of the slip torque, see `stiffopt.contact.shear`.
    """

    kind: ClassVar[str] = "clamping_pins"
    takes_preload: ClassVar[bool] = True
    needs_preload: ClassVar[bool] = True
    pin_count: int
    shaft_radius: float
    tip_diameter: float
    surface: SurfacePair
    friction: float | None = None
    both_sides: bool = True
    half_space: bool = True
    shear: ShearLaw = "mindlin"
    contact_law: LawName | ContactLaw = "log_cubic"
    screw: SetScrew | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(
            self.owner,
            pin_count=self.pin_count,
            shaft_radius=self.shaft_radius,
            tip_diameter=self.tip_diameter,
            friction=self.friction_coefficient,
        )
        require_one_of(self.owner, SHEAR_LAWS, shear=self.shear)
        require_law(self.owner, self.contact_law)

    @cached_property
    def law(self) -> ContactLaw:
        """Smooth contact law of the tips."""
        return contact_law(self.surface, self.contact_law, _LOWEST_PRESSURE, _HIGHEST_PRESSURE)

    @property
    def friction_coefficient(self) -> float:
        """Coefficient of friction in use [-]."""
        return self.surface.friction if self.friction is None else self.friction

    @property
    def contact_count(self) -> int:
        """Number of pressed contacts."""
        return self.pin_count * (2 if self.both_sides else 1)

    @property
    def tip_area(self) -> float:
        """Area of one tip [m^2]."""
        return math.pi * self.tip_diameter**2 / 4

    def pressure(self, torque: Quantity, preload: Quantity | None = None) -> Quantity:
        """Pressure under one tip [Pa], whatever the torque."""
        return self._preload(preload) / self.tip_area + 0.0 * torque

    def slip_torque(self, preload: Quantity | None = None) -> Quantity:
        """Torque at which all contacts slip, mu F r n [N m]."""
        force = self.contact_count * self._preload(preload)
        return self.friction_coefficient * force * self.shaft_radius

    def _face_stiffness(self, preload: Quantity) -> Quantity:
        """Torsional stiffness of the rough faces without shear load [N m/rad]."""
        per_area = self.surface.shear_ratio * self.law.stiffness(preload / self.tip_area)
        return self.contact_count * self.shaft_radius**2 * per_area * self.tip_area

    @property
    def _half_space_compliance(self) -> float:
        if not self.half_space:
            return 0.0
        one = 8 * self.surface.contact_shear_modulus * self.tip_diameter / 2
        return 1 / (self.contact_count * self.shaft_radius**2 * one)

    def loading_windup(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Wind-up of faces and half spaces [rad]."""
        slip = self.slip_torque(preload)
        travel = shear_travel(self.law, preload / self.tip_area, torque / slip, self.shear)
        return slip / self._face_stiffness(preload) * travel + self._half_space_compliance * torque

    def loading_compliance(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Compliance of faces and half spaces [rad/(N m)]."""
        ratio = torque / self.slip_torque(preload)
        softening = shear_softening(self.law, preload / self.tip_area, ratio, self.shear)
        return softening / self._face_stiffness(preload) + self._half_space_compliance
