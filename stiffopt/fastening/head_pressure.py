"""R10: pressure under the head of a bolt, with a washer or without."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stiffopt.connection import Bolt
from stiffopt.drivetrain import catalogue

# A load spreads in a washer under 39 degrees: d_Wa = d_w + 1.6 h_S (VDI 2230 R10).
_SPREAD = 1.6


@dataclass(frozen=True)
class HeadBearing:
    """Force that the parts under a head bear [N], and where that comes from.

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
    """Largest force under a head, p_G A_p (R10/1 and R10/2)."""
    data, part = catalogue.bolt(bolt.size), catalogue.clamped_material(bolt.head_material)
    if not bolt.washer:
        return HeadBearing(
            capacity=part.head_pressure * data.head_area,
            provenance=part.provenance,
            source=f"permissible pressure on {part.name}, {part.source}; head by {data.source}",
        )
    washer = catalogue.washer(bolt.size)
    outer = min(washer.diameter, data.bearing_diameter + _SPREAD * washer.thickness)
    below = part.head_pressure * math.pi / 4 * (outer**2 - data.hole**2)
    above = washer.pressure * data.head_area
    if above < below:
        return HeadBearing(above, washer.provenance, f"head on its washer, {washer.source}")
    return HeadBearing(
        below,
        part.provenance,
        f"permissible pressure on {part.name} under a washer, {part.source}; {washer.source}",
    )
