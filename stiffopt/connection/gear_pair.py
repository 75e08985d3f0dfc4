"""Pair of spur gears: rough contact of the flanks and bending of the teeth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np

from stiffopt.connection.connection import ContactConnection
from stiffopt.contact.surface import LOWEST_PRESSURE, SurfacePair
from stiffopt.contact.surrogate import ContactLaw, LawName, contact_law
from stiffopt.declaration import (
    DETAIL,
    NOT_NEGATIVE,
    PART,
    POSITIVE,
    Angle,
    Bounds,
    Doc,
    Length,
    Pressure,
    Ratio,
    WidthStiffness,
)
from stiffopt.symbolic import Quantity

# Upper end of the fitted contact law [Pa]: Hertz pressure of hardened flanks.
_HIGHEST_PRESSURE = 2e9


@dataclass(frozen=True, kw_only=True)
class GearPair(ContactConnection):
    """Spur gears, referred to the shaft of the first one.

    Each of the `contact_ratio` tooth pairs in mesh carries an equal share of the normal force T/r_b
    on a Hertz strip of area A_H, beside the force that presses the flanks without torque; its rough
    surfaces give k_n(p) A_H [r_b^2 + kappa (r sin alpha)^2] with p the mean pressure on the strip.
    Tooth bending acts in series. Backlash is not included.
    """

    kind: ClassVar[str] = "gear_pair"
    module: Annotated[Length, DETAIL, Doc("Module: pitch diameter over number of teeth.")]
    teeth: Annotated[int, POSITIVE, Doc("Teeth of the first gear, on the motor's side.")]
    teeth_driven: Annotated[int, POSITIVE, Doc("Teeth of the second gear.")]
    face_width: Annotated[Length, PART, Doc("Width of the teeth in mesh.")]
    surface: Annotated[SurfacePair, Doc("Pair of surfaces of the flanks.")]
    prepressure: Annotated[
        Pressure,
        NOT_NEGATIVE,
        Doc(
            "Mean pressure p0 of the flanks without torque, as by the drag of what they drive. At "
            "0 the exact compliance is infinite at zero torque."
        ),
    ] = LOWEST_PRESSURE
    pressure_angle: Annotated[
        Angle, Bounds(above=0.0, below=math.pi / 4), Doc("Pressure angle alpha.")
    ] = math.pi / 9
    contact_ratio: Annotated[Ratio, Bounds(least=1.0), Doc("Tooth pairs in mesh on average.")] = 1.5
    mesh_stiffness: Annotated[
        WidthStiffness,
        POSITIVE,
        Doc("Tooth stiffness per face width; default about that of ISO 6336."),
    ] = 2e10
    contact_law: LawName | ContactLaw = "log_cubic"

    @property
    def pitch_radius(self) -> float:
        """Pitch radius of the first gear [m]."""
        return self.module * self.teeth / 2

    @property
    def pitch_radius_driven(self) -> float:
        """Pitch radius of the second gear [m]."""
        return self.module * self.teeth_driven / 2

    @cached_property
    def law(self) -> ContactLaw:
        """Smooth contact law of the flanks."""
        return contact_law(self.surface, self.contact_law, LOWEST_PRESSURE, _HIGHEST_PRESSURE)

    @property
    def base_radius(self) -> float:
        """Lever of the normal force on the first shaft [m]."""
        return self.pitch_radius * math.cos(self.pressure_angle)

    @property
    def flank_curvature_radius(self) -> float:
        """Relative radius of curvature of the flanks at the pitch point [m]."""
        first, second = self.pitch_radius, self.pitch_radius_driven
        return first * second * math.sin(self.pressure_angle) / (first + second)

    @property
    def _lever_square(self) -> float:
        sliding = self.pitch_radius * math.sin(self.pressure_angle)
        return self.base_radius**2 + self.surface.shear_ratio * sliding**2

    @property
    def _bending_compliance(self) -> float:
        return 1 / (self.mesh_stiffness * self.face_width * self.base_radius**2)

    def pressure(self, torque: Quantity) -> Quantity:
        """Return the mean pressure on the strip of one tooth pair [Pa]."""
        force = np.absolute(torque) / (self.base_radius * self.contact_ratio)
        line, radius = force / self.face_width, self.flank_curvature_radius
        # The square of the pressure is proportional to the force.
        return np.sqrt(
            mean_pressure(line, radius, self.surface.contact_modulus) ** 2 + self.prepressure**2
        )

    def loading_windup(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Return the wind-up of flanks and teeth [rad]."""
        # p grows with the root of the force and so does the strip: dT/(k_n A_H) = 2 dT/dF dp/k_n.
        approach = self.law.approach(self.prepressure, self.pressure(torque))
        contact = 2 * self.base_radius / self._lever_square * approach
        return contact + self._bending_compliance * torque

    def loading_compliance(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Return the compliance of flanks and teeth [rad/(N m)]."""
        pressure = self.pressure(torque)
        area = self.face_width * strip_width(
            pressure, self.flank_curvature_radius, self.surface.contact_modulus
        )
        mesh = self.contact_ratio * self.law.stiffness(pressure) * area * self._lever_square
        return 1 / mesh + self._bending_compliance


def mean_pressure(
    force_per_length: Quantity, radius: Quantity, contact_modulus: Quantity
) -> Quantity:
    """Mean pressure of a smooth line contact [Pa], sqrt(pi E* F'/(16 R)).

    F' [N/m], relative radius of curvature R [m], E* [Pa]: Johnson, Contact Mechanics (1985), 4.2.
    """
    return np.sqrt(math.pi * contact_modulus * force_per_length / (16 * radius))


def strip_width(pressure: Quantity, radius: Quantity, contact_modulus: Quantity) -> Quantity:
    """Width of the strip of a smooth line contact with a mean pressure [m], 16 R p/(pi E*)."""
    return 16 * radius * pressure / (math.pi * contact_modulus)
