"""Set screws or pins that clamp a shaft by friction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

from stiffopt.connection.connection import ContactConnection
from stiffopt.connection.fastener import SetScrew
from stiffopt.contact.shear import ShearLaw, shear_softening, shear_travel
from stiffopt.contact.surface import SurfacePair
from stiffopt.contact.surrogate import ContactLaw, LawName, contact_law
from stiffopt.declaration import (
    DETAIL,
    FRICTION,
    NOT_NEGATIVE,
    PART,
    POSITIVE,
    Angle,
    Bounds,
    Doc,
    Length,
    Ratio,
)
from stiffopt.symbolic import Quantity

# Range of the fitted contact law [Pa]: tips work at hundreds of MPa, up to indentation.
_LOWEST_PRESSURE = 1e6
_HIGHEST_PRESSURE = 2e9


@dataclass(frozen=True, kw_only=True)
class ClampingPins(ContactConnection):
    """Pins with flat tips and equal preloads on the surface of a shaft.

    The tangential compliance of a contact is that of its rough face in series with the half space
    under the tip, 1/(8 G* a) with a the tip radius. Valid up to 0.95 of the slip torque, see
    `stiffopt.contact.shear`.
    """

    kind: ClassVar[str] = "clamping_pins"
    takes_preload: ClassVar[bool] = True
    needs_preload: ClassVar[bool] = True
    count: Annotated[int, POSITIVE, Doc("Number of pins.")]
    shaft_diameter: Annotated[Length, PART, Doc("Diameter of the clamped shaft.")]
    tip_diameter: Annotated[Length, DETAIL, Doc("Diameter of the flat tip of a pin.")]
    surface: Annotated[SurfacePair, Doc("Pair of surfaces of tip and shaft.")]
    friction: Annotated[
        Ratio | None,
        FRICTION,
        Doc("Coefficient of friction of a tip; default that of the surface."),
    ] = None
    both_sides: Annotated[
        bool,
        Doc(
            "One-sided screws also press the shaft against the bore, with the sum of their forces "
            "as vectors. False for opposed pins."
        ),
    ] = True
    spacing: Annotated[
        Angle, NOT_NEGATIVE, Doc("Angle about the shaft from one screw to the next.")
    ] = math.pi / 2
    half_space: Annotated[bool, Doc("Count the half space under the tip.")] = True
    shear: ShearLaw = "mindlin"
    contact_law: LawName | ContactLaw = "log_cubic"
    screw: Annotated[
        SetScrew | None,
        Doc("Screw behind one tip; sets limits and loss of the preload, not the stiffness."),
    ] = None

    # Number of equal connections that share the bore: with count 1, the share of one screw.
    sharing: Annotated[int, Bounds(least=1)] = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        POSITIVE.check(f"{self.owner}: friction", self.friction_coefficient)

    @property
    def shaft_radius(self) -> float:
        """Lever of the friction forces [m]."""
        return self.shaft_diameter / 2

    @cached_property
    def law(self) -> ContactLaw:
        """Smooth contact law of the tips."""
        return contact_law(self.surface, self.contact_law, _LOWEST_PRESSURE, _HIGHEST_PRESSURE)

    @property
    def friction_coefficient(self) -> float:
        """Coefficient of friction in use [-]."""
        return self.surface.friction if self.friction is None else self.friction

    @property
    def contact_count(self) -> float:
        """Equivalent number of contacts; the bore counts |sin(n g/2)/sin(g/2)| times one screw.

        Two screws at an angle g of 90 degrees press the bore with 1.41 times the force of one.
        """
        if not self.both_sides:
            return float(self.count)
        screws, half = self.count * self.sharing, self.spacing / 2
        turned = math.sin(half)
        together = abs(math.sin(screws * half) / turned) if abs(turned) > 1e-9 else float(screws)
        return self.count + together / self.sharing

    @property
    def tip_area(self) -> float:
        """Area of one tip [m^2]."""
        return math.pi * self.tip_diameter**2 / 4

    def slip_torque(self, preload: Quantity | None = None) -> Quantity:
        """Return the torque of full slip, mu F r n [N m]."""
        force = self.contact_count * self._preload_or_own(preload)
        return self.friction_coefficient * force * self.shaft_radius

    def _face_stiffness(self, preload: Quantity) -> Quantity:
        """Return the torsional stiffness of the rough faces at zero shear [N m/rad]."""
        per_area = self.surface.shear_ratio * self.law.stiffness(preload / self.tip_area)
        return self.contact_count * self.shaft_radius**2 * per_area * self.tip_area

    @property
    def _half_space_compliance(self) -> float:
        if not self.half_space:
            return 0.0
        one = 8 * self.surface.contact_shear_modulus * self.tip_diameter / 2
        return 1 / (self.contact_count * self.shaft_radius**2 * one)

    def loading_windup(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Return the wind-up of faces and half spaces [rad]."""
        slip = self.slip_torque(preload)
        travel = shear_travel(self.law, preload / self.tip_area, torque / slip, self.shear)
        return slip / self._face_stiffness(preload) * travel + self._half_space_compliance * torque

    def loading_compliance(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Return the compliance of faces and half spaces [rad/(N m)]."""
        ratio = torque / self.slip_torque(preload)
        softening = shear_softening(self.law, preload / self.tip_area, ratio, self.shear)
        return softening / self._face_stiffness(preload) + self._half_space_compliance
