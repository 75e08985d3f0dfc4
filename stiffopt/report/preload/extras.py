"""Parts of a preload report that not every study has: catalogue choice and joint study."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.preload.problem import OBJECTIVES
from stiffopt.report.common.quantities import engineering, percent, significant
from stiffopt.report.preload.names import prose, quantity, spoken
from stiffopt.report.solve.tables import DASH, Table

if TYPE_CHECKING:
    from stiffopt.preload.catalogue_choice import CatalogueChoice, SearchProof
    from stiffopt.preload.catalogue_designs import CatalogueDesign
    from stiffopt.preload.catalogue_table import TableRow
    from stiffopt.preload.motion_result import MotionStudy
    from stiffopt.preload.problem import PreloadProblem


@dataclass(frozen=True)
class ChoiceSection:
    """Catalogue choice as a page shows it.

    Parameters
    ----------
    message : str
        Where there is no best design; else empty.
    designs : Table or None
        What to take; None where the catalogue has nothing.
    gap : str
        Distance from the best real numbers.
    proof : str
        Account of the search in words.
    account : Table
        The same in numbers, which add up.
    every : Table
        Best torque for all bolts of each connection.
    """

    message: str
    designs: Table | None
    gap: str
    proof: str
    account: Table
    every: Table


def choice_section(problem: PreloadProblem, choice: CatalogueChoice) -> ChoiceSection:
    """Catalogue choice of a study in words and tables."""
    return ChoiceSection(
        message="" if choice.status.usable else prose(choice.message),
        designs=_designs(choice) if choice.designs else None,
        gap=_gap(problem, choice),
        proof=_proof(choice.proof),
        account=_account(choice.proof),
        every=_every(problem, choice),
    )


def _designs(choice: CatalogueChoice) -> Table:
    rows = tuple(
        (
            spoken(key),
            _bolts(design),
            f"{significant(design.torque)} N m",
            quantity(design.preload, "N", 3),
            quantity(design.least_preload, "N", 3),
            _most_used(design),
        )
        for key, design in choice.designs.items()
    )
    head = (
        "connection",
        "fasteners",
        "tighten to",
        "largest preload",
        "least preload",
        "used most",
    )
    return Table(head, rows)


def _bolts(design: CatalogueDesign) -> str:
    kind = design.grade or "set screw"
    return f"{design.count} × {design.size} {kind}"


def _most_used(design: CatalogueDesign) -> str:
    name = max(design.utilisations, key=lambda each: design.utilisations[each])
    return f"{name}, {percent(design.utilisations[name], 3)}"


def _gap(problem: PreloadProblem, choice: CatalogueChoice) -> str:
    if choice.continuous is None or not np.isfinite(choice.gap):
        return ""
    unit = OBJECTIVES[problem.objective]
    # A search cut short may have missed better standard torques.
    cost = f": standard torques cost {percent(choice.gap)}" if choice.proof.complete else ""
    return (
        f"With the same bolts and any torque instead of a standard one the aim would be "
        f"{_value(choice.continuous.objective, unit)} instead of "
        f"{_value(choice.objective, unit)}{cost}."
    )


def _value(value: float, unit: str) -> str:
    return quantity(value, unit) if np.isfinite(value) else DASH


def _proof(proof: SearchProof) -> str:
    excluded = sum(proof.excluded.values())
    text = (
        f"The catalogue has {_count(proof.combinations)} combinations for this study. Of these "
        f"{_count(excluded)} are excluded by a limit or a bound that holds for all of them, "
        f"the other {_count(proof.evaluated)} worked out one by one"
    )
    if proof.complete:
        return f"{text}: no better design is in the catalogue."
    return (
        f"{text}. {_count(proof.unvisited)} were left open as the search ended: a better design is "
        "not ruled out."
    )


def _account(proof: SearchProof) -> Table:
    ordered = sorted(proof.excluded.items(), key=lambda each: -each[1])
    rows = [(spoken(reason), _count(number)) for reason, number in ordered]
    rows.append(("worked out one by one", _count(proof.evaluated)))
    if proof.unvisited:
        rows.append(("left open", _count(proof.unvisited)))
    rows.append(("all combinations", _count(proof.combinations)))
    return Table(("excluded by", "combinations"), tuple(rows))


def _count(number: int) -> str:
    """Whole number with thin spaces; a power of ten where nobody would count the digits."""
    return f"{number:,}".replace(",", "\u202f") if number < 10**12 else f"{number:.2e}"


def _every(problem: PreloadProblem, choice: CatalogueChoice) -> Table:
    unit = OBJECTIVES[problem.objective]
    rows = tuple(
        (
            spoken(row.design.key),
            _bolts(row.design),
            f"{significant(row.design.torque)} N m",
            percent(row.utilisation, 3) if np.isfinite(row.utilisation) else "no hold",
            _value(row.objective, unit),
            _verdict(row),
        )
        for row in choice.table
    )
    head = (
        "connection",
        "fasteners",
        "best standard torque",
        "most used limit",
        "aim",
        "verdict",
    )
    return Table(head, rows)


def _verdict(row: TableRow) -> str:
    if row.chosen:
        return "chosen"
    return f"stopped by {spoken(row.stopper)}" if row.stopper else "possible"


@dataclass(frozen=True)
class MotionSection:
    """Joint study of preloads and motion as a page shows it."""

    note: str
    comparison: Table
    rounds: Table | None
    preloads: Table


def motion_section(problem: PreloadProblem, motion: MotionStudy) -> MotionSection:
    """Joint study in words and tables."""
    name = motion.objective_name.replace("_", " ")
    rows = (
        ("motion for the present preloads", engineering(motion.start, "m")),
        ("then preloads for that motion", engineering(motion.separate, "m")),
        ("both together", engineering(motion.joint, "m")),
        ("gain of doing both together", _gain(motion.gain)),
    )
    rounds = tuple(
        (
            str(number),
            engineering(each.deflection_before_preload, "m", 5),
            engineering(each.deflection_after, "m", 5),
        )
        for number, each in enumerate(motion.rounds, start=1)
    )
    head = ("round", "motion anew", "preloads anew")
    return MotionSection(
        note=prose(motion.note),
        comparison=Table(("", f"peak {name} of the tool"), rows),
        rounds=Table(head, rounds) if rounds else None,
        preloads=_motion_preloads(problem, motion),
    )


def _gain(gain: float) -> str:
    return percent(gain) if np.isfinite(gain) else DASH


def _motion_preloads(problem: PreloadProblem, motion: MotionStudy) -> Table:
    rows = tuple(
        (
            spoken(element.key),
            *(
                quantity(preloads[element.key], "N", 3) if element.key in preloads else DASH
                for preloads in (motion.start_preloads, motion.separate_preloads, motion.preloads)
            ),
        )
        for element in problem.elements
    )
    return Table(("connection", "at the start", "one after the other", "together"), rows)
