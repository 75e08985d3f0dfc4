"""What becomes of a joint as the bolts or pins of one connection work loose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.errors import ProblemError
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.sensitivity import largest_torque


@dataclass(frozen=True, kw_only=True)
class LoosenedConnection:
    """A joint with one connection at a fraction of its preload, under its largest torque.

    Parameters
    ----------
    key : str
        Of the element.
    joint : int
        1-based.
    fraction : float
        Of the least preload that tightening leaves, for all bolts or pins of the element [-].
    case : str
        Load case with the largest torque at the joint.
    slip_safety : float
        Slip torque over torque [-]; infinite without torque.
    first_slip : bool
        The rim of the ring slips. Pins bear at one radius, so all of them slip at once.
    slips : bool
        The whole connection slips.
    stiffness : float
        Tangent stiffness of the joint by the exact law [N m/rad]; 0 where the connection slips.
    lost : float
        Part of the tight joint's stiffness that is gone [-].
    """

    key: str
    joint: int
    fraction: float
    case: str
    slip_safety: float
    first_slip: bool
    slips: bool
    stiffness: float
    lost: float


@dataclass(frozen=True)
class Loosening:
    """All connections of a study as they work loose, one at a time.

    Parameters
    ----------
    rows : tuple of Loosened
    first_slip_fraction, slip_fraction : dict of element key to float
        Fraction of the least preload below which the rim, or the whole connection, slips under the
        largest torque [-]; above 1 where it slips when tight already.
    """

    rows: tuple[LoosenedConnection, ...]
    first_slip_fraction: dict[str, float]
    slip_fraction: dict[str, float]


def loosening(
    model: PreloadModel,
    preloads: np.ndarray,
    fractions: Sequence[float] = (1.0, 0.8, 0.5, 0.3),
) -> Loosening:
    """Loosen each connection while the others stay tight.

    Parameters
    ----------
    model : PreloadModel
    preloads : array (size,)
        Largest preloads as tightened [N].
    fractions : sequence of float
        Of the least preload that is left of them, above 0 and at most 1.

    Returns
    -------
    Loosening
    """
    for fraction in fractions:
        if not 0.0 < fraction <= 1.0:
            raise ProblemError(
                f"loosening: fraction = {fraction:g} must be above 0 and at most 1, the part of "
                "the preload that is left. Leave it out."
            )
    rims = [first_slip_torque(model, preloads, i) for i in range(len(model.elements))]
    slips = [float(model.slip_torque(preloads, i)) for i in range(len(model.elements))]
    rows: list[LoosenedConnection] = []
    first: dict[str, float] = {}
    whole: dict[str, float] = {}
    for index, (element, rim, slip) in enumerate(zip(model.elements, rims, slips, strict=True)):
        torque = abs(float(largest_torque(model, element.joint).torque[element.joint - 1]))
        # Both slip torques are proportional to the preload that is left.
        first[element.key], whole[element.key] = torque / rim, torque / slip
        rows += _loosened_rows(
            model, preloads, index, fractions, first[element.key], whole[element.key]
        )
    return Loosening(tuple(rows), first, whole)


def first_slip_torque(model: PreloadModel, preloads: np.ndarray, index: int) -> float:
    """Joint torque at which an element begins to slip [N m]: a ring at its rim, pins all at once.

    With the least preload, even over the ring.
    """
    element = model.elements[index]
    connection = element.stage.element
    if not isinstance(connection, BoltedFlange):
        return float(model.slip_torque(preloads, index))
    own = preloads[model.slices[index]]
    least = float(np.mean(element.least(own)))
    return float(connection.first_slip_torque(least)) * element.stage.reduction


def loosen_element(
    model: PreloadModel, preloads: np.ndarray, index: int, fraction: float
) -> np.ndarray:
    """Design vector whose least preloads are a fraction of the tight ones in one element [N]."""
    element, part = model.elements[index], model.slices[index]
    changed = preloads.copy()
    changed[part] = element.largest(fraction * element.least(preloads[part]))
    return changed


def _loosened_rows(
    model: PreloadModel,
    preloads: np.ndarray,
    index: int,
    fractions: Sequence[float],
    first: float,
    whole: float,
) -> Iterator[LoosenedConnection]:
    element = model.elements[index]
    case = largest_torque(model, element.joint)
    torque = np.array([case.torque[element.joint - 1]])
    tight = 1.0 / float(model.exact_compliance(preloads, element.joint, torque)[0])
    for fraction in fractions:
        slips = fraction <= whole
        left = 0.0
        if not slips:
            changed = loosen_element(model, preloads, index, fraction)
            left = 1.0 / float(model.exact_compliance(changed, element.joint, torque)[0])
        yield LoosenedConnection(
            key=element.key,
            joint=element.joint,
            fraction=float(fraction),
            case=case.name,
            slip_safety=fraction / whole if whole > 0.0 else np.inf,
            first_slip=fraction < first,
            slips=slips,
            stiffness=left,
            lost=1.0 - left / tight if tight > 0.0 else 0.0,
        )
