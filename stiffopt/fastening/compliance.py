"""Compliance [m/N], load factors and preload losses of bolted joints (VDI 2230 R3, R4)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from stiffopt.connection import BoltedFlange
from stiffopt.drivetrain.fasteners import BoltData
from stiffopt.errors import OutOfValidityError

# Substitute lengths in bolt diameters of the parts beyond the clamp length (VDI 2230 R3): head,
# engaged thread, tapped hole, nut.
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
    """Return delta_S of a bolt: head, shank, free and engaged thread, nut or tapped hole [m/N].

    Threaded over the whole clamp length l_K [m] unless the bolt has a shank; Young's moduli [Pa] of
    the bolt and of the nut or tapped part ([VDI2230]_).
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
    """Return the compliance of a deformation cone under a head or nut and of its sleeve [m/N].

    Diameters d_w, d_h and D_A (of the part that limits the cone) and `length` of both [m], `slope`
    tan phi, Young's modulus [Pa].
    """
    edge = min(outer, bearing + 2.0 * length * slope)
    spread = (bearing + hole) * (edge - hole) / ((bearing - hole) * (edge + hole))
    cone = math.log(spread) / (hole * slope)
    sleeve = 4 / (edge**2 - hole**2) * (length - (edge - bearing) / (2.0 * slope))
    return (cone + sleeve) / (math.pi * modulus)


def clamped_compliance(
    bolt: BoltData, clamp_length: float, outer_diameter: float, modulus: float
) -> float:
    """Return delta_P of the clamped parts of a bolt in a tapped hole [m/N] ([VDI2230]_, w = 2).

    One deformation cone from the head towards the thread; beyond the edge D_A of the part [m], at
    least the head's bearing diameter, a sleeve.
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
    """Return delta_P of the parts between head and nut, two cones that meet half way [m/N].

    Each cone has the slope of its own bearing face, d_w of the nut [m], and its own Young's modulus
    [Pa], that under the head first ([VDI2230]_, w = 1).
    """
    found = 0.0
    for bearing, modulus in zip((bolt.bearing_diameter, nut_bearing), moduli, strict=True):
        outer = max(outer_diameter, bearing)
        slope = 0.362 + 0.032 * math.log(clamp_length / bearing / 2.0)
        slope += 0.153 * math.log(outer / bearing)
        found += cone_compliance(bearing, bolt.hole, outer, clamp_length / 2.0, slope, modulus)
    return found


def tip_compliance(contact_modulus: float, tip_diameter: float) -> float:
    """Return 1/(2 E* a) of a flat tip of radius a on a half space [m/N]."""
    return 1 / (contact_modulus * tip_diameter)


@dataclass(frozen=True)
class LoadFactor:
    """Load factor Phi at both bounds of the load introduction factor n."""

    most: float  # Phi at the largest n; loads the bolt most
    least: float  # Phi at the smallest n; 1 - Phi unloads the clamped parts most


def load_factor(bolt: float, plates: float, introduction: float | None) -> LoadFactor:
    """Return Phi_n = n delta_P/(delta_S + delta_P) of a concentric joint (R3/1).

    The `introduction` n is None where unknown: then 1 for the bolt and 0 for the clamped parts.
    """
    whole = plates / (bolt + plates)
    if introduction is None:
        return LoadFactor(most=whole, least=0.0)
    return LoadFactor(most=introduction * whole, least=introduction * whole)


# Under shear, which settles more than axial loads (VDI 2230 Table 5): upper bound of Rz [m], then
# embedding [um] of the thread, of each head or nut, of each inner interface.
_EMBEDDING_BY_ROUGHNESS = (
    (10e-6, 3.0, 3.0, 2.0),
    (40e-6, 3.0, 4.5, 2.5),
    (160e-6, 3.0, 6.5, 3.5),
)


def embedding(roughness: float, interfaces: int, *, nut: bool = False) -> float:
    """Return the embedding f_Z of a bolt: thread, head, nut and inner interfaces [m] (Table 5).

    `roughness` is Rz [m] of the roughest face; inner interfaces include those at washers.
    """
    for bound, thread, head, inner in _EMBEDDING_BY_ROUGHNESS:
        if roughness < bound:
            bearing = 2 if nut else 1
            return 1e-6 * (thread + bearing * head + interfaces * inner)
    raise OutOfValidityError("roughness", roughness, 0.0, 160e-6, "Table 5 of VDI 2230 ends there.")


def flange_embedding(flange: BoltedFlange) -> float:
    """Return f_Z of a flange's bolts under torque, a shear load of the interface [m]."""
    bolt = flange.bolt
    nut = bolt is not None and bolt.nut
    washers = (2 if nut else 1) if bolt is not None and bolt.washer else 0
    return embedding(flange.roughness, flange.interfaces + washers, nut=nut)


def thermal_change(
    length: float, bolt_expansion: float, part_expansion: float, change: float, compliance: float
) -> float:
    """Return Delta F_Vth = l_K (alpha_S - alpha_P) Delta T/(delta_S + delta_P) [N] (R4/2).

    Positive values are preload lost; joint and bolt have the same temperature, and moduli are those
    at assembly, an error of 1 % for 30 K.
    """
    return length * (bolt_expansion - part_expansion) * change / compliance
