"""Reasons of infeasibility: requirement, best reachable value, limiting condition, remedy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.fastening.utilisation import UtilisationRow
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.nlp import PreloadNlp
from stiffopt.preload.problem import FreeElement
from stiffopt.preload.utilisation import utilisation_rows


@dataclass(frozen=True)
class Stopper:
    """Requirement that no preload meets."""

    limit: str  # name of the requirement
    # Best reachable and required value, in `unit`.
    best: float
    required: float
    unit: str
    against: str  # limiting condition; "" if none
    remedy: str  # change of the design or study

    @classmethod
    def of_row(cls, row: UtilisationRow, against: str, remedy: str) -> Stopper:
        """Return the stopper of an exceeded row."""
        return cls(row.name, row.value, row.limit, row.unit, against, remedy)

    def __str__(self) -> str:
        required, best = self.amounts
        stop = f" Limited by: {self.against}." if self.against else ""
        return (
            f"{self.limit[:1].upper()}{self.limit[1:]}: required {required}, best reachable "
            f"{best}.{stop} To change: {self.remedy}."
        )

    @property
    def amounts(self) -> tuple[str, str]:
        """Required and best value with unit, with enough digits to differ.

        A slip safety of zero or less means no clamp force.
        """
        if not self.unit and self.best <= 0.0:
            return _format_significant(self.required, 4), "0, as it opens"
        factor, unit = _DISPLAY_UNITS.get(self.unit, (1.0, self.unit))
        for digits in range(4, 10):
            required = f"{_format_significant(factor * self.required, digits)} {unit}".rstrip()
            best = f"{_format_significant(factor * self.best, digits)} {unit}".rstrip()
            if required != best:
                break
        return required, best


# Display units in place of SI, with their factor.
_DISPLAY_UNITS = {"m": (1e3, "mm"), "Pa": (1e-6, "MPa")}


def _format_significant(value: float, digits: int) -> str:
    """Return significant digits, without an exponent below 1e9."""
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e9 else text


def find_stoppers(nlp: PreloadNlp) -> tuple[Stopper, ...]:
    """Return requirements that no preload within the limits can meet.

    First rows independent of the preload, then slip and least preload, then stiffness at the
    largest preloads. Empty if each requirement alone can be met.
    """
    model = nlp.model
    _, upper = nlp.bounds()
    fixed = {
        limit.name for e in model.elements for limit in e.limits if not limit.depends_on_preload
    }
    found = [
        Stopper.of_row(row, "", f"{row.remedy}; no preload changes this")
        for row in _worst_by_owner(model, upper, ("key pressure", *fixed))
    ]
    for index, element in enumerate(model.elements):
        stop = _slip_stopper(model, upper, index, element)
        if stop is not None:
            found.append(stop)
        else:
            found += _service_stoppers(model, upper, index)
    found += [
        _floor_stopper(model, row) for row in _worst_by_owner(model, upper, ("least preload",))
    ]
    if not found:
        found = [
            _stiffness_stopper(model, row, upper)
            for row in _worst_by_owner(model, upper, ("joint stiffness",))
        ]
    return tuple(found)


def _worst_by_owner(
    model: PreloadModel, preloads: np.ndarray, kinds: tuple[str, ...]
) -> list[UtilisationRow]:
    """Return exceeded rows of some kinds, the worst load case of each owner."""
    worst: dict[tuple[str, str, int | None], UtilisationRow] = {}
    for row in utilisation_rows(model, preloads):
        owner = (row.kind, row.element, row.joint)
        if row.kind not in kinds or row.satisfied:
            continue
        if owner not in worst or row.utilisation > worst[owner].utilisation:
            worst[owner] = row
    return list(worst.values())


def _floor_stopper(model: PreloadModel, row: UtilisationRow) -> Stopper:
    """Return the stopper of a least preload above the permissible one."""
    element = next(e for e in model.elements if e.key == row.element)
    return Stopper.of_row(
        row,
        describe_limit(element, model.problem.requirements.bolt_utilisation),
        "a smaller require.least_preload or a larger require.bolt_utilisation",
    )


def describe_limit(element: FreeElement, bolt_utilisation: float) -> str:
    """Return the name of the limit on an element's preload, with that preload."""
    ends = element.ends(bolt_utilisation)
    name = min(ends, key=lambda each: ends[each])
    return f"{name} of {element.key} (at most {ends[name]:.0f} N)"


def _slip_stopper(
    model: PreloadModel, upper: np.ndarray, index: int, element: FreeElement
) -> Stopper | None:
    needs, safety = model.problem.requirements, model.slip_safety(element.joint)
    slip = float(model.slip_torque(upper, index))
    case = max(model.cases, key=lambda c: abs(float(c.torque[element.joint - 1])))
    torque = abs(float(case.torque[element.joint - 1]))
    if slip >= safety * torque * (1.0 - 1e-12):
        return None
    ends = element.ends(needs.bolt_utilisation)
    stronger = "a larger bolt or a higher grade"
    if min(ends, key=lambda each: ends[each]) == "head pressure":
        # A higher grade does not lower the surface pressure.
        stronger = "hard washers (`washer = true`), a harder part under the heads or a larger bolt"
    return Stopper(
        limit=f"slip safety, {element.key}, {case.name}",
        best=slip / torque,
        required=safety,
        unit="",
        against=describe_limit(element, needs.bolt_utilisation),
        remedy=(
            f"{stronger}, more bolts, more friction, or less scatter"
            if isinstance(element.stage.element, BoltedFlange)
            else "a larger set screw, more pins, a thicker shaft, more friction, or less scatter"
        ),
    )


def _service_stoppers(model: PreloadModel, upper: np.ndarray, index: int) -> list[Stopper]:
    """Return the steps of VDI 2230 that fail at the largest preload."""
    element = model.elements[index]
    bound = model.problem.requirements.bolt_utilisation
    return [
        Stopper.of_row(row, describe_limit(element, bound), row.remedy)
        for row in model.vdi_rows(upper, index)
        if row.binding and not row.satisfied
    ]


def _stiffness_stopper(model: PreloadModel, row: UtilisationRow, upper: np.ndarray) -> Stopper:
    """Return the stopper of a stiffness above that at the largest preloads."""
    assert row.joint is not None
    case = next(c for c in model.cases if c.name == row.case)
    chain = model.problem.robot.chains[row.joint - 1]
    assert chain is not None
    torques = np.array([case.torque[row.joint - 1]])
    whole = float(model.exact_compliance(upper, row.joint, torques)[0])
    share = 1.0 - float(model.rest_compliance(row.joint, torques)[0]) / whole
    ends = [
        describe_limit(e, model.problem.requirements.bolt_utilisation)
        for e in model.elements
        if e.joint == row.joint
    ]
    return Stopper.of_row(
        row,
        " and ".join(ends) if ends else "no preload of this joint is free",
        f"the preloaded connections have {100 * share:.1f} % of the compliance, so larger bolts "
        "gain at most that; beyond it a stiffer reducer, stiffer elements, or a lower requirement",
    )
