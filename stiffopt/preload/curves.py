"""Stiffness, slip safety and utilisation over the preload of one connection at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.fastening.vdi_rows import vdi_rows
from stiffopt.fastening.verification import Verification
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.sensitivity import largest_torque
from stiffopt.preload.utilisation import governing_safety

# Requirements that give a lower bound of the preload.
FLOORS = (
    "slip safety",
    "slip under the whole load",
    "one-sided opening",
    "least preload",
    "joint stiffness",
    "tool deflection",
)
# Range of the curves over the largest permissible preload [-].
_PRELOAD_RANGE = (0.05, 1.1)


@dataclass(frozen=True, kw_only=True, eq=False)
class PreloadCurve:
    """Properties of a joint in one load case over the preload of one connection."""

    key: str  # key of the element; all other preloads are those of the design
    joint: int  # 1-based
    case: str
    torque: float  # at the joint [N m]
    design: float  # preload of the design, mean of individual ones [N]
    preload: np.ndarray  # (K,) F, largest assembly preload of one bolt or pin [N], ascending
    # (K,) tangent stiffness of the joint by the exact law at the least preload in service [N
    # m/rad]; 0 where a connection slips.
    stiffness: np.ndarray
    stiffness_high: np.ndarray  # (K,) the same at F, the other end of the scatter [N m/rad]
    # (K,) slip torque at the least preload over torque [-]; infinite without torque.
    slip_safety: np.ndarray
    # By limit name (K,): of every limit that depends on the preload, 1 at the limit [-].
    utilisation: Mapping[str, np.ndarray]
    # By symbol (K,): safety factors of VDI 2230 under all load cases, of bolted joints [-].
    safety: Mapping[str, np.ndarray]
    # By name: preload at which each requirement is active [N]: a lower bound for those of `FLOORS`,
    # an upper bound for others; "slip" at slip safety 1.
    limits: Mapping[str, float]


def preload_curves(
    model: PreloadModel, preloads: np.ndarray, points: int = 60
) -> tuple[PreloadCurve, ...]:
    """Vary the preload of each free element while the others keep their design [N].

    In the load cases of least stiffness and of largest torque.
    """
    if points < 2:
        raise ProblemError(f"preload curves: points = {points} must be 2 or above.")
    stiffness = model.exact_stiffness(preloads)
    curves = []
    for index, element in enumerate(model.elements):
        row = stiffness[model.problem.joints.index(element.joint)]
        softest = model.cases[int(np.argmin(row))]
        cases = dict.fromkeys((softest.name, largest_torque(model, element.joint).name))
        curves += [
            _preload_curve(model, preloads, index, case, points)
            for case in model.cases
            if case.name in cases
        ]
    return tuple(curves)


def _preload_curve(
    model: PreloadModel, preloads: np.ndarray, index: int, case: LoadCase, points: int
) -> PreloadCurve:
    element = model.elements[index]
    torque = float(case.torque[element.joint - 1])
    first, last = (share * element.capacity for share in _PRELOAD_RANGE)
    # Below the embedding loss no preload remains after tightening.
    first = max(first, 1.02 * element.largest(0.0))
    force = np.linspace(first, last, points)
    own = float(np.mean(preloads[model.slices[index]]))
    slip = np.array([model.slip_torque(model.replaced(preloads, index, f), index) for f in force])
    with np.errstate(divide="ignore"):
        safety = slip / abs(torque)
    stiffness = _stiffness_curve(model, preloads, index, torque, force)
    return PreloadCurve(
        key=element.key,
        joint=element.joint,
        case=case.name,
        torque=torque,
        design=own,
        preload=force,
        stiffness=stiffness,
        stiffness_high=_stiffness_curve(model, preloads, index, torque, element.largest(force)),
        slip_safety=safety,
        utilisation={
            limit.name: np.asarray(limit.utilisation(force))
            for limit in element.limits
            if limit.depends_on_preload
        },
        safety=_safety_curves(model, preloads, index, force),
        limits={
            **binding_preloads(model, index, abs(torque)),
            **_stiffness_binding_preloads(model, preloads, index, force, stiffness),
        },
    )


def _safety_curves(
    model: PreloadModel, preloads: np.ndarray, index: int, forces: np.ndarray
) -> dict[str, np.ndarray]:
    found = [governing_safety(model, model.replaced(preloads, index, f), index) for f in forces]
    return {
        symbol: np.array(
            [math.nan if not (s := rows[symbol].safety) else s.value for rows in found]
        )
        for symbol in found[0]
    }


def binding_preloads(model: PreloadModel, index: int, torque: float) -> dict[str, float]:
    """Return the preload [N] at which each requirement of an element is active, by name."""
    element, needs = model.elements[index], model.problem.requirements
    unit = model.slip_torque_per_preload(index)
    return {
        "slip": float(element.largest(torque / unit)),
        "slip safety": float(element.largest(model.slip_safety(element.joint) * torque / unit)),
        "least preload": needs.least_preload * element.capacity,
        **element.ends(needs.bolt_utilisation),
        **_vdi_binding_preloads(model.verifications[index]),
    }


def _vdi_binding_preloads(steps: Verification | None) -> dict[str, float]:
    """Return the lower and upper preload at which a step of VDI 2230 is active [N]."""
    if steps is None:
        return {}
    found = {}
    if steps.loads.has_force_or_tilting:
        opening = float(steps.clamp_against_opening.max())
        governs = opening >= float(steps.clamp_needed.max())
        found["one-sided opening" if governs else "slip under the whole load"] = steps.least_preload
    above = {row.kind: row.utilisation for row in vdi_rows(steps, steps.largest_preload)}
    kinds = ("working stress", "head pressure in service", "alternating stress")
    found[max(kinds, key=lambda kind: above.get(kind, 0.0))] = steps.largest_preload
    return found


def _stiffness_binding_preloads(
    model: PreloadModel,
    preloads: np.ndarray,
    index: int,
    forces: np.ndarray,
    stiffness: np.ndarray,
) -> dict[str, float]:
    """Return the least preload for joint stiffness and tool deflection, within `forces` [N]."""
    needs, found = model.problem.requirements, {}
    needed = needs.joint_stiffness.get(model.elements[index].joint)
    if needed is not None and stiffness.min() < needed <= stiffness.max():
        found["joint stiffness"] = _first_crossing(stiffness, forces, needed)
    if needs.tool_deflection is not None:
        sizes = [
            np.nanmax(np.linalg.norm(model.exact_deflection(each), axis=1))
            for each in (model.replaced(preloads, index, force) for force in forces)
        ]
        compliant = -np.array(sizes)
        if compliant.min() < -needs.tool_deflection <= compliant.max():
            found["tool deflection"] = _first_crossing(compliant, forces, -needs.tool_deflection)
    return found


def _first_crossing(values: np.ndarray, forces: np.ndarray, level: float) -> float:
    """Return the first force at which increasing values reach a level, by interpolation [N]."""
    after = int(np.argmax(values >= level))
    low, high = values[after - 1], values[after]
    if not np.isfinite(low):
        return float(forces[after])
    share = (level - low) / (high - low)
    return float(forces[after - 1] + share * (forces[after] - forces[after - 1]))


def _stiffness_curve(
    model: PreloadModel, preloads: np.ndarray, index: int, torque: float, forces: np.ndarray
) -> np.ndarray:
    joint, at = model.elements[index].joint, np.array([torque])
    compliance = [
        float(model.exact_compliance(model.replaced(preloads, index, force), joint, at)[0])
        for force in forces
    ]
    return np.asarray(1.0 / np.array(compliance))


def curve_rows(
    curves: Sequence[PreloadCurve],
) -> tuple[tuple[str, ...], list[tuple[str | float, ...]]]:
    """Return the table of curves, one row per preload.

    Returns (columns, rows): column names include units; nan for limits that an element does not
    have.
    """
    names = tuple(dict.fromkeys(name for curve in curves for name in curve.utilisation))
    symbols = tuple(dict.fromkeys(symbol for curve in curves for symbol in curve.safety))
    columns = (
        "element",
        "joint",
        "load case",
        "torque [N m]",
        "preload [N]",
        "stiffness [N m/rad]",
        "stiffness at largest preload [N m/rad]",
        "slip safety",
        *names,
        *symbols,
    )
    rows: list[tuple[str | float, ...]] = []
    for curve in curves:
        missing = np.full(len(curve.preload), np.nan)
        used = [curve.utilisation.get(name, missing) for name in names]
        used += [curve.safety.get(symbol, missing) for symbol in symbols]
        numbers = zip(
            curve.preload,
            curve.stiffness,
            curve.stiffness_high,
            curve.slip_safety,
            *used,
            strict=True,
        )
        head = (curve.key, curve.joint, curve.case, curve.torque)
        rows += [(*head, *(float(number) for number in line)) for line in numbers]
    return columns, rows
