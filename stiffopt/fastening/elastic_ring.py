"""Elastic flange: distribution of axial force and tilting moment to its bolts under ribs.

A rigid flange distributes them by geometry alone (`flange_load`). A thin ring loads the bolts near
the ribs of its link more; force and moment equilibrium hold in both cases.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.drivetrain import catalogue
from stiffopt.fastening import bolts
from stiffopt.fastening.flange_load import bolt_angles

_POISSON_RATIO = 0.3
# First circumferential wave number left out: the compliance falls with its fourth power.
_WAVE_NUMBER_END = 120
# The angle between ribs and bolts is unknown: number of angles tried over half a period.
_RIB_ANGLE_COUNT = 9


@dataclass(frozen=True)
class ElasticRing:
    """Elastic ring on its bolts, loaded through its ribs by a rigid link."""

    # Number of bolts and ribs, each evenly spaced on one circle.
    count: int
    supports: int
    radius: float  # radius of that circle [m]
    # E I of the ring out of its plane, and G J [N m^2].
    bending: float
    torsion: float
    spring: float  # axial stiffness of the ring at one bolt [N/m]

    def shares(self, rib_angle: float) -> np.ndarray:
        """Return the bolt forces for F_z = 1, M_x = 1, M_y = 1 (n, 3), first rib at an angle.

        Unknowns: forces of bolts and ribs, rigid-body motions of ring and link. Equations: ring
        deflection is rigid motion plus bending by all forces and equals spring elongation at the
        bolts and link motion at the ribs; equilibrium of ring and link.
        """
        bolted = bolt_angles(self.count)
        ribbed = rib_angle + bolt_angles(self.supports)
        n, s = self.count, self.supports
        at_bolts, at_ribs = _rigid_body_modes(bolted), _rigid_body_modes(ribbed)
        matrix = np.zeros((n + s + 6, n + s + 6))
        # Bolts: w - F/k = 0 with w = B q + G_br r - G_bb F.
        matrix[:n, :n] = -self._elastic_compliance(bolted, bolted) - np.eye(n) / self.spring
        matrix[:n, n : n + s] = self._elastic_compliance(bolted, ribbed)
        matrix[:n, n + s : n + s + 3] = at_bolts
        # Ribs: w = R p, motion of the link.
        matrix[n : n + s, :n] = -self._elastic_compliance(ribbed, bolted)
        matrix[n : n + s, n : n + s] = self._elastic_compliance(ribbed, ribbed)
        matrix[n : n + s, n + s : n + s + 3] = at_ribs
        matrix[n : n + s, n + s + 3 :] = -at_ribs
        # Equilibrium of the ring, and of the link under its load.
        matrix[n + s : n + s + 3, :n] = at_bolts.T
        matrix[n + s + 3 :, n : n + s] = at_ribs.T
        matrix[n + s : n + s + 3, n : n + s] = -at_ribs.T
        load = np.zeros((n + s + 6, 3))
        # M_x pulls where sin is largest, M_y where cos is least.
        load[n + s + 3, 0] = 1.0
        load[n + s + 5, 1] = 1.0 / self.radius
        load[n + s + 4, 2] = -1.0 / self.radius
        return np.asarray(np.linalg.solve(matrix, load)[:n])

    def _elastic_compliance(self, at: np.ndarray, of: np.ndarray) -> np.ndarray:
        """Return the elastic deflection at angles `at` for unit forces at angles `of` [m/N].

        A wave w = W cos(m t) has the energy 1/2 S_m W^2 with
        S_m = pi/R^3 m^2 (m^2 - 1)^2 EI GJ/(EI + GJ m^2), with the twist of least energy.
        """
        m = np.arange(2, _WAVE_NUMBER_END)
        stiffness = math.pi / self.radius**3 * m**2 * (m**2 - 1.0) ** 2
        stiffness = stiffness * self.bending * self.torsion / (self.bending + self.torsion * m**2)
        return np.asarray(np.cos((at[:, None] - of)[..., None] * m) @ (1.0 / stiffness))

    @cached_property
    def rib_angles(self) -> np.ndarray:
        """Sampled angles of the first rib [rad]."""
        return (
            math.pi / math.lcm(self.count, self.supports) * np.linspace(0.0, 1.0, _RIB_ANGLE_COUNT)
        )

    @cached_property
    def factors(self) -> tuple[float, float]:
        """Largest bolt force over that of a rigid flange, for axial force and tilting [-]."""
        found = np.array([self.shares(rib_angle) for rib_angle in self.rib_angles])
        axial = float(np.abs(found[..., 0]).max()) * self.count
        tilting = float(np.hypot(found[..., 1], found[..., 2]).max())
        return max(axial, 1.0), max(tilting * self.count * self.radius / 2, 1.0)

    def bolt_forces(self, load: np.ndarray) -> np.ndarray:
        """Return F_A of each bolt (n,) [N] under a load (6,) at the least favourable rib angle."""
        every = [self.shares(rib_angle) @ load[2:5] for rib_angle in self.rib_angles]
        return max(every, key=lambda forces: float(forces.max()))


def elastic_ring(flange: BoltedFlange) -> ElasticRing | None:
    """Return the elastic ring of a flange with given thickness and ribs; None: rigid.

    Clamped parts and bolt are parallel springs; the full width bends. Fewer than three bolts are
    statically determinate.
    """
    count = flange.bolt_count * flange.sectors
    if flange.ring is None or count < 3:
        return None
    bolt = bolts.flange_bolt(flange)
    modulus = catalogue.clamped_material(bolt.head_material).modulus
    width, height = flange.outer_radius - flange.inner_radius, flange.ring.thickness
    return _cached_ring(
        count,
        flange.ring.supports,
        flange.circle_diameter / 2,
        modulus * width * height**3 / 12,
        modulus / (2 * (1 + _POISSON_RATIO)) * torsion_constant(width, height),
        sum(1.0 / compliance for compliance in bolts.joint_compliances(flange)),
    )


@lru_cache(maxsize=256)
def _cached_ring(
    count: int, supports: int, radius: float, bending: float, torsion: float, spring: float
) -> ElasticRing:
    """Return one object for equal parameters, so that its factors are computed once."""
    return ElasticRing(count, supports, radius, bending, torsion, spring)


def torsion_constant(width: float, height: float) -> float:
    """Return J = a b^3 (1/3 - 0.21 b/a (1 - (b/a)^4/12)) of a rectangle, b <= a [m^4]."""
    long, short = max(width, height), min(width, height)
    ratio = short / long
    return long * short**3 * (1 / 3 - 0.21 * ratio * (1 - ratio**4 / 12))


def _rigid_body_modes(angles: np.ndarray) -> np.ndarray:
    """Return the axial displacement at angles for unit translation and tilts (k, 3)."""
    return np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=-1)
