"""Everything a preload design has to keep, by name and with its utilisation, by the exact law."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stiffopt.connection import Key
from stiffopt.fastening.limits import key_pressure_limit
from stiffopt.preload.model import PreloadModel

# A row this close to its limit is called active: less than reports show of a utilisation, more than
# the optimiser leaves.
ACTIVE = 1e-4
# Share of the largest torque of a joint below which one is zero but for rounding, and no reversal.
_NO_TORQUE = 1e-9


@dataclass(frozen=True, kw_only=True)
class UtilisationRow:
    """One requirement and how far it is used.

    Parameters
    ----------
    kind : str
        "slip safety", "bolt utilisation", "joint stiffness", ...
    joint : int or None
        1-based.
    element : str
        Key of the element, "" where the row is of no single one.
    case : str
        Load case, "" where it does not matter.
    value, limit : float
        In `unit`.
    utilisation : float
        1 at the limit, above where it is exceeded.
    provenance, source : str
        Of the limit.
    remedy : str
        What to change where this row stops a study.
    equation : str
        Step of VDI 2230, where it is one.
    binding : bool
        False: tells, but stops no design.
    """

    kind: str
    joint: int | None
    element: str
    case: str
    value: float
    limit: float
    unit: str
    utilisation: float
    provenance: str = "given"
    source: str = ""
    remedy: str = ""
    equation: str = ""
    binding: bool = True

    @property
    def name(self) -> str:
        """Kind, element or joint, and load case."""
        owner = self.element or (f"joint {self.joint}" if self.joint else "")
        return ", ".join(part for part in (self.kind, owner, self.case) if part)

    @property
    def active(self) -> bool:
        """Whether the design lies at this limit."""
        return self.binding and self.utilisation >= 1.0 - ACTIVE

    @property
    def kept(self) -> bool:
        """Whether the limit holds, but for rounding; a warning is always kept."""
        return not self.binding or self.utilisation <= 1.0 + 1e-6


def utilisation_rows(model: PreloadModel, preloads: np.ndarray) -> tuple[UtilisationRow, ...]:
    """All rows of a design by the exact law.

    Parameters
    ----------
    model : PreloadModel
    preloads : array (size,)
        Largest preloads [N].
    """
    return (
        *_slip(model, preloads),
        *_fasteners(model, preloads),
        *(row for index in range(len(model.elements)) for row in vdi_rows(model, preloads, index)),
        *_keys(model),
        *_stiffness(model, preloads),
        *_deflection(model, preloads),
    )


def _slip(model: PreloadModel, preloads: np.ndarray) -> Iterator[UtilisationRow]:
    for index, element in enumerate(model.elements):
        needed = model.slip_safety(element.joint)
        slip = float(model.slip_torque(preloads, index))
        for case in model.cases:
            torque = abs(float(case.torque[element.joint - 1]))
            yield UtilisationRow(
                kind="slip safety",
                joint=element.joint,
                element=element.key,
                case=case.name,
                value=slip / torque if torque else np.inf,
                limit=needed,
                unit="",
                utilisation=needed * torque / slip if slip > 0.0 else np.inf,
                equation="R12/4",
                remedy="more friction, more or larger bolts, a larger circle, or less scatter",
            )


def vdi_rows(model: PreloadModel, preloads: np.ndarray, index: int) -> Iterator[UtilisationRow]:
    """Steps of VDI 2230 of one element under all load cases."""
    element = model.elements[index]
    for check in model.checks(preloads, index):
        yield UtilisationRow(
            kind=check.name,
            joint=element.joint,
            element=element.key,
            case=check.case,
            value=check.value,
            limit=check.limit,
            unit=check.unit,
            utilisation=check.utilisation,
            provenance=check.provenance,
            source=check.source,
            remedy=check.remedy,
            equation=check.equation,
            binding=not check.warning,
        )


# Steps of VDI 2230 that bound the preload at assembly.
_STEPS = {
    "bolt utilisation": "R7/2",
    "head pressure": "R10/1",
    "thread engagement": "R11",
    "bolt spacing": "",
}


def _fasteners(model: PreloadModel, preloads: np.ndarray) -> Iterator[UtilisationRow]:
    needs = model.problem.requirements
    for index, element in enumerate(model.elements):
        largest = float(max(model.of_element(preloads, index)))
        lowest = float(min(model.of_element(preloads, index)))
        for limit in element.limits:
            allowed = needs.bolt_utilisation if limit.name == "bolt utilisation" else 1.0
            used = float(limit.utilisation(largest))
            yield UtilisationRow(
                kind=limit.name,
                joint=element.joint,
                element=element.key,
                case="",
                value=used,
                limit=allowed,
                unit="",
                utilisation=used / allowed,
                provenance=limit.provenance,
                source=limit.source,
                remedy=limit.remedy,
                equation=_STEPS.get(limit.name, ""),
            )
        floor = needs.least_preload * element.capacity
        yield UtilisationRow(
            kind="least preload",
            joint=element.joint,
            element=element.key,
            case="",
            value=lowest,
            limit=floor,
            unit="N",
            utilisation=floor / lowest if lowest > 0.0 else np.inf,
            provenance="estimated",
            source="a hardly tightened bolt works loose; the share is our choice",
            remedy="a smaller require.least_preload, or a smaller bolt",
        )


def _keys(model: PreloadModel) -> Iterator[UtilisationRow]:
    """Flank pressures of the keys: no preload changes them, but a design must keep them."""
    for joint in model.problem.joints:
        chain = model.problem.robot.chains[joint - 1]
        assert chain is not None
        torques = [float(case.torque[joint - 1]) for case in model.cases]
        noise = _NO_TORQUE * max(abs(torque) for torque in torques)
        reversing = min(torques) < -noise and max(torques) > noise
        for stage in chain.stages:
            key = stage.element
            if not isinstance(key, Key):
                continue
            allowed, provenance, source = key_pressure_limit(key.hub_material, reversing)
            for case, torque in zip(model.cases, torques, strict=True):
                pressure = float(key.pressure(abs(torque) / stage.reduction))
                yield UtilisationRow(
                    kind="key pressure",
                    joint=joint,
                    element=key.name
                    if len(model.problem.joints) == 1
                    else f"joint_{joint}.{key.name}",
                    case=case.name,
                    value=pressure,
                    limit=allowed,
                    unit="Pa",
                    utilisation=pressure / allowed,
                    provenance=provenance,
                    source=source,
                    remedy="a longer key, a thicker shaft, or a harder hub",
                )


def _stiffness(model: PreloadModel, preloads: np.ndarray) -> Iterator[UtilisationRow]:
    needed = model.problem.requirements.joint_stiffness
    if not needed:
        return
    for joint, row in zip(model.problem.joints, model.exact_stiffness(preloads), strict=True):
        if joint not in needed:
            continue
        for case, stiffness in zip(model.cases, row, strict=True):
            yield UtilisationRow(
                kind="joint stiffness",
                joint=joint,
                element="",
                case=case.name,
                value=float(stiffness),
                limit=needed[joint],
                unit="N m/rad",
                utilisation=needed[joint] / float(stiffness) if stiffness > 0.0 else np.inf,
                remedy="a stiffer reducer or stiffer elements: look at the shares of the wind-up",
            )


def _deflection(model: PreloadModel, preloads: np.ndarray) -> Iterator[UtilisationRow]:
    allowed = model.problem.requirements.tool_deflection
    if allowed is None:
        return
    for case, vector in zip(model.cases, model.exact_deflection(preloads), strict=True):
        if case.jacobian is None:
            continue
        size = float(np.linalg.norm(vector))
        yield UtilisationRow(
            kind="tool deflection",
            joint=None,
            element="",
            case=case.name,
            value=size,
            limit=allowed,
            unit="m",
            utilisation=size / allowed,
            remedy="stiffer joints, a smaller load, or another pose",
        )
