"""Verification steps of VDI 2230 for one flange at one preload, with value, limit, utilisation."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from stiffopt.drivetrain import catalogue
from stiffopt.fastening import bolt_strength
from stiffopt.fastening.bolt_strength import MIN_ENDURANCE_SAFETY as ENDURANCE_SAFETY
from stiffopt.fastening.flange_load import transverse_forces
from stiffopt.fastening.utilisation import SafetyFactor, UtilisationRow
from stiffopt.fastening.verification import MIN_ALTERNATING_SLIP_SAFETY, Verification

# Required safety against yield in service (R8), surface pressure (R10), shear after slip (R12) [-].
MIN_YIELD_SAFETY, MIN_PRESSURE_SAFETY, MIN_SHEAR_SAFETY = 1.0, 1.0, 1.1
# Width of an interface over the head's bearing diameter up to which its pressure is uniform (limit
# G'' of a tapped hole: 1.5 to 2, the lower end) [-].
_MAX_FACE_WIDTH_RATIO = 1.5


def vdi_rows(
    steps: Verification, preload: float, shift: float = math.nan, least: float | None = None
) -> tuple[UtilisationRow, ...]:
    """Return every verification step at a largest assembly preload F_M [N].

    `shift` is the transverse displacement of the parts at the bolts [m]; nan omits the check of
    self-loosening. `least` is F_V in service [N]; default after scatter and losses.
    """
    if least is None:
        least = preload / steps.scatter - steps.loss
    return (
        *_clamp_load_rows(steps, least),
        *_stress_rows(steps, preload, least),
        *_shear_rows(steps),
        *_warning_rows(steps, least, shift),
    )


def _worst_case(steps: Verification, values: np.ndarray) -> tuple[int, str]:
    index = int(np.argmax(values))
    return index, steps.loads.names[index]


def _clamp_load_rows(steps: Verification, least: float) -> Iterator[UtilisationRow]:
    unloaded = (1.0 - steps.factor.least) * np.maximum(steps.opening, 0.0)
    needed = steps.slip_safety * steps.clamp_against_slip + unloaded
    index, case = _worst_case(steps, needed.max(axis=1))
    place = int(np.argmax(needed[index]))
    left = least - float(unloaded[index, place])
    friction = float(steps.clamp_against_slip[index, place])
    most = float(needed[index, place])
    kind = "alternating" if steps.slip_safety == MIN_ALTERNATING_SLIP_SAFETY else "static"
    if not steps.loads.has_force_or_tilting:
        # Under torque alone this equals the slip safety of the connection.
        return
    # An open interface has no friction.
    slips = max(left, 0.0) / friction if friction > 0.0 else math.inf
    extra = 100 * (steps.friction_radius / (steps.flange.circle_diameter / 2) - 1)
    yield UtilisationRow(
        kind="slip under the whole load",
        equation="R12/4",
        safety=SafetyFactor("S_G", slips, steps.slip_safety),
        value=slips,
        limit=steps.slip_safety,
        utilisation=_required_over_available(most, least),
        case=case,
        source=(
            f"{kind}: shear and torque as vectors, bolt tension subtracted; friction at "
            f"the mean radius of the ring, {extra:.1f} % outside the bolt circle"
        ),
        provenance="catalogue",
        remedy="more friction, more or larger bolts, a larger circle, or less scatter",
    )
    index, case = _worst_case(steps, steps.clamp_against_opening)
    opens = float(steps.clamp_against_opening[index])
    if opens > 0.0:
        yield UtilisationRow(
            kind="one-sided opening",
            equation="R2/3",
            value=least,
            limit=opens,
            unit="N",
            utilisation=_required_over_available(opens, least),
            case=case,
            source="pressure at the rim of the ring less its holes, axial force and tilting",
            provenance="catalogue",
            remedy="more or larger bolts, a larger circle, or less scatter",
        )


def _stress_rows(steps: Verification, preload: float, least: float) -> Iterator[UtilisationRow]:
    _, case = _worst_case(steps, steps.opening.max(axis=1))
    friction = steps.tightening.thread_friction
    stress = float(bolt_strength.working_stress(steps.data, preload, steps.additional, friction))
    yield UtilisationRow(
        kind="working stress",
        equation="R8/5",
        safety=SafetyFactor("S_F", steps.proof_stress / stress, MIN_YIELD_SAFETY),
        value=stress,
        limit=steps.proof_stress,
        unit="Pa",
        utilisation=stress / steps.proof_stress,
        case=case,
        source=(
            f"R_p0.2 of {steps.bolt.grade}, half of the torsion of tightening, safety "
            f"{MIN_YIELD_SAFETY:g}"
        ),
        provenance="catalogue",
        remedy="a larger bolt, a higher grade or less load",
    )
    bearing = bolt_strength.head_bearing(steps.bolt)
    force = preload + steps.additional
    yield UtilisationRow(
        kind="head pressure in service",
        equation="R10/2",
        safety=SafetyFactor("S_P", bearing.capacity / force, MIN_PRESSURE_SAFETY),
        value=force,
        limit=bearing.capacity,
        unit="N",
        utilisation=force / bearing.capacity,
        case=case,
        source=bearing.source,
        provenance=bearing.provenance,
        remedy="a harder part or a hard washer under the head, or a larger bolt",
    )
    if steps.alternating_force > 0.0:
        mean = preload + steps.alternating_force / 2
        limit = float(
            bolt_strength.endurance_limit(steps.data, steps.bolt.rolled, mean, steps.proof_stress)
        )
        amplitude = bolt_strength.stress_amplitude(steps.data, steps.alternating_force, 0.0)
        yield UtilisationRow(
            kind="alternating stress",
            equation="R9/4",
            safety=SafetyFactor("S_D", limit / amplitude, ENDURANCE_SAFETY),
            value=amplitude,
            limit=limit / ENDURANCE_SAFETY,
            unit="Pa",
            utilisation=ENDURANCE_SAFETY * amplitude / limit,
            case=case,
            source=(
                f"{_describe_thread(steps)}, endurance limit over {ENDURANCE_SAFETY:g}; loading and"
                " unloading included"
            ),
            provenance="catalogue" if steps.grade.heat_treated else "estimated",
            remedy="a larger bolt, a longer one, more bolts, or threads rolled at the end",
        )


def _shear_rows(steps: Verification) -> Iterator[UtilisationRow]:
    """Yield the bolt shear and hole bearing rows in case the interface slips."""
    force = transverse_forces(
        steps.loads.values, steps.count, steps.flange.circle_diameter / 2, steps.angles
    )
    sizes = np.linalg.norm(force, axis=-1)
    index, case = _worst_case(steps, sizes.max(axis=1))
    most = float(sizes[index].max())
    if most <= 0.0:
        return
    strength = bolt_strength.BOLT_SHEAR_RATIO * steps.grade.tensile_strength
    stress = most / steps.data.core_area
    yield UtilisationRow(
        kind="bolt shear",
        equation="R12",
        safety=SafetyFactor("S_A", strength / stress, MIN_SHEAR_SAFETY),
        value=stress,
        limit=strength / MIN_SHEAR_SAFETY,
        unit="Pa",
        utilisation=MIN_SHEAR_SAFETY * stress / strength,
        case=case,
        source="after slip, thread in the face: core area, 0.6 R_m, safety 1.1",
        provenance="catalogue",
        remedy="more or larger bolts, or a larger circle",
    )
    part = catalogue.clamped_material(steps.bolt.head_material)
    pressure = most / (steps.data.diameter * bolt_strength.clamp_length(steps.bolt))
    yield UtilisationRow(
        kind="hole bearing",
        equation="R12",
        value=pressure,
        limit=part.yield_stress,
        unit="Pa",
        utilisation=pressure / part.yield_stress,
        case=case,
        source=f"after slip, on the length of the clamped part; R_p0.2 of {part.name}",
        provenance=part.provenance,
        remedy="a thicker or harder part, or more bolts",
    )


def _warning_rows(steps: Verification, least: float, shift: float) -> Iterator[UtilisationRow]:
    width = steps.flange.outer_radius - steps.flange.inner_radius
    # Two bolts press the ring along one line, which only a rigid flange spreads around it.
    extent = max(width, steps.flange.circle_diameter if steps.count < 3 else 0.0)
    spread = _MAX_FACE_WIDTH_RATIO * steps.data.bearing_diameter
    yield UtilisationRow(
        kind="validity of even pressure",
        equation="R0, limit G",
        value=extent,
        limit=spread,
        unit="m",
        utilisation=extent / spread,
        source="width of the ring, or distance of two bolts, against G'' = 1.5 d_w: wider faces "
        "open and slip otherwise",
        provenance="catalogue",
        remedy="a narrower ring, three or more bolts, larger heads, washers, or finite elements",
        binding=False,
        warns=(
            "preload and torque follow the formulas, but the pressure on so wide a ring is less"
            " uniform than these assume, and it slips and opens earlier. The warning counts: take"
            " slip and opening for estimates"
        ),
    )
    if math.isfinite(shift):
        limit = bolt_strength.transverse_slip_limit(
            steps.data,
            bolt_strength.clamp_length(steps.bolt),
            max(least, 0.0),
            steps.tightening.head_friction,
            steps.grade.modulus,
        )
        yield UtilisationRow(
            kind="self-loosening",
            equation="Junker",
            value=shift,
            limit=limit,
            unit="m",
            utilisation=shift / limit if limit > 0.0 else math.inf,
            source="movement of the parts at a bolt against that at which its head slips",
            provenance="catalogue",
            remedy="longer or more slender bolts, more preload, or a locking feature",
            binding=False,
            warns=(
                "preload and torque remain valid, but they do not prevent bolts from turning loose"
                " under repeated load. Both count: tighten so, and lock"
            ),
        )


def _describe_thread(steps: Verification) -> str:
    if steps.grade.heat_treated:
        return f"thread rolled {steps.bolt.rolled} heat treatment"
    return "formula of heat-treated bolts, no published one for stainless"


def _required_over_available(needed: float, present: float) -> float:
    """Return required over available value; 0 if none is required."""
    if needed <= 0.0:
        return 0.0
    return needed / present if present > 0.0 else math.inf
