"""Axial compliance of bolts, of the parts they clamp and of set screws [m/N].

Together with the settling of the faces it tells how much preload is lost after assembly.
"""

from __future__ import annotations

import math

from stiffopt.drivetrain.catalogue import BoltData

# VDI 2230: lengths, in bolt diameters, that stand for the parts of a bolt beyond the clamp length:
# socket head, engaged thread of the bolt, thread of a tapped hole.
_HEAD, _ENGAGED, _TAPPED = 0.4, 0.5, 0.33


def bolt_compliance(
    bolt: BoltData, clamp_length: float, bolt_modulus: float, thread_modulus: float
) -> float:
    """delta_S of a bolt in a tapped hole, threaded or waisted over the whole clamp length [m/N].

    Parameters
    ----------
    bolt : BoltData
    clamp_length : float
        l_K [m].
    bolt_modulus, thread_modulus : float
        Of the bolt and of the part with the thread [Pa].

    References
    ----------
    [VDI2230]_, resilience of the bolt.
    """
    d = bolt.diameter
    core = clamp_length / (bolt_modulus * bolt.core_area)
    core += _ENGAGED * d / (bolt_modulus * bolt.minor_area)
    head = _HEAD * d / (bolt_modulus * bolt.nominal_area)
    tapped = _TAPPED * d / (thread_modulus * bolt.nominal_area)
    return core + head + tapped


def clamped_compliance(
    bolt: BoltData, clamp_length: float, outer_diameter: float, modulus: float
) -> float:
    """delta_P of the parts that a bolt in a tapped hole clamps [m/N].

    A cone of pressure spreads from the head towards the thread; where it meets the edge of the
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
    w = 2.0
    head, hole = bolt.bearing_diameter, bolt.hole
    outer = max(outer_diameter, head)
    slope = 0.348 + 0.013 * math.log(clamp_length / head) + 0.193 * math.log(outer / head)
    edge = min(outer, head + w * clamp_length * slope)
    spread = (head + hole) * (edge - hole) / ((head - hole) * (edge + hole))
    cone = 2 / (w * hole * slope) * math.log(spread)
    sleeve = 4 / (edge**2 - hole**2) * (clamp_length - (edge - head) / (w * slope))
    return (cone + sleeve) / (math.pi * modulus)


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
