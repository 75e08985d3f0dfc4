"""Set screws and pins on a shaft: limits on the preload, preload loss, workshop torque."""

from __future__ import annotations

import math

from stiffopt.connection import ClampingPins
from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputError
from stiffopt.fastening.compliance import tip_compliance
from stiffopt.fastening.tightening import Tightening, WorkshopTorque
from stiffopt.fastening.utilisation import PreloadLimit

# Permissible tip pressure over yield strength: indentation begins at 2.8, and 0.9 of it is allowed.
_INDENTATION_PRESSURE_RATIO = 0.9 * 2.8
# Default screw length in screw diameters, and screw diameter in tip diameters.
_DEFAULT_LENGTH_RATIO, _DEFAULT_DIAMETER_RATIO = 1.5, 2.0
# Embedding of thread and tip [m]: thread and head in VDI 2230 Table 5, Rz below 10 um.
_THREAD_AND_TIP_EMBEDDING = 6e-6
# Shaft material of pins without a screw: the softer one.
_DEFAULT_SHAFT_MATERIAL = "steel_45"


def torque_capacity(pins: ClampingPins) -> float:
    """Return the preload at the permissible tightening torque, M/(0.2 d) [N]; inf without screw."""
    if pins.screw is None:
        return math.inf
    data = catalogue.set_screw(pins.screw.size)
    return data.tightening_torque / (data.nut_factor * data.diameter)


def limits(pins: ClampingPins) -> tuple[PreloadLimit, ...]:
    """Return the limits on the preload of one pin; the first is that of the screw, if given."""
    shaft = _DEFAULT_SHAFT_MATERIAL if pins.screw is None else pins.screw.shaft_material
    pressure = _INDENTATION_PRESSURE_RATIO * catalogue.shaft_proof_stress(shaft)
    assumed = ", assumed because the element names no screw" if pins.screw is None else ""
    indentation = PreloadLimit(
        name="tip indentation",
        capacity=pressure * pins.tip_area,
        provenance="estimated",
        source=f"0.9 x 2.8 R_p0.2 of the shaft, {shaft}{assumed}",
        remedy="a larger tip, a harder shaft or more pins",
    )
    if pins.screw is None:
        return (indentation,)
    data = catalogue.set_screw(pins.screw.size)
    torque = PreloadLimit(
        name="screw torque",
        capacity=torque_capacity(pins),
        provenance=data.provenance,
        source=f"M/({data.nut_factor:g} d) with {data.tightening_torque:g} N m, {data.source}",
        remedy="a larger screw or more pins",
    )
    return (torque, indentation)


def screw_length(pins: ClampingPins) -> float:
    """Return the length from the tip to the engaged thread, given or assumed [m]."""
    if pins.screw is None:
        return _DEFAULT_LENGTH_RATIO * _DEFAULT_DIAMETER_RATIO * pins.tip_diameter
    if pins.screw.length is None:
        return _DEFAULT_LENGTH_RATIO * catalogue.set_screw(pins.screw.size).diameter
    return pins.screw.length


def pin_compliance(pins: ClampingPins) -> float:
    """Return the compliance of screw and half space under the tip in series [m/N]."""
    if pins.screw is None:
        area = math.pi / 4 * (_DEFAULT_DIAMETER_RATIO * pins.tip_diameter) ** 2
    else:
        area = catalogue.set_screw(pins.screw.size).minor_area
    screw = screw_length(pins) / (catalogue.set_screw_modulus() * area)
    return screw + tip_compliance(pins.surface.contact_modulus, pins.tip_diameter)


def preload_loss(pins: ClampingPins, tightening: Tightening) -> float:
    """Return the preload loss of one pin by embedding of thread and tip [N]."""
    settled = _THREAD_AND_TIP_EMBEDDING if tightening.embedding is None else tightening.embedding
    return settled / pin_compliance(pins)


def workshop_torque(pins: ClampingPins, preload: float, tightening: Tightening) -> WorkshopTorque:
    """Return the wrench setting for the largest preload [N] of one screw, by the nut factor."""
    if pins.screw is None:
        raise InputError(
            f"{pins.owner}: no screw is given, so there is no tightening torque. Add "
            '`screw = { size = "M4" }` to the element in the robot file.'
        )
    data = catalogue.set_screw(pins.screw.size)
    nominal = data.nut_factor * data.diameter * preload
    return WorkshopTorque(
        nominal=nominal,
        lower=nominal / tightening.alpha,
        upper=nominal,
        friction_factor=tightening.alpha,
    )
