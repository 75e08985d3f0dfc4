"""Tilting stiffness of a bolted flange: bolts on their circle, interface without tension."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from stiffopt.connection import BoltedFlange
from stiffopt.contact.fractal import FractalLaw
from stiffopt.fastening import bolts
from stiffopt.fastening.flange_load import ring_section
from stiffopt.symbolic import Quantity

# Springs around the circle that discretise the opening interface.
_SPRING_COUNT = 180


@dataclass(frozen=True)
class TiltingFlange:
    """Tilting of a flange at one preload under a moment.

    Clamped parts and rough interface in series are springs without tension, evenly spread over a
    circle with the ring's second moment of area; the bolts are springs of n/delta_S.
    """

    # Axial stiffness of all bolts, and of all clamped parts with the interface [N/m].
    bolts: float
    face: float
    radius: float  # of the circle of springs, radius of gyration times sqrt(2) [m]
    # Radius of the bolt circle, outer radius of the ring [m].
    bolt_radius: float
    rim: float
    clamp: float  # clamp force of all bolts together [N]

    @property
    def closed_stiffness(self) -> float:
        """Stiffness of the fully closed interface [N m/rad]."""
        return (self.face * self.radius**2 + self.bolts * self.bolt_radius**2) / 2

    @property
    def open_stiffness(self) -> float:
        """Stiffness of the bolts alone [N m/rad]."""
        return self.bolts * self.bolt_radius**2 / 2

    @property
    def opening_moment(self) -> float:
        """Moment at which the rim of the interface begins to open [N m]."""
        return self.clamp / (self.face * self.rim) * self.closed_stiffness

    @property
    def lift_off_moment(self) -> float:
        """Moment at which springs begin to lift off and the flange softens [N m]."""
        return self.clamp / (self.face * self.radius) * self.closed_stiffness

    def secant_compliance(self, moment: float) -> float:
        """Return angle over moment [rad/(N m)]; at zero moment the compliance when closed."""
        if abs(moment) <= self.lift_off_moment:
            return 1.0 / self.closed_stiffness
        return self.rotation(moment) / moment

    def rotation(self, moment: float) -> float:
        """Return the tilting angle under a moment [rad]; linear until lift-off."""
        if abs(moment) <= self.lift_off_moment:
            return moment / self.closed_stiffness
        most = abs(moment) / self.open_stiffness
        least = abs(moment) / self.closed_stiffness
        found = brentq(
            lambda angle: self._restoring_moment(angle) - abs(moment), least, most, rtol=1e-12
        )
        return math.copysign(float(found), moment)

    def _restoring_moment(self, angle: float) -> float:
        """Return the moment of the springs at an angle in axial equilibrium [N m]."""
        cosine = np.cos(2 * np.pi * (np.arange(_SPRING_COUNT) + 0.5) / _SPRING_COUNT)
        pressed = self.clamp / self.face
        reach = angle * self.radius

        def forces(lift: float) -> np.ndarray:
            # Remaining compression of the interface; the bolts lengthen by the lift.
            return self.face / _SPRING_COUNT * np.maximum(pressed - lift - reach * cosine, 0.0)

        def surplus(lift: float) -> float:
            return float(self.clamp + self.bolts * lift - forces(lift).sum())

        lift = float(brentq(surplus, -pressed - reach, pressed + reach, xtol=1e-18, rtol=1e-13))
        face = -self.radius * float(forces(lift) @ cosine)
        return face + self.open_stiffness * angle


def closed_compliance(flange: BoltedFlange, preload: Quantity) -> Quantity:
    """Return the tilting compliance when closed, by the smooth contact law [rad/(N m)]."""
    bolt, plates = bolts.joint_compliances(flange)
    count = flange.bolt_count * flange.sectors
    area, moment = ring_section(flange.inner_radius, flange.outer_radius, count, 1.0, 0.0)
    rough = flange.law.stiffness(count * preload / area) * area
    face = 1.0 / (plates / count + 1.0 / rough)
    return 2.0 / (face * (2 * moment / area) + count / bolt * (flange.circle_diameter / 2) ** 2)


def tilting_flange(flange: BoltedFlange, preload: float) -> TiltingFlange:
    """Return the flange at a preload of each bolt in service [N].

    The rough interface has the stiffness of the exact contact law at its mean pressure.
    """
    bolt, plates = bolts.joint_compliances(flange)
    count = flange.bolt_count * flange.sectors
    area, moment = ring_section(flange.inner_radius, flange.outer_radius, count, 1.0, 0.0)
    rough = float(
        FractalLaw(flange.surface).normal_stiffness_per_area(np.array(count * preload / area))
    )
    return TiltingFlange(
        bolts=count / bolt,
        face=1.0 / (plates / count + 1.0 / (rough * area)),
        radius=math.sqrt(2 * moment / area),
        bolt_radius=flange.circle_diameter / 2,
        rim=flange.outer_radius,
        clamp=count * preload,
    )
