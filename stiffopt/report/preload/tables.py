"""Tables of a preload report: each a head and rows of ready text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.report.common.motions import robot_joint_units
from stiffopt.report.common.quantities import engineering, percent, significant
from stiffopt.report.preload.inputs import EstimateMarks
from stiffopt.report.preload.names import change, fasteners, present_preload, spoken
from stiffopt.report.preload.wording import sets
from stiffopt.report.solve.tables import DASH, Table

if TYPE_CHECKING:
    from stiffopt.preload.loosening import Loosened, Loosening
    from stiffopt.preload.problem import PreloadProblem
    from stiffopt.preload.sensitivity import PreloadWorth, Sensitivity, WindupShare
    from stiffopt.preload.solution import PreloadSolution


def recommended_table(problem: PreloadProblem, solution: PreloadSolution) -> Table:
    """What the workshop needs: fasteners, preloads, torque with its band, present preload."""
    rows: list[tuple[str, ...]] = []
    slack: set[int] = set()
    marks = EstimateMarks(problem)
    for element in problem.elements:
        largest = solution.preloads[element.key]
        least = float(element.least(largest, problem.tightening.alpha))
        torque = solution.tightening[element.key]
        if least <= 0.0:
            slack.add(len(rows))
        present = present_preload(element)
        rows.append(
            (
                spoken(element.key),
                fasteners(element),
                DASH if torque is None else f"{significant(torque.nominal, 3)} N m",
                DASH if torque is None else f"{significant(torque.lower, 3)} N m",
                DASH if torque is None else f"{torque.friction_factor:.2f}",
                f"{significant(largest / 1e3, 3)} kN",
                f"{significant(least / 1e3, 3)} kN",
                f"{significant(present / 1e3, 3)} kN" + marks.of(element, "preload"),
                sets(solution, element.key, element.joint),
            )
        )
    head = (
        "connection",
        "fasteners",
        "tighten to",
        "not below",
        "friction reserve",
        "largest preload",
        "least preload",
        "present preload",
        "bound by",
    )
    return Table(head, tuple(rows), frozenset(slack))


def individual_table(problem: PreloadProblem, solution: PreloadSolution) -> Table | None:
    """Preload of every single bolt or pin; None where each connection has one for all."""
    if not solution.individual:
        return None
    rows = tuple(
        (
            spoken(element.key),
            ", ".join(significant(f / 1e3, 4) for f in solution.individual[element.key]),
        )
        for element in problem.elements
    )
    return Table(("connection", "preload of each bolt or pin [kN]"), rows)


def stiffness_table(problem: PreloadProblem, solution: PreloadSolution) -> Table:
    """Stiffness of every joint in its softest load case, with present and recommended preload."""
    units = robot_joint_units(problem.robot)
    rows: list[tuple[str, ...]] = []
    bad: set[int] = set()
    for index, joint in enumerate(problem.joints):
        after, before = solution.stiffness[index], solution.stiffness_before[index]
        at = int(np.argmin(after))
        needed = problem.requirements.joint_stiffness.get(joint)
        unit = units[joint - 1].stiffness
        old, new = float(before.min()), float(after.min())
        if new <= 0.0:
            bad.add(len(rows))
        rows.append(
            (
                f"joint {joint}",
                solution.cases[at].name,
                f"{significant(old)} {unit}" if old > 0.0 else "slips",
                f"{significant(new)} {unit}" if new > 0.0 else "slips",
                change(new / old) if old > 0.0 and new > 0.0 else DASH,
                DASH if needed is None else f"{significant(needed)} {unit}",
            )
        )
    head = ("joint", "softest at", "present preload", _here(solution), "change", "required")
    shown = len(head) if problem.requirements.joint_stiffness else len(head) - 1
    return Table(head[:shown], tuple(row[:shown] for row in rows), frozenset(bad))


def _here(solution: PreloadSolution) -> str:
    """Name of the design on the page."""
    return "recommended" if solution.status.usable else "nearest design"


def deflection_table(solution: PreloadSolution) -> Table | None:
    """Tool deflection of the load cases with a pose; None where there is none."""
    rows = []
    for case, old, new in zip(
        solution.cases, solution.deflection_before, solution.deflection, strict=True
    ):
        if case.jacobian is None:
            continue
        before = engineering(float(old), "m") if np.isfinite(old) else "slips"
        after = engineering(float(new), "m") if np.isfinite(new) else "slips"
        both = np.isfinite(old) and np.isfinite(new) and old > 0.0
        rows.append((case.name, before, after, change(float(new / old)) if both else DASH))
    head = ("load case", "present preload", _here(solution), "change")
    return Table(head, tuple(rows)) if rows else None


def loosening_table(result: Loosening) -> Table:
    """Slip safety and stiffness lost of each connection as it works loose."""
    fractions = sorted({row.fraction for row in result.rows}, reverse=True)
    worst: dict[tuple[str, float], Loosened] = {}
    for row in result.rows:
        at = (row.key, row.fraction)
        if at not in worst or row.slip_safety < worst[at].slip_safety:
            worst[at] = row
    head = ["connection", "rim slips below", "all of it slips below"]
    head += [f"{100 * fraction:g} % left" for fraction in fractions]
    rows = []
    for key, slip in result.slip_fraction.items():
        cells = [spoken(key), _share_left(result.first_slip_fraction[key]), _share_left(slip)]
        cells += [_loosened(worst[key, fraction]) for fraction in fractions]
        rows.append(tuple(cells))
    return Table(tuple(head), tuple(rows))


def _share_left(fraction: float) -> str:
    return "when tight" if fraction > 1.0 else percent(fraction, 2)


def _loosened(row: Loosened) -> str:
    if not np.isfinite(row.slip_safety):
        return "no load"
    safety = f"{row.slip_safety:.2f}"
    if row.slips:
        return f"{safety}, slips"
    # Against a joint that slips when tight nothing is lost.
    lost = f"{100 * row.lost:.1f} %" if row.lost >= 5e-4 else "none"
    return f"{safety}, {lost}{', rim slips' if row.first_slip else ''}"


def worth_table(result: Sensitivity, problem: PreloadProblem) -> Table:
    """Stiffness that one more kilonewton in every bolt or pin is worth, where it is worth most."""
    best: dict[str, PreloadWorth] = {}
    for each in result.worth:
        if each.key not in best or each.elasticity > best[each.key].elasticity:
            best[each.key] = each
    units = robot_joint_units(problem.robot)
    rows = tuple(
        (
            spoken(key),
            each.case,
            f"{significant(1e3 * each.slope, 3)} {units[each.joint - 1].stiffness} per kN",
            f"{significant(10 * each.elasticity, 2)} %",
        )
        for key, each in best.items()
    )
    return Table(
        ("connection", "load case", "one more kN is worth", "10 % more preload gains"), rows
    )


def shares_by_joint(
    result: Sensitivity, problem: PreloadProblem, solution: PreloadSolution
) -> Mapping[int, list[WindupShare]]:
    """Wind-up shares of each joint in the load case of its largest torque."""
    found = {}
    for joint in problem.joints:
        torques = [abs(float(case.torque[joint - 1])) for case in solution.cases]
        case = solution.cases[int(np.argmax(torques))].name
        found[joint] = [s for s in result.shares if s.joint == joint and s.case == case]
    return found
