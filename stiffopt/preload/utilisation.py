"""Utilisation rows of a preload design: all requirements, by the exact law."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from stiffopt.connection import Key
from stiffopt.fastening.limits import key_pressure_limit
from stiffopt.fastening.utilisation import SafetyFactor, UtilisationRow, governing_rows
from stiffopt.fastening.vdi_rows import vdi_rows
from stiffopt.preload.load_case import ZERO_TORQUE_SHARE
from stiffopt.preload.model import PreloadModel


def utilisation_rows(model: PreloadModel, preloads: np.ndarray) -> tuple[UtilisationRow, ...]:
    """Return all rows of a design by the exact law.

    `preloads` (size,): largest preloads [N].
    """
    return (
        *_slip_rows(model, preloads, range(len(model.elements))),
        *_fastener_rows(model, preloads),
        *(row for index in range(len(model.elements)) for row in model.vdi_rows(preloads, index)),
        *_key_rows(model),
        *_stiffness_rows(model, preloads),
        *_deflection_rows(model, preloads),
    )


def governing_safety(
    model: PreloadModel, preloads: np.ndarray, index: int
) -> dict[str, UtilisationRow]:
    """Return the rows with the least of each safety factor of an element, by symbol."""
    steps = model.verifications[index]
    if steps is None:
        return {}
    own = np.asarray(model.of_element(preloads, index))
    least = float(model.elements[index].least(float(own.min())))
    rows = vdi_rows(steps, float(own.max()), least=least)
    return governing_rows((*_slip_rows(model, preloads, (index,)), *rows))


def _slip_rows(
    model: PreloadModel, preloads: np.ndarray, indices: Iterable[int]
) -> Iterator[UtilisationRow]:
    for index in indices:
        element = model.elements[index]
        needed = model.slip_safety(element.joint)
        slip = float(model.slip_torque(preloads, index))
        for case in model.cases:
            torque = abs(float(case.torque[element.joint - 1]))
            holds = slip / torque if torque else np.inf
            yield UtilisationRow(
                kind="slip safety",
                joint=element.joint,
                element=element.key,
                case=case.name,
                value=holds,
                limit=needed,
                utilisation=needed * torque / slip if slip > 0.0 else np.inf,
                equation="R12/4",
                safety=SafetyFactor("S_G", holds, needed),
                remedy="more friction, more or larger bolts, a larger circle, or less scatter",
            )


# Steps of VDI 2230 that limit the preload at assembly.
_VDI_STEP_BY_LIMIT = {
    "bolt utilisation": "R7/2",
    "head pressure": "R10/1",
    "thread engagement": "R11",
    "bolt spacing": "",
}


def _fastener_rows(model: PreloadModel, preloads: np.ndarray) -> Iterator[UtilisationRow]:
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
                value=used,
                limit=allowed,
                utilisation=used / allowed,
                provenance=limit.provenance,
                source=limit.source,
                remedy=limit.remedy,
                equation=_VDI_STEP_BY_LIMIT.get(limit.name, ""),
            )
        floor = needs.least_preload * element.capacity
        yield UtilisationRow(
            kind="least preload",
            joint=element.joint,
            element=element.key,
            value=lowest,
            limit=floor,
            unit="N",
            utilisation=floor / lowest if lowest > 0.0 else np.inf,
            provenance="estimated",
            source="a bolt with little preload works loose; the share is an assumption",
            remedy="a smaller require.least_preload, or a smaller bolt",
        )


def _key_rows(model: PreloadModel) -> Iterator[UtilisationRow]:
    """Yield the flank pressures of keys, which do not depend on preloads."""
    for joint in model.problem.joints:
        chain = model.problem.robot.chains[joint - 1]
        assert chain is not None
        torques = [float(case.torque[joint - 1]) for case in model.cases]
        noise = ZERO_TORQUE_SHARE * max(abs(torque) for torque in torques)
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


def _stiffness_rows(model: PreloadModel, preloads: np.ndarray) -> Iterator[UtilisationRow]:
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
                case=case.name,
                value=float(stiffness),
                limit=needed[joint],
                unit="N m/rad",
                utilisation=needed[joint] / float(stiffness) if stiffness > 0.0 else np.inf,
                remedy="a stiffer reducer or stiffer elements: see the shares of the wind-up",
            )


def _deflection_rows(model: PreloadModel, preloads: np.ndarray) -> Iterator[UtilisationRow]:
    allowed = model.problem.requirements.tool_deflection
    if allowed is None:
        return
    for case, vector in zip(model.cases, model.exact_deflection(preloads), strict=True):
        if case.jacobian is None:
            continue
        size = float(np.linalg.norm(vector))
        yield UtilisationRow(
            kind="tool deflection",
            case=case.name,
            value=size,
            limit=allowed,
            unit="m",
            utilisation=size / allowed,
            remedy="stiffer joints, a smaller load, or another pose",
        )
