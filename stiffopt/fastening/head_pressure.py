"""R10: pressure under the head of a bolt and under its nut, with a washer or without."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stiffopt.connection import Bolt
from stiffopt.drivetrain import catalogue
from stiffopt.fastening.bolt_geometry import bolt_data

# A load spreads in a washer under 39 degrees: d_Wa = d_w + 1.6 h_S (VDI 2230 R10).
_WASHER_SPREAD_RATIO = 1.6


@dataclass(frozen=True)
class HeadBearing:
    """Force that the parts under a head or nut bear [N], and where that comes from.

    Parameters
    ----------
    capacity : float
        p_G A_p, the least of head on washer and washer on part [N].
    provenance, source : str
    """

    capacity: float
    provenance: str
    source: str


def head_bearing(bolt: Bolt) -> HeadBearing:
    """Largest force under head and nut, p_G A_p (R10/1 and R10/2)."""
    data = bolt_data(bolt)
    found = _bearing_capacity(bolt, bolt.head_material, data.bearing_diameter, "head")
    if bolt.nut:
        face = catalogue.hexagon(bolt.size).bearing_diameter
        nut = _bearing_capacity(bolt, bolt.thread_material, face, "nut")
        found = min(found, nut, key=lambda each: each.capacity)
    return found


def _bearing_capacity(bolt: Bolt, material: str, face: float, what: str) -> HeadBearing:
    """Force that a part bears under a face of diameter d_w [m]."""
    part, hole = catalogue.clamped_material(material), catalogue.bolt(bolt.size).hole
    area = math.pi / 4 * (face**2 - hole**2)
    if not bolt.washer:
        return HeadBearing(
            capacity=part.head_pressure * area,
            provenance=part.provenance,
            source=(
                f"permissible pressure on {part.name}, {part.source}; under the {what},"
                f" {1e3 * face:g} mm wide"
            ),
        )
    washer = catalogue.washer(bolt.size)
    outer = min(washer.diameter, face + _WASHER_SPREAD_RATIO * washer.thickness)
    below = part.head_pressure * math.pi / 4 * (outer**2 - hole**2)
    above = washer.pressure * area
    if above < below:
        return HeadBearing(above, washer.provenance, f"{what} on its washer, {washer.source}")
    return HeadBearing(
        below,
        part.provenance,
        f"permissible pressure on {part.name} under a washer, {part.source}; {washer.source}",
    )
