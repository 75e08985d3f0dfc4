"""Summaries of a preload study for its page: worst cases by requirement, joint and connection."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from stiffopt.fastening.utilisation import UtilisationRow
from stiffopt.preload.bolt_sheet import BoltSheet
from stiffopt.preload.problem import FreeElement, PreloadProblem
from stiffopt.preload.sensitivity import (
    LoosenedConnection,
    Loosening,
    PreloadWorth,
    Sensitivity,
    WindupShare,
)
from stiffopt.preload.solution import PreloadSolution
from stiffopt.report.common.robot import EstimatedInputs, estimated_inputs
from stiffopt.report.common.text import MAX_LISTED
from stiffopt.report.preload.words import MARK, owner_name, readable

Item = TypeVar("Item")
_KEY_PRESSURE = "key pressure"


@dataclass(frozen=True)
class UtilisationMatrix:
    """Utilisation of every requirement by owner and kind, each in its worst load case."""

    kinds: tuple[str, ...]
    rows: Mapping[str, tuple[UtilisationRow | None, ...]]  # by owner: one cell per kind


@dataclass(frozen=True)
class LimitSource:
    """Source of the limit of a kind of requirement, and the elements it applies to."""

    kind: str
    estimated: bool
    source: str
    owners: tuple[str, ...]


@dataclass(frozen=True)
class StiffnessChange:
    """Stiffness of a joint [N m/rad], least over the load cases; 0 where it slips."""

    joint: int  # from 1
    case: str  # load case of least stiffness of the design
    # Stiffness with the present preload and with the design.
    before: float
    after: float
    required: float | None


def _largest_by_owner(
    items: Iterable[Item], owner: Callable[[Item], Hashable], size: Callable[[Item], float]
) -> dict[Hashable, Item]:
    """Return the largest item of each owner, the first among equals."""
    worst: dict[Hashable, Item] = {}
    for each in items:
        if owner(each) not in worst or size(each) > size(worst[owner(each)]):
            worst[owner(each)] = each
    return worst


def _row_utilisation(row: UtilisationRow) -> float:
    return row.utilisation


def _worst_cases(rows: Iterable[UtilisationRow]) -> list[UtilisationRow]:
    return list(
        _largest_by_owner(
            rows, lambda row: (row.kind, row.element, row.joint), _row_utilisation
        ).values()
    )


def most_used(rows: Sequence[UtilisationRow]) -> list[UtilisationRow]:
    """Return the requirements with the highest utilisation, in descending order.

    The worst load case of each kind and owner; where these are too many, the worst owner of each
    kind. Warnings are not included: `cautions` returns those that are exceeded.
    """
    shown = _worst_cases(row for row in rows if row.binding)
    if len(shown) > MAX_LISTED:
        shown = list(_largest_by_owner(rows, lambda row: row.kind, _row_utilisation).values())
    return sorted(shown, key=lambda row: -row.utilisation)


def utilisation_matrix(rows: Sequence[UtilisationRow]) -> UtilisationMatrix | None:
    """Return a matrix of utilisations where there are too many for a list, else None.

    Keys have only one requirement and are represented by the worst of them.
    """
    worst = _worst_cases(rows)
    if len(worst) <= MAX_LISTED:
        return None
    # Steps of VDI 2230 with low utilisation, and warnings, are in the full list only.
    largest = {k: max(r.utilisation for r in worst if r.kind == k) for k in {r.kind for r in worst}}
    # Least utilisation in any connection for which a kind of requirement has a column there.
    worst = [row for row in worst if row.binding and (not row.equation or largest[row.kind] >= 0.2)]
    kinds = tuple(dict.fromkeys(row.kind for row in worst))
    keys = [row for row in worst if row.kind == _KEY_PRESSURE]
    if keys:
        most = max(keys, key=_row_utilisation)
        worst = [row for row in worst if row.kind != _KEY_PRESSURE or row is most]
    cells: dict[str, dict[str, UtilisationRow]] = {}
    for row in worst:
        name = owner_name(row)
        if row.kind == _KEY_PRESSURE and len(keys) > 1:
            name = f"{name}, worst of {len(keys)} keys"
        cells.setdefault(name, {})[row.kind] = row
    rows_of = {name: tuple(own.get(kind) for kind in kinds) for name, own in cells.items()}
    return UtilisationMatrix(kinds, rows_of)


def shown_sheets(
    sheets: Sequence[BoltSheet], solution: PreloadSolution, most: int = 6
) -> list[BoltSheet]:
    """Return the flanges to draw: all, or the `most` with the highest utilisation of bolts."""
    if len(sheets) <= most:
        return list(sheets)
    steps = [row for row in solution.rows if row.equation and row.binding]
    used = {s.key: max(r.utilisation for r in steps if r.element == s.key) for s in sheets}
    kept = sorted(used, key=lambda key: -used[key])[:most]
    return [sheet for sheet in sheets if sheet.key in kept]


def vdi_steps(rows: Sequence[UtilisationRow]) -> dict[str, list[UtilisationRow]]:
    """Return the steps of VDI 2230 by connection, in order, each in its worst load case."""
    steps = _largest_by_owner(
        [row for row in rows if row.equation], lambda row: (row.element, row.kind), _row_utilisation
    ).values()
    found: dict[str, list[UtilisationRow]] = {}
    for row in sorted(steps, key=lambda row: _step_order(row.equation)):
        found.setdefault(row.element, []).append(row)
    return found


def _step_order(equation: str) -> tuple[int, str]:
    """Return a sort key for steps: R2/3 before R10/1, steps without number last."""
    number = re.match(r"R(\d+)", equation)
    return (int(number[1]) if number else 99, equation)


def limit_sources(rows: Sequence[UtilisationRow]) -> list[LimitSource]:
    """Return the sources of every kind of limit."""
    owners: dict[tuple[str, bool, str], dict[str, None]] = {}
    for row in rows:
        if row.source:
            where = (row.kind, row.provenance == "estimated", row.source)
            owners.setdefault(where, {})[owner_name(row)] = None
    return [LimitSource(*where, tuple(names)) for where, names in owners.items()]


def stiffness_changes(problem: PreloadProblem, solution: PreloadSolution) -> list[StiffnessChange]:
    """Return the least stiffness of every joint, with present and with recommended preload."""
    return [
        StiffnessChange(
            joint=joint,
            case=solution.cases[int(np.argmin(solution.stiffness[index]))].name,
            before=float(solution.stiffness_before[index].min()),
            after=float(solution.stiffness[index].min()),
            required=problem.requirements.joint_stiffness.get(joint),
        )
        for index, joint in enumerate(problem.joints)
    ]


def loosened_connections(result: Loosening) -> dict[str, list[LoosenedConnection]]:
    """Return the least slip safety of each connection by remaining preload, in descending order."""
    worst = _largest_by_owner(result.rows, lambda r: (r.key, r.fraction), lambda r: -r.slip_safety)
    fractions = sorted({row.fraction for row in result.rows}, reverse=True)
    return {key: [worst[key, fraction] for fraction in fractions] for key in result.slip_fraction}


def preload_worth(result: Sensitivity) -> list[PreloadWorth]:
    """Return for each connection the load case in which preload gains most stiffness."""
    return list(_largest_by_owner(result.worth, lambda w: w.key, lambda w: w.elasticity).values())


def shares_by_joint(
    result: Sensitivity, problem: PreloadProblem, solution: PreloadSolution
) -> Mapping[int, list[WindupShare]]:
    """Return the wind-up shares of each joint in the load case of its largest torque."""
    found = {}
    for joint in problem.joints:
        torques = [abs(float(case.torque[joint - 1])) for case in solution.cases]
        case = solution.cases[int(np.argmax(torques))].name
        found[joint] = [s for s in result.shares if s.joint == joint and s.case == case]
    return found


def study_estimates(problem: PreloadProblem) -> list[EstimatedInputs]:
    """Return estimated inputs of the study's joints and of the whole robot, keys in words."""
    names = {problem.robot.joint_names[joint - 1] for joint in problem.joints}
    return [
        replace(
            each,
            joint=readable(each.joint),
            element=readable(each.element),
            inputs=tuple(map(readable, each.inputs)),
        )
        for each in estimated_inputs(problem.robot, names)
    ]


class EstimateMarks:
    """Marks of numbers that the robot file declares as estimated."""

    def __init__(self, problem: PreloadProblem) -> None:
        self._names = problem.robot.joint_names
        self._keys: dict[tuple[str, str], set[str]] = {}
        for each in problem.robot.estimated():
            own = self._keys.setdefault((each.joint, each.element), set())
            own.update(key.strip() for key in each.key.split(","))

    def of(self, element: FreeElement, *keys: str) -> str:
        """Return the mark where one of these keys of an element is estimated, else ""."""
        own = self._keys.get((self._names[element.joint - 1], element.name), set())
        return MARK if own.intersection(keys) else ""
