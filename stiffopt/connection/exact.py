"""Compliance of connections before any smoothing or fitting, NumPy only.

Every formula is written out here from the geometry, on purpose: what an optimiser computes through
`windup` is judged by this module, so the two share nothing but the numbers of the connection.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from stiffopt.contact.fractal import FractalLaw
from stiffopt.contact.surface import SurfacePair


@lru_cache(maxsize=128)
def _law(surface: SurfacePair) -> FractalLaw:
    return FractalLaw(surface)


@lru_cache(maxsize=4096)
def _stiffness_at(surface: SurfacePair, pressure: float) -> float:
    """k_n of one pressure; a clamped face asks for it again at every torque."""
    return float(_law(surface).normal_stiffness_per_area(np.array(pressure)))


def _invert(stiffness: np.ndarray) -> np.ndarray:
    """1/stiffness, infinite where the stiffness is zero."""
    some = stiffness > 0.0
    return np.where(some, 1.0 / np.where(some, stiffness, 1.0), np.inf)


def key_compliance(
    torque: np.ndarray,
    surface: SurfacePair,
    radii: tuple[float, float],
    areas: tuple[float, float],
    prepressure: float,
    *,
    series: bool,
) -> np.ndarray:
    """Two flanks at radii [m] with areas [m^2] under |T|/(r A) + prepressure [Pa]."""
    load = np.abs(np.asarray(torque, dtype=float))
    flanks = [
        _law(surface).normal_stiffness_per_area(load / (radius * area) + prepressure)
        * (area * radius * radius)
        for radius, area in zip(radii, areas, strict=True)
    ]
    if series:
        return np.asarray(_invert(flanks[0]) + _invert(flanks[1]))
    return _invert(flanks[0] + flanks[1])


def sheared_stiffness_per_area(
    surface: SurfacePair, pressure: float, load_ratio: np.ndarray, *, mindlin: bool
) -> np.ndarray:
    """k_t(p, t) [N/m^3] for shear loads t >= 0 over the slip load; 0 from slip on."""
    rest = np.clip(1.0 - np.asarray(load_ratio, dtype=float), 0.0, 1.0)
    law = _law(surface)
    ratio = 4.0 * surface.contact_shear_modulus / surface.contact_modulus
    if mindlin:
        return np.asarray(ratio * _stiffness_at(surface, float(pressure)) * np.cbrt(rest))
    return np.asarray(ratio * law.normal_stiffness_per_area(pressure * rest))


def annulus_compliance(
    torque: np.ndarray,
    surface: SurfacePair,
    inner: float,
    outer: float,
    normal_force: float,
    friction: float,
    *,
    mindlin: bool,
    sectors: int = 1,
) -> np.ndarray:
    """Ring face between two radii [m] under a normal force [N], twisted by a torque.

    With `sectors` above 1, one of that many equal sectors of the ring.
    """
    angle = 2.0 * np.pi / sectors
    pressure = normal_force / (angle / 2.0 * (outer**2 - inner**2))
    slip = friction * pressure * angle / 3.0 * (outer**3 - inner**3)
    ratio = np.abs(np.asarray(torque, dtype=float)) / slip
    second_moment = angle / 4.0 * (outer**4 - inner**4)
    return _invert(
        sheared_stiffness_per_area(surface, pressure, ratio, mindlin=mindlin) * second_moment
    )


def pin_compliance(
    torque: np.ndarray,
    surface: SurfacePair,
    contacts: int,
    shaft_radius: float,
    tip_diameter: float,
    force: float,
    friction: float,
    *,
    mindlin: bool,
    half_space: bool,
) -> np.ndarray:
    """Pin tips on a shaft: rough face and, behind it, the half space under a small patch."""
    area = 0.25 * np.pi * tip_diameter**2
    ratio = np.abs(np.asarray(torque, dtype=float)) / (friction * force * shaft_radius * contacts)
    one = _invert(sheared_stiffness_per_area(surface, force / area, ratio, mindlin=mindlin) * area)
    if half_space:
        one = one + 1.0 / (4.0 * surface.contact_shear_modulus * tip_diameter)
    return np.asarray(one / (contacts * shaft_radius**2))


def gear_compliance(
    torque: np.ndarray,
    surface: SurfacePair,
    radii: tuple[float, float],
    width: float,
    pressure_angle: float,
    contact_ratio: float,
    tooth_stiffness: float,
) -> np.ndarray:
    """Rough Hertz strips of the tooth pairs in mesh and tooth bending, on the first shaft."""
    sine, cosine = np.sin(pressure_angle), np.cos(pressure_angle)
    base, arm = radii[0] * cosine, radii[0] * sine
    curvature = radii[0] * radii[1] * sine / (radii[0] + radii[1])
    force = np.abs(np.asarray(torque, dtype=float)) / (base * contact_ratio)
    strip = 2.0 * np.sqrt(4.0 * force / width * curvature / (np.pi * surface.contact_modulus))
    area = strip * width
    some = area > 0.0
    pressure = np.where(some, force / np.where(some, area, 1.0), 0.0)
    normal = _law(surface).normal_stiffness_per_area(pressure) * area
    ratio = 4.0 * surface.contact_shear_modulus / surface.contact_modulus
    mesh = contact_ratio * normal * (base**2 + ratio * arm**2)
    return np.asarray(_invert(mesh) + 1.0 / (tooth_stiffness * width * base**2))
