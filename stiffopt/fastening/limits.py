"""Limits and losses of the preload of a connection with bolts or pins.

A preload F is the largest that assembly leaves in one bolt or pin; the least is F/alpha_A minus the
embedding loss.
"""

from __future__ import annotations

from stiffopt.connection import BoltedFlange, ClampingPins, Connection
from stiffopt.contact.validate import require_positive
from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputError
from stiffopt.fastening import bolts, set_screws
from stiffopt.fastening.tightening import Tightening
from stiffopt.fastening.tightening import WorkshopTorque as WorkshopTorque
from stiffopt.fastening.utilisation import PreloadLimit as PreloadLimit


def _require_fasteners(element: Connection) -> BoltedFlange | ClampingPins:
    if isinstance(element, BoltedFlange | ClampingPins):
        return element
    raise InputError(
        f"{element.owner} has no bolts and no pins. Name a bolted_flange or clamping_pins."
    )


def fastener_count(element: Connection) -> int:
    """Return the number of bolts or pins."""
    fastened = _require_fasteners(element)
    return fastened.bolt_count if isinstance(fastened, BoltedFlange) else fastened.count


def preload_limits(element: Connection, tightening: Tightening) -> tuple[PreloadLimit, ...]:
    """Return the limits on the preload of one bolt or pin."""
    fastened = _require_fasteners(element)
    if isinstance(fastened, BoltedFlange):
        return bolts.limits(fastened, tightening)
    return set_screws.limits(fastened)


def check_preload(element: Connection, tightening: Tightening) -> None:
    """Raise `InputError` if the preload of an element exceeds the capacity of its fasteners."""
    fastened = _require_fasteners(element)
    force = fastened.preload
    assert force is not None  # both kinds require a preload
    if isinstance(fastened, BoltedFlange):
        bolt = bolts.flange_bolt(fastened)
        most = bolts.permissible_preload(fastened, tightening)
        bound = f"the largest assembly preload {most / 1e3:.4g} kN of {bolt.size} {bolt.grade}"
        why = f"VDI 2230, thread friction {tightening.thread_friction:g}"
        remedy = "a larger bolt, a higher grade or less thread friction"
    else:
        most = set_screws.torque_capacity(fastened)
        size = "" if fastened.screw is None else fastened.screw.size
        bound = f"the {most / 1e3:.4g} kN that a set screw {size} reaches at its tightening torque"
        why = "strength class 45H"
        remedy = "a larger screw or more pins"
    if force > most:
        raise InputError(
            f"preload {force / 1e3:.4g} kN of {element.name} is above {bound} ({why}). Lower the "
            f"preload, or take {remedy}."
        )


def preload_loss(element: Connection, tightening: Tightening) -> float:
    """Return the preload loss of one bolt or pin by embedding and temperature [N] (R4)."""
    fastened = _require_fasteners(element)
    if isinstance(fastened, BoltedFlange):
        return bolts.preload_loss(fastened, tightening)
    return set_screws.preload_loss(fastened, tightening)


def scatter(element: Connection, tightening: Tightening) -> float:
    """Return alpha_A, largest over least assembly preload of a bolt or pin [-] (R1)."""
    fastened = _require_fasteners(element)
    if isinstance(fastened, BoltedFlange):
        return bolts.scatter(fastened, tightening)
    return tightening.alpha


def workshop_torque(element: Connection, preload: float, tightening: Tightening) -> WorkshopTorque:
    """Return the wrench setting for the largest preload of one bolt or pin [N]."""
    fastened = _require_fasteners(element)
    require_positive(element.owner, preload=preload)
    if isinstance(fastened, BoltedFlange):
        return bolts.workshop_torque(fastened, preload, tightening)
    return set_screws.workshop_torque(fastened, preload, tightening)


def key_pressure_limit(hub_material: str, reversing: bool) -> tuple[float, str, str]:
    """Return the permissible flank pressure of a parallel key [Pa], provenance and source."""
    data = catalogue.clamped_material(hub_material)
    kind = "reversing" if reversing else "steady"
    source = f"key in a hub of {hub_material}, {kind} torque, in the order of DIN 6892"
    return data.key_pressure[kind], data.provenance, source
