"""Axial compliance of bolts, of the parts they clamp and of set screws [m/N].

Together with the settling of the faces it tells how much preload is lost after assembly.
"""

from __future__ import annotations

import math
from typing import Literal

from stiffopt.drivetrain.catalogue import BoltData

# VDI 2230: lengths, in bolt diameters, that stand for the parts of a bolt beyond the clamp length:
# its head, its engaged thread, the thread around it in a tapped hole or in a nut.
HEAD_LENGTH_RATIO = {"socket": 0.4, "hexagon": 0.5}
ENGAGED_LENGTH_RATIO = 0.5
TAPPED_LENGTH_RATIO, NUT_LENGTH_RATIO = 0.33, 0.4


def bolt_compliance(
    bolt: BoltData,
    clamp_length: float,
    bolt_modulus: float,
    thread_modulus: float,
    *,
    head: Literal["socket", "hexagon"] = "socket",
    nut: bool = False,
) -> float:
    """delta_S of a bolt: head, shank, free thread, engaged thread, nut or tapped thread [m/N].

    Parameters
    ----------
    bolt : BoltData
        With its shank, where it has one; else threaded over the whole clamp length.
    clamp_length : float
        l_K [m].
    bolt_modulus, thread_modulus : float
        Of the bolt, and of the nut or the part with the tapped hole [Pa].
    head : {"socket", "hexagon"}
    nut : bool
        A nut in place of a tapped hole.

    References
    ----------
    [VDI2230]_, resilience of the bolt.
    """
    d = bolt.diameter
    rod = sum(
        length / (math.pi / 4 * diameter**2) for length, diameter in bolt.sections(clamp_length)
    )
    within = (
        HEAD_LENGTH_RATIO[head] * d / bolt.nominal_area + ENGAGED_LENGTH_RATIO * d / bolt.minor_area
    )
    around = (NUT_LENGTH_RATIO if nut else TAPPED_LENGTH_RATIO) * d / bolt.nominal_area
    return (rod + within) / bolt_modulus + around / thread_modulus


def cone_compliance(
    bearing: float, hole: float, outer: float, length: float, slope: float, modulus: float
) -> float:
    """Compliance of one cone of pressure, from a head or nut on, and the sleeve beyond it [m/N].

    Parameters
    ----------
    bearing, hole, outer : float
        d_w, d_h and D_A, the edge of the part, where the cone ends [m].
    length : float
        Of the cone with its sleeve [m].
    slope : float
        tan phi.
    modulus : float
        Young's modulus of the part [Pa].
    """
    edge = min(outer, bearing + 2.0 * length * slope)
    spread = (bearing + hole) * (edge - hole) / ((bearing - hole) * (edge + hole))
    cone = math.log(spread) / (hole * slope)
    sleeve = 4 / (edge**2 - hole**2) * (length - (edge - bearing) / (2.0 * slope))
    return (cone + sleeve) / (math.pi * modulus)


def clamped_compliance(
    bolt: BoltData, clamp_length: float, outer_diameter: float, modulus: float
) -> float:
    """delta_P of the parts that a bolt in a tapped hole clamps [m/N].

    One cone of pressure spreads from the head towards the thread; where it meets the edge of the
    part it goes on as a sleeve.

    Parameters
    ----------
    bolt : BoltData
    clamp_length : float
        l_K [m].
    outer_diameter : float
        D_A, of the material that belongs to one bolt [m]; what is smaller than the head counts as
        a sleeve of the head's diameter.
    modulus : float
        Young's modulus of the clamped part [Pa].

    References
    ----------
    [VDI2230]_, resilience of the clamped parts, one cone (w = 2) for a tapped hole.
    """
    head, outer = bolt.bearing_diameter, max(outer_diameter, bolt.bearing_diameter)
    slope = 0.348 + 0.013 * math.log(clamp_length / head) + 0.193 * math.log(outer / head)
    return cone_compliance(head, bolt.hole, outer, clamp_length, slope, modulus)


def through_bolted_compliance(
    bolt: BoltData,
    nut_bearing: float,
    clamp_length: float,
    outer_diameter: float,
    moduli: tuple[float, float],
) -> float:
    """delta_P of the parts between head and nut [m/N]: two cones that meet half way.

    Parameters
    ----------
    bolt : BoltData
    nut_bearing : float
        d_w of the nut [m]; each cone has the slope of its own face.
    clamp_length : float
        l_K [m].
    outer_diameter : float
        D_A, as for `clamped_compliance` [m].
    moduli : (float, float)
        Young's moduli of the half under the head and of that under the nut [Pa].

    References
    ----------
    [VDI2230]_, resilience of the clamped parts, two cones (w = 1) of a through-bolted joint.
    """
    found = 0.0
    for bearing, modulus in zip((bolt.bearing_diameter, nut_bearing), moduli, strict=True):
        outer = max(outer_diameter, bearing)
        slope = 0.362 + 0.032 * math.log(clamp_length / bearing / 2.0)
        slope += 0.153 * math.log(outer / bearing)
        found += cone_compliance(bearing, bolt.hole, outer, clamp_length / 2.0, slope, modulus)
    return found


def tip_compliance(contact_modulus: float, tip_diameter: float) -> float:
    """Flat tip pressed on a half space, 1/(2 E* a) with the radius a [m/N].

    Parameters
    ----------
    contact_modulus : float
        E* [Pa].
    tip_diameter : float
        [m]
    """
    return 1 / (contact_modulus * tip_diameter)
