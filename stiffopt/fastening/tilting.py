"""How a bolted flange tilts: bolts on their circle, and a face that presses but does not pull."""

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

_SPRING_COUNT = 180


@dataclass(frozen=True)
class TiltingFlange:
    """A flange at one preload, tilted by a moment.

    The clamped parts are springs around the bolt circle, n/delta_P and the rough face one after the
    other, which bear pressure alone; the bolts are springs of n/delta_S. Both are spread evenly
    over the circle of the radius of gyration of the ring.

    Parameters
    ----------
    bolts, face : float
        Stiffness of all bolts and of all clamped parts with their face [N/m].
    radius : float
        Radius of gyration times sqrt(2): of a circle with the ring's moment of area [m].
    bolt_radius, rim : float
        Of the bolts, and outer radius of the ring [m].
    clamp : float
        Clamp force of all bolts together [N].
    """

    bolts: float
    face: float
    radius: float
    bolt_radius: float
    rim: float
    clamp: float

    @property
    def closed_stiffness(self) -> float:
        """Stiffness while the whole face presses [N m/rad]."""
        return (self.face * self.radius**2 + self.bolts * self.bolt_radius**2) / 2

    @property
    def open_stiffness(self) -> float:
        """Stiffness that the bolts alone would have [N m/rad]."""
        return self.bolts * self.bolt_radius**2 / 2

    @property
    def opening_moment(self) -> float:
        """Moment from which on the rim of the face opens [N m]."""
        return self.clamp / (self.face * self.rim) * self.closed_stiffness

    @property
    def lift_off_moment(self) -> float:
        """Moment from which on the circle of springs lifts off, and the flange is softer [N m]."""
        return self.clamp / (self.face * self.radius) * self.closed_stiffness

    def secant_compliance(self, moment: float) -> float:
        """Angle over moment [rad/(N m)], at zero moment the compliance of the closed face."""
        if abs(moment) <= self.lift_off_moment:
            return 1.0 / self.closed_stiffness
        return self.rotation(moment) / moment

    def rotation(self, moment: float) -> float:
        """Angle by which a moment tilts the flange [rad]; linear until it lifts off."""
        if abs(moment) <= self.lift_off_moment:
            return moment / self.closed_stiffness
        most = abs(moment) / self.open_stiffness
        least = abs(moment) / self.closed_stiffness
        found = brentq(
            lambda angle: self._restoring_moment(angle) - abs(moment), least, most, rtol=1e-12
        )
        return math.copysign(float(found), moment)

    def _restoring_moment(self, angle: float) -> float:
        """Moment of the springs at an angle, the axial balance kept."""
        cosine = np.cos(2 * np.pi * (np.arange(_SPRING_COUNT) + 0.5) / _SPRING_COUNT)
        pressed = self.clamp / self.face
        reach = angle * self.radius

        def forces(lift: float) -> np.ndarray:
            # Compression of the face where it is left; the bolts lengthen by as much.
            return self.face / _SPRING_COUNT * np.maximum(pressed - lift - reach * cosine, 0.0)

        def surplus(lift: float) -> float:
            return float(self.clamp + self.bolts * lift - forces(lift).sum())

        lift = float(brentq(surplus, -pressed - reach, pressed + reach, xtol=1e-18, rtol=1e-13))
        face = -self.radius * float(forces(lift) @ cosine)
        return face + self.open_stiffness * angle


def closed_compliance(flange: BoltedFlange, preload: Quantity) -> Quantity:
    """Tilting compliance of a closed face by the smooth contact law [rad/(N m)].

    Parameters
    ----------
    flange : BoltedFlange
    preload : scalar
        Of each bolt in service [N].
    """
    bolt, plates = bolts.joint_compliances(flange)
    count = flange.bolt_count * flange.sectors
    area, moment = ring_section(flange.inner_radius, flange.outer_radius, count, 1.0, 0.0)
    rough = flange.law.stiffness(count * preload / area) * area
    face = 1.0 / (plates / count + 1.0 / rough)
    return 2.0 / (face * (2 * moment / area) + count / bolt * (flange.circle_diameter / 2) ** 2)


def tilting_flange(flange: BoltedFlange, preload: float) -> TiltingFlange:
    """Flange with a preload of each bolt that is there in service [N].

    The rough face yields by the exact contact law at its mean pressure.
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
