"""Bolts of a flange: limits on the preload (VDI 2230), preload loss, workshop torque."""

from __future__ import annotations

import math

import numpy as np

from stiffopt.connection import Bolt, BoltedFlange
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.fasteners import BoltData
from stiffopt.errors import InputError
from stiffopt.fastening.bolt_strength import bolt_data, clamp_length, head_bearing, stripping_length
from stiffopt.fastening.compliance import (
    bolt_compliance,
    clamped_compliance,
    flange_embedding,
    thermal_change,
    through_bolted_compliance,
)
from stiffopt.fastening.tightening import Tightening, WorkshopTorque, tightening_torque
from stiffopt.fastening.utilisation import PreloadLimit
from stiffopt.symbolic import Quantity

# Least gap between two heads over the head diameter: the closest bolt circles of reducers (nine M3
# on 17 mm) leave 5.7 %.
_MIN_HEAD_GAP_RATIO = 0.05


def flange_bolt(flange: BoltedFlange) -> Bolt:
    """Return the bolt of a flange; raise `InputError` with the missing entry if there is none."""
    if flange.bolt is None:
        raise InputError(
            f"{flange.owner}: its bolts are not given, so they have no limits. Add "
            "`bolt = { size = ..., grade = ..., count = ..., circle_diameter = ... }` to the "
            "element in the robot file."
        )
    return flange.bolt


def permissible_preload(flange: BoltedFlange, tightening: Tightening) -> float:
    """Return the permissible assembly preload of one bolt, 90 % of yield in tightening [N]."""
    bolt = flange_bolt(flange)
    return float(
        permissible_assembly_preload(
            bolt_data(bolt),
            catalogue.proof_stress(bolt.grade),
            tightening.thread_friction,
        )
    )


def limits(flange: BoltedFlange, tightening: Tightening) -> tuple[PreloadLimit, ...]:
    """Return the limits on the preload of one bolt, the permissible assembly preload first."""
    bolt = flange_bolt(flange)
    data = bolt_data(bolt)
    bearing = head_bearing(bolt)
    return (
        PreloadLimit(
            name="bolt utilisation",
            capacity=permissible_preload(flange, tightening),
            provenance=data.provenance,
            source=(
                f"VDI 2230, {bolt.size} {bolt.grade}: 90 % of R_p0.2 in tension and torsion while "
                f"tightening; {catalogue.bolt_grade(bolt.grade).source}"
            ),
            remedy="a larger bolt, a higher grade or less thread friction",
        ),
        PreloadLimit(
            name="head pressure",
            capacity=bearing.capacity,
            provenance=bearing.provenance,
            source=bearing.source,
            remedy="a harder part or a hard washer under the head, or a larger bolt",
        ),
        *_engagement_limits(bolt, data),
        *_spacing_limits(flange, data),
    )


def _engagement_limits(bolt: Bolt, data: catalogue.BoltData) -> tuple[PreloadLimit, ...]:
    """Return no limit with a nut: nuts of the bolt's class are as strong (ISO 898-2, 3506-2)."""
    if bolt.nut:
        return ()
    thread = catalogue.clamped_material(bolt.thread_material)
    strength = catalogue.tensile_strength(bolt.grade)
    strips = stripping_length(catalogue.bolt(bolt.size), strength, thread) / data.diameter
    needed, present = (
        max(thread.engagement_for(bolt.grade), strips),
        engagement_length(bolt) / data.diameter,
    )
    how = "assumed" if bolt.engagement is None else "given"
    limit = PreloadLimit(
        name="thread engagement",
        capacity=math.inf,
        fixed=needed / present,
        provenance=thread.provenance,
        source=(
            f"{needed:g} d needed in {thread.name} for {bolt.grade}, {thread.source}; "
            f"{present:.3g} d {how}; below {strips:.3g} d a thread strips before the bolt breaks"
        ),
        remedy="a deeper thread, a thread insert, a harder part or a lower grade",
    )
    return (limit,)


def _spacing_limits(flange: BoltedFlange, data: catalogue.BoltData) -> tuple[PreloadLimit, ...]:
    circle, edge = flange.circle_diameter / 2, data.hole / 2
    outwards = (circle + edge) / flange.outer_radius
    inwards = (flange.inner_radius + edge) / circle
    in_ring = PreloadLimit(
        name="hole in ring",
        capacity=math.inf,
        fixed=max(outwards, inwards),
        provenance=data.provenance,
        source="edge of the clearance hole, ISO 273, against the rim of the pressed ring",
        remedy="a smaller bolt or a wider ring",
    )
    count = flange.bolt_count * flange.sectors
    chord = flange.circle_diameter * math.sin(math.pi / count)
    return (
        PreloadLimit(
            name="bolt spacing",
            capacity=math.inf,
            fixed=(1 + _MIN_HEAD_GAP_RATIO)
            * _largest_head_width(flange_bolt(flange), data)
            / chord,
            provenance="estimated",
            source=(
                f"heads and nuts with {100 * _MIN_HEAD_GAP_RATIO:g} % of their diameter between"
                " them"
            ),
            remedy="fewer or smaller bolts, or a larger bolt circle",
        ),
        in_ring,
    )


def _largest_head_width(bolt: Bolt, data: BoltData) -> float:
    """Return the larger diameter of head and nut [m]."""
    nut = catalogue.hexagon(bolt.size).corners if bolt.nut else 0.0
    return max(data.head_diameter, nut)


def engagement_length(bolt: Bolt) -> float:
    """Return the thread engagement m_eff, given or assumed [m]."""
    if bolt.engagement is not None:
        return bolt.engagement
    assumed = catalogue.clamped_material(bolt.thread_material).engagement_assumed
    return assumed * catalogue.bolt(bolt.size).diameter


def joint_compliances(flange: BoltedFlange) -> tuple[float, float]:
    """Return delta_S and delta_P of one bolt and its clamped parts [m/N] (R3)."""
    bolt = flange_bolt(flange)
    data = bolt_data(bolt)
    length = clamp_length(bolt)
    head = catalogue.clamped_material(bolt.head_material)
    thread = catalogue.clamped_material(bolt.thread_material)
    # Clamped part of one bolt: width of the ring by the spacing of the bolts.
    count = flange.bolt_count * flange.sectors
    share = min(flange.outer_radius - flange.inner_radius, math.pi * flange.circle_diameter / count)
    modulus = catalogue.bolt_grade(bolt.grade).modulus
    around = modulus if bolt.nut else thread.modulus
    delta_s = bolt_compliance(data, length, modulus, around, head=bolt.head, nut=bolt.nut)
    if not bolt.nut:
        return delta_s, clamped_compliance(data, length, share, head.modulus)
    nut = catalogue.hexagon(bolt.size).bearing_diameter
    moduli = (head.modulus, thread.modulus)
    return delta_s, through_bolted_compliance(data, nut, length, share, moduli)


def preload_loss(flange: BoltedFlange, tightening: Tightening) -> float:
    """Return F_Z + Delta F_Vth, preload loss by embedding and change of temperature [N] (R4)."""
    settled = tightening.embedding
    if settled is None:
        settled = flange_embedding(flange)
    return settled / sum(joint_compliances(flange)) + thermal_preload(flange, tightening)


def thermal_preload(flange: BoltedFlange, tightening: Tightening) -> float:
    """Return |Delta F_Vth|, a loss in one direction of the change and a gain in the other [N]."""
    bolt = flange_bolt(flange)
    ends = (bolt.head_material, bolt.thread_material if bolt.nut else bolt.head_material)
    parts = [catalogue.clamped_material(name).expansion for name in ends]
    change = thermal_change(
        clamp_length(bolt),
        catalogue.bolt_grade(bolt.grade).expansion,
        sum(parts) / 2.0,
        tightening.temperature_change,
        sum(joint_compliances(flange)),
    )
    return abs(change)


def scatter(flange: BoltedFlange, tightening: Tightening) -> float:
    """Return the tightening factor alpha_A of one bolt [-] (R1)."""
    return tightening.alpha_of(bolt_data(flange_bolt(flange)))


def workshop_torque(flange: BoltedFlange, preload: float, tightening: Tightening) -> WorkshopTorque:
    """Return the wrench setting for the largest preload [N] of one bolt."""
    data = bolt_data(flange_bolt(flange))
    thread, head = tightening.thread_friction, tightening.head_friction
    nominal = float(tightening_torque(data, preload, thread, head))
    # The pitch term of the torque does not depend on friction.
    pitch = float(tightening_torque(data, preload, 0.0, 0.0))
    alpha = tightening.alpha_of(data)
    return WorkshopTorque(
        nominal=nominal,
        lower=nominal / alpha,
        upper=nominal,
        friction_factor=(alpha * nominal - pitch) / (nominal - pitch),
    )


def permissible_assembly_preload(
    bolt: BoltData, proof_stress: Quantity, thread_friction: Quantity, yield_share: Quantity = 0.9
) -> Quantity:
    """Return the assembly preload at the permitted utilisation of the yield strength [N].

    F_M,zul = nu R_p0.2 A_0 / sqrt(1 + 3 [3/2 d2/d_0 (P/(pi d2) + mu_G/cos 30 deg)]^2), with the
    stress area A_0 = A_S, or that of a thinner shank ([VDI2230]_; 1.155 = 1/cos 30 deg is printed
    there). The torque of mu_G twists the bolt.
    """
    thread = bolt.pitch / (math.pi * bolt.pitch_diameter) + thread_friction / math.cos(math.pi / 6)
    torsion = 1.5 * bolt.pitch_diameter / bolt.stress_diameter * thread
    return yield_share * proof_stress * bolt.stress_area / np.sqrt(1 + 3 * torsion**2)
