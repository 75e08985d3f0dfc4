"""Compliance of one connection before any smoothing or fitting, by its kind; NumPy only.

Every formula is written out here from the numbers of the connection, on purpose: this module judges
the wind-up that the optimiser computes, so the two share no formula.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from stiffopt.contact.fractal import FractalLaw
from stiffopt.contact.surface import SurfacePair

# A connection of any kind: only its numbers are read.
Element = Any
# Of floats, arrays, SX or MX.
Slopes = tuple[Any, Any, Any]
Corners = tuple[Any, Any]


def tangent_compliance(
    element: Element, torque: np.ndarray, preload: float | None = None
) -> np.ndarray:
    """Return the compliance of the unsmoothed law, d phi/dT [rad/(N m)], shape as `torque`.

    `element`: of a kind known here, or a subclass with a method `exact_tangent_compliance(torque,
    preload=...)`. `torque` [N m]: on the connection's own shaft. `preload` [N]: replaces the
    connection's own. Infinite where a contact carries no pressure or slips.
    """
    torque = np.asarray(torque, dtype=float)
    law = _COMPLIANCE_LAWS.get(getattr(element, "kind", ""))
    if law is None:
        return np.asarray(element.exact_tangent_compliance(torque, preload=preload))
    return np.asarray(law(element, np.abs(torque), _preload_force(element, preload)))


def breakpoints(element: Element) -> tuple[float, ...]:
    """Positive torques [N m] where the compliance jumps, ascending."""
    if getattr(element, "kind", "") == "reducer":
        return element.T1, element.T2
    own = getattr(element, "breakpoints", None)
    return () if own is None else tuple(own())


def slip_torque(element: Element, preload: float | None = None) -> float:
    """Torque [N m] from which on the whole contact slips; infinite where nothing can."""
    force = _preload_force(element, preload)
    if element.kind == "bolted_flange":
        return _ring_compliance(element, force)[1]
    if element.kind == "clamping_pins":
        return _pin_compliance(element, force)[1]
    return math.inf


def _preload_force(element: Element, preload: float | None) -> float | None:
    return getattr(element, "preload", None) if preload is None else preload


# ---- rough faces


@lru_cache(maxsize=128)
def _fractal_law(surface: SurfacePair) -> FractalLaw:
    return FractalLaw(surface)


@lru_cache(maxsize=4096)
def _cached_normal_stiffness(surface: SurfacePair, pressure: float) -> float:
    """Return k_n at one pressure, cached: a clamped face evaluates it at every torque."""
    return float(_fractal_law(surface).normal_stiffness_per_area(np.array(pressure)))


def _invert_stiffness(stiffness: np.ndarray) -> np.ndarray:
    """Return 1/stiffness, infinite where the stiffness is zero."""
    some = stiffness > 0.0
    return np.where(some, 1.0 / np.where(some, stiffness, 1.0), np.inf)


def _shear_ratio(surface: SurfacePair) -> float:
    """Tangential over normal stiffness without slip [-]."""
    return 4.0 * surface.contact_shear_modulus / surface.contact_modulus


def _shear_compliance(
    surface: SurfacePair, pressure: float, load_ratio: np.ndarray, shear: str
) -> np.ndarray:
    """Return k_t(p, t) [N/m^3] for shear load ratios t >= 0; 0 beyond slip, t = 1."""
    rest = np.clip(1.0 - load_ratio, 0.0, 1.0)
    if shear == "mindlin":
        normal = _cached_normal_stiffness(surface, float(pressure)) * np.cbrt(rest)
    else:
        normal = _fractal_law(surface).normal_stiffness_per_area(pressure * rest)
    return np.asarray(_shear_ratio(surface) * normal)


def _friction_coefficient(element: Element) -> float:
    return float(element.surface.friction if element.friction is None else element.friction)


# ---- one law a kind: (element, |torque|, preload) -> compliance


def _key_compliance(element: Element, load: np.ndarray, _: float | None) -> np.ndarray:
    """Two flanks under |T|/(r A) + prepressure, one after the other or side by side."""
    d, surface = element.shaft_diameter, element.surface
    flanks = []
    for radius, height in (
        ((d - element.shaft_flank_height) / 2.0, element.shaft_flank_height),
        ((d + element.hub_flank_height) / 2.0, element.hub_flank_height),
    ):
        area = element.length * height
        pressure = load / (radius * area) + element.prepressure
        normal = _fractal_law(surface).normal_stiffness_per_area(pressure)
        flanks.append(normal * (area * radius * radius))
    if element.flanks == "series":
        return np.asarray(_invert_stiffness(flanks[0]) + _invert_stiffness(flanks[1]))
    return _invert_stiffness(flanks[0] + flanks[1])


def _ring_compliance(element: Element, force: float | None) -> tuple[float, float]:
    """Pressure [Pa] and slip torque [N m] of a ring face, or of one of its equal sectors."""
    assert force is not None
    inner, outer, angle = element.inner_radius, element.outer_radius, 2.0 * np.pi / element.sectors
    pressure = element.bolt_count * force / (angle / 2.0 * (outer**2 - inner**2))
    return pressure, _friction_coefficient(element) * pressure * angle / 3.0 * (outer**3 - inner**3)


def _bolted_flange(element: Element, load: np.ndarray, force: float | None) -> np.ndarray:
    """Ring face under the normal force of its bolts, twisted by a torque."""
    pressure, slip = _ring_compliance(element, force)
    angle = 2.0 * np.pi / element.sectors
    second_moment = angle / 4.0 * (element.outer_radius**4 - element.inner_radius**4)
    return _invert_stiffness(
        _shear_compliance(element.surface, pressure, load / slip, element.shear) * second_moment
    )


def _pin_compliance(element: Element, force: float | None) -> tuple[float, float]:
    """Pressed contacts in units of one tip's force, and torque at which they slip [N m]."""
    assert force is not None
    contacts = float(element.count)
    if element.both_sides:
        directions = np.exp(1j * element.spacing * np.arange(element.count * element.sharing))
        contacts += float(np.abs(directions.sum())) / element.sharing
    return contacts, _friction_coefficient(
        element
    ) * force * element.shaft_diameter / 2.0 * contacts


def _clamping_pins(element: Element, load: np.ndarray, force: float | None) -> np.ndarray:
    """Pin tips on a shaft: rough face and, behind it, the half space under a small patch."""
    assert force is not None
    contacts, slip = _pin_compliance(element, force)
    surface, area = element.surface, 0.25 * np.pi * element.tip_diameter**2
    one = _invert_stiffness(
        _shear_compliance(surface, force / area, load / slip, element.shear) * area
    )
    if element.half_space:
        one = one + 1.0 / (4.0 * surface.contact_shear_modulus * element.tip_diameter)
    return np.asarray(4.0 * one / (contacts * element.shaft_diameter**2))


def _gear_pair(element: Element, load: np.ndarray, _: float | None) -> np.ndarray:
    """Rough Hertz strips of the tooth pairs in mesh and tooth bending, on the first shaft."""
    surface, width, pairs = element.surface, element.face_width, element.contact_ratio
    first = element.module * element.teeth / 2.0
    second = element.module * element.teeth_driven / 2.0
    sine, cosine = np.sin(element.pressure_angle), np.cos(element.pressure_angle)
    base, arm = first * cosine, first * sine
    curvature = first * second * sine / (first + second)
    modulus = np.pi * surface.contact_modulus
    force = load / (base * pairs) + 16.0 * curvature * width / modulus * element.prepressure**2
    strip = 2.0 * np.sqrt(4.0 * force / width * curvature / modulus)
    area = strip * width
    some = area > 0.0
    pressure = np.where(some, force / np.where(some, area, 1.0), 0.0)
    normal = _fractal_law(surface).normal_stiffness_per_area(pressure) * area
    mesh = pairs * normal * (base**2 + _shear_ratio(surface) * arm**2)
    return np.asarray(_invert_stiffness(mesh) + 1.0 / (element.mesh_stiffness * width * base**2))


def _reducer_compliance(element: Element, load: np.ndarray, _: float | None) -> np.ndarray:
    slopes = (element.K1, element.K2, element.K3)
    return np.asarray(reducer_compliance(load, slopes, (element.T1, element.T2)))


def _shaft_compliance(element: Element, load: np.ndarray, _: float | None) -> np.ndarray:
    """Twist of a round bar, 32 L/(G pi (d^4 - d_i^4))."""
    polar = np.pi / 32.0 * (element.diameter**4 - element.bore**4)
    return np.full_like(load, element.length / (element.shear_modulus * polar))


def _timing_belt(element: Element, load: np.ndarray, _: float | None) -> np.ndarray:
    """Belt teeth on both pulleys and both taut spans, all at the radius of the first pulley."""
    radius = element.teeth * element.pitch / (2.0 * np.pi)
    shear_modulus = element.tooth_modulus / (2.0 + 2.0 * element.tooth_poisson)
    along = (
        element.tooth_modulus * np.cos(element.flank_angle) ** 2
        + shear_modulus * np.sin(element.flank_angle) ** 2
    )
    tooth = along * element.width * element.tooth_height / (0.5 * element.tooth_root_width)
    travel = 0.5 * element.span_length / element.span_stiffness
    for teeth, wrap in (
        (element.teeth, element.wrap),
        (element.teeth_driven, element.wrap_driven),
    ):
        carrying = min(teeth * wrap / (2.0 * np.pi), element.teeth_in_mesh_max)
        travel = travel + 1.0 / (carrying * tooth)
    return np.full_like(load, travel / radius**2)


def _constant_compliance(element: Element, load: np.ndarray, _: float | None) -> np.ndarray:
    return np.full_like(load, 1.0 / element.stiffness)


_COMPLIANCE_LAWS: dict[str, Callable[[Element, np.ndarray, float | None], np.ndarray]] = {
    "key": _key_compliance,
    "bolted_flange": _bolted_flange,
    "clamping_pins": _clamping_pins,
    "gear_pair": _gear_pair,
    "reducer": _reducer_compliance,
    "shaft": _shaft_compliance,
    "timing_belt": _timing_belt,
    "constant": _constant_compliance,
}


def reducer_windup(torque: Any, slopes: Slopes, corners: Corners) -> Any:
    """Wind-up [rad] with the slopes K1, K2, K3 [N m/rad] between the corners T1 <= T2 [N m].

    Odd and continuous in the torque [N m]; any shape, or a CasADi expression.
    """
    (k1, k2, k3), (t1, t2) = slopes, corners
    size = np.abs(torque)
    low = np.fmin(size, t1)
    middle = np.fmin(np.fmax(size - t1, 0.0), t2 - t1)
    high = np.fmax(size - t2, 0.0)
    return np.sign(torque) * (low / k1 + middle / k2 + high / k3)


def reducer_compliance(torque: Any, slopes: Slopes, corners: Corners) -> Any:
    """Slope of `reducer_windup` [rad/(N m)]; at a corner that of the torques beyond it."""
    (k1, k2, k3), (t1, t2) = slopes, corners
    size = np.abs(torque)
    return np.where(size < t1, 1.0 / k1, np.where(size < t2, 1.0 / k2, 1.0 / k3))
