"""Strength of a bolt in service: yield, fatigue, surface pressure, stripping, self-loosening.

Steps R8 to R11 of VDI 2230, and Junker's criterion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from stiffopt.connection import Bolt
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.fasteners import BoltData, ClampedMaterial
from stiffopt.errors import InputError
from stiffopt.symbolic import Quantity

# Default clamp length in bolt diameters.
DEFAULT_CLAMP_LENGTH_RATIO = 2.0


def clamp_length(bolt: Bolt) -> float:
    """Clamp length l_K, given or default [m]."""
    if bolt.clamp_length is not None:
        return bolt.clamp_length
    return DEFAULT_CLAMP_LENGTH_RATIO * catalogue.bolt(bolt.size).diameter


def bolt_data(bolt: Bolt) -> BoltData:
    """Return the dimensions of a bolt with head and shank; a thin shank sets the stress area.

    Raises `InputError`: the shank is thicker than the bolt or longer than the clamp length, an
    engagement is given for a bolt with a nut, or a stainless thread is rolled after heat treatment.
    """
    data = catalogue.bolt(bolt.size)
    if bolt.head == "hexagon":
        face = catalogue.hexagon(bolt.size)
        data = replace(data, head_diameter=face.corners, bearing_diameter=face.bearing_diameter)
    if bolt.nut and bolt.engagement is not None:
        raise InputError(
            f"bolt {bolt.size}: engagement belongs to a tapped hole, and this bolt has a nut. "
            "Leave engagement out, or set `nut = false`."
        )
    if bolt.rolled == "after" and not catalogue.bolt_grade(bolt.grade).heat_treated:
        raise InputError(
            f'bolt {bolt.size} {bolt.grade}: rolled = "after" means after heat treatment, and '
            "stainless bolts have none. Leave rolled out."
        )
    if bolt.shank_diameter is None and not bolt.shank_length:
        return data
    diameter = data.diameter if bolt.shank_diameter is None else bolt.shank_diameter
    length = clamp_length(bolt) if bolt.shank_length is None else bolt.shank_length
    if diameter > data.diameter:
        raise InputError(
            f"bolt {bolt.size}: shank_diameter = {1e3 * diameter:g} mm must be at most that of the "
            f"bolt, {1e3 * data.diameter:g} mm. Give the diameter beside the thread, or leave it "
            "out."
        )
    if length > clamp_length(bolt) * (1 + 1e-9):
        raise InputError(
            f"bolt {bolt.size}: shank_length = {1e3 * length:g} mm must be at most clamp_length, "
            f"{1e3 * clamp_length(bolt):g} mm. Give the part of the shank between head and thread "
            "that lies within the clamp length."
        )
    return catalogue.shanked(data, diameter, length)


# k_tau [-]: share of the tightening torsion left in service (VDI 2230 R8; 1 if the joint slips).
RESIDUAL_TORSION_SHARE = 0.5


def thread_torque(bolt: BoltData, preload: Quantity, friction: float) -> Quantity:
    """Return the thread torque M_G = F_M d2/2 (P/(pi d2) + 1.155 mu_G) [N m] (R8/3)."""
    lever = bolt.pitch / (2 * math.pi) + bolt.pitch_diameter / 2 * friction / math.cos(math.pi / 6)
    return preload * lever


def torsion_stress(bolt: BoltData, preload: Quantity, friction: float) -> Quantity:
    """Return the torsional stress tau = M_G/W_P with W_P = pi/16 d_S^3 [Pa] (R8/3)."""
    return thread_torque(bolt, preload, friction) / (math.pi / 16 * bolt.stress_diameter**3)


def working_stress(
    bolt: BoltData, preload: Quantity, additional: Quantity, friction: float
) -> Quantity:
    """Return the working stress sigma_red,B = sqrt(sigma_z^2 + 3 (k_tau tau)^2) [Pa] (R8/4).

    For the largest assembly preload F_M [N], `additional` F_SA with the thermal force [N], and
    mu_G.
    """
    tension = (preload + additional) / bolt.stress_area
    twist = RESIDUAL_TORSION_SHARE * torsion_stress(bolt, preload, friction)
    return (tension**2 + 3 * twist**2) ** 0.5


def largest_working_preload(
    bolt: BoltData, proof_stress: float, additional: float, friction: float
) -> float:
    """Return the preload at a working stress of R_p0.2 [N]; 0 if the load alone exceeds it."""
    twist = 3 * (RESIDUAL_TORSION_SHARE * float(torsion_stress(bolt, 1.0, friction))) ** 2
    square = 1 / bolt.stress_area**2 + twist
    half = additional / bolt.stress_area**2
    rest = (additional / bolt.stress_area) ** 2 - proof_stress**2
    if rest >= 0.0:
        return 0.0
    return (-half + math.sqrt(half**2 - square * rest)) / square


# Required S_D against fatigue [-]; VDI 2230 leaves it to the engineer and names 1.2.
MIN_ENDURANCE_SAFETY = 1.2


def endurance_limit(
    bolt: BoltData,
    rolled: Literal["before", "after"],
    mean_force: Quantity = 0.0,
    proof_stress: float = 1.0,
) -> Quantity:
    """Return the endurance limit of a thread, stress amplitude at 2e6 cycles and more [Pa].

    Rolled before heat treatment sigma_ASV = 0.85 (150/d + 45) MPa with d in mm (R9/5); after it
    sigma_ASG = (2 - F_Sm/F_0.2) sigma_ASV (R9/6), here never below sigma_ASV and with the mean
    force F_Sm [N] clipped to its validity, 0.3 to 1 of F_0.2.
    """
    before = 0.85e6 * (150e-3 / bolt.diameter + 45)
    if rolled == "before":
        return before
    share = mean_force / (proof_stress * bolt.stress_area)
    share = min(max(float(share), 0.3), 1.0)
    return (2.0 - share) * before


def stress_amplitude(bolt: BoltData, upper: Quantity, lower: Quantity) -> Quantity:
    """Return sigma_a = (F_SAo - F_SAu)/(2 A_S) [Pa] (R9/1) from the bolt's share of the load."""
    return (upper - lower) / (2 * bolt.stress_area)


# Load spreads in a washer at 39 degrees: d_Wa = d_w + 1.6 h_S (VDI 2230 R10).
_WASHER_SPREAD_RATIO = 1.6


@dataclass(frozen=True)
class HeadBearing:
    """Permissible force on the bearing face of a head or nut, with its source."""

    capacity: float  # p_G A_p [N], the smaller of head on washer and washer on part
    provenance: str
    source: str


def head_bearing(bolt: Bolt) -> HeadBearing:
    """Return the permissible force under head and nut, p_G A_p (R10/1 and R10/2)."""
    data = bolt_data(bolt)
    found = _bearing_capacity(bolt, bolt.head_material, data.bearing_diameter, "head")
    if bolt.nut:
        face = catalogue.hexagon(bolt.size).bearing_diameter
        nut = _bearing_capacity(bolt, bolt.thread_material, face, "nut")
        found = min(found, nut, key=lambda each: each.capacity)
    return found


def _bearing_capacity(bolt: Bolt, material: str, face: float, side: str) -> HeadBearing:
    """Return the permissible force on a part under a bearing face of diameter d_w [m]."""
    part, hole = catalogue.clamped_material(material), catalogue.bolt(bolt.size).hole
    area = math.pi / 4 * (face**2 - hole**2)
    if not bolt.washer:
        return HeadBearing(
            capacity=part.head_pressure * area,
            provenance=part.provenance,
            source=(
                f"permissible pressure on {part.name}, {part.source}; under the {side},"
                f" {1e3 * face:g} mm wide"
            ),
        )
    washer = catalogue.washer(bolt.size)
    outer = min(washer.diameter, face + _WASHER_SPREAD_RATIO * washer.thickness)
    below = part.head_pressure * math.pi / 4 * (outer**2 - hole**2)
    above = washer.pressure * area
    if above < below:
        return HeadBearing(above, washer.provenance, f"{side} on its washer, {washer.source}")
    return HeadBearing(
        below,
        part.provenance,
        f"permissible pressure on {part.name} under a washer, {part.source}; {washer.source}",
    )


# Shear strength of bolts over R_m [-].
BOLT_SHEAR_RATIO = 0.6
_TAN_FLANK_ANGLE = math.tan(math.pi / 6)


def stripping_length(bolt: BoltData, tensile_strength: float, material: ClampedMaterial) -> float:
    """Return the engagement m_eff at which a thread strips at R_m A_S of the bolt [m] (R11/1).

    m_eff = R_m A_S P/(C_3 tau_BM (P/2 + (d - D_2) tan 30 deg) pi d) for the tapped thread; the
    bolt's thread likewise with C_2 at D_1. C_2 and C_3 follow from the strength ratio R_S, after
    Alexander; C_1 = 1, since a tapped part does not widen as a nut does. Run-out and chamfer, about
    two pitches, are not included.
    """
    d, pitch, middle = bolt.diameter, bolt.pitch, bolt.pitch_diameter
    inner = d - 1.0825 * pitch
    # Shear areas per length of thread [m].
    tapped = math.pi * d * (0.5 + (d - middle) * _TAN_FLANK_ANGLE / pitch)
    own = math.pi * inner * (0.5 + (middle - inner) * _TAN_FLANK_ANGLE / pitch)
    strip_tapped = tapped * material.shear_ratio * material.strength
    strip_own = own * BOLT_SHEAR_RATIO * tensile_strength
    ratio = strip_tapped / strip_own
    strength = min(_tapped_factor(ratio) * strip_tapped, _bolt_factor(ratio) * strip_own)
    return tensile_strength * bolt.stress_area / strength


def _tapped_factor(ratio: float) -> float:
    """Return C_3, the reduction for bending of the tapped thread, from R_S."""
    if ratio >= 1.0:
        return 0.897
    r = max(ratio, 0.4)
    return 0.728 + 1.769 * r - 2.896 * r**2 + 1.296 * r**3


def _bolt_factor(ratio: float) -> float:
    """Return C_2, the reduction for bending of the bolt thread, from R_S."""
    if ratio <= 1.0:
        return 0.897
    r = min(ratio, 2.2)
    return 5.594 - 13.682 * r + 14.107 * r**2 - 6.057 * r**3 + 0.9353 * r**4


def transverse_slip_limit(
    bolt: BoltData, length: float, preload: float, head_friction: float, modulus: float
) -> float:
    """Return the transverse displacement of the parts at which the head slips [m].

    The bolt is a beam of cylinders, clamped against rotation at both ends: s = F_Q c, with c =
    l_K^3/(12 E I_3) for a full thread. The head slips at F_Q = mu_K F_V with the least preload in
    service [N] and the least mu_K; repeated, that loosens the bolt at any tightening torque
    ([Junker1969]_).
    """
    # Rotation per unit moment, rotation and deflection per unit end force: integrals of 1, x and
    # x^2 over E I.
    turn, both, moved, start = 0.0, 0.0, 0.0, 0.0
    for part, diameter in bolt.sections(length):
        stiffness, end = modulus * math.pi / 64 * diameter**4, start + part
        turn += part / stiffness
        both += (end**2 - start**2) / (2 * stiffness)
        moved += (end**3 - start**3) / (3 * stiffness)
        start = end
    return head_friction * preload * (moved - both**2 / turn)
