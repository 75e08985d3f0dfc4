"""Tables of a catalogue search: best torque for all bolts, reasons of infeasibility."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.preload.catalogue_designs import SLIP, CatalogueDesign
from stiffopt.preload.catalogue_programme import ChoiceProgramme
from stiffopt.preload.infeasibility import Stopper
from stiffopt.preload.model import PreloadModel

Designs = Sequence[Sequence[CatalogueDesign]]


@dataclass(frozen=True, kw_only=True)
class TableRow:
    """Best torque for one kind of bolts of one element, all other elements as chosen."""

    design: CatalogueDesign  # with the best feasible torque, or the one nearest to its limits
    objective: float  # of the study with this design, in its unit; nan without any choice
    stopper: str  # limit or requirement that excludes all torques; "" if feasible
    utilisation: float  # largest utilisation of this connection [-]
    torques: int  # number of torques tried for these bolts
    chosen: bool


def best_torques(
    model: PreloadModel,
    designs: Designs,
    programme: ChoiceProgramme | None,
    picks: tuple[int, ...] | None,
) -> tuple[TableRow, ...]:
    """Return the best torque for every kind of bolts.

    `designs`: feasible or not. `programme`: of the feasible designs; None if an element has none.
    `picks`: chosen design of each element among its feasible ones; None without a choice.
    """
    found = []
    for index, own in enumerate(designs):
        kept = [d for d in own if d.feasible]
        chosen = None if picks is None else kept[picks[index]]
        for bolts in dict.fromkeys(d.bolts for d in own):
            kind = [d for d in own if d.bolts == bolts]
            best, objective, stopper = _nearest_design(kind), float("nan"), None
            if programme is not None and picks is not None and any(d.feasible for d in kind):
                swaps = [
                    (*_swap_design(model, programme, picks, index, kept.index(d)), d)
                    for d in kind
                    if d.feasible
                ]
                _, objective, stopper, best = _best_swap(swaps, chosen)
            found.append(
                TableRow(
                    design=best,
                    objective=objective,
                    stopper=best.stopper if stopper is None else stopper,
                    utilisation=max(best.utilisations.values()),
                    torques=len(kind),
                    chosen=best is chosen,
                )
            )
    return tuple(found)


# Level to minimise, objective of the study, row exceeded most or "", design.
_Swap = tuple[float, float, str, CatalogueDesign]


def _best_swap(swaps: Sequence[_Swap], chosen: CatalogueDesign | None) -> _Swap:
    """Return the chosen design, else the best feasible, else the stiffest: nearest to the rows."""
    able = [swap for swap in swaps if not swap[2]]
    if not able:
        return max(swaps, key=lambda swap: swap[3].preload)
    best = min(able, key=lambda swap: swap[0])
    return next((swap for swap in able if swap[3] is chosen), best)


def _swap_design(
    model: PreloadModel,
    programme: ChoiceProgramme,
    picks: tuple[int, ...],
    index: int,
    position: int,
) -> tuple[float, float, str]:
    """Return level, objective and exceeded row of the choice with one element's design replaced."""
    swapped = (*picks[:index], position, *picks[index + 1 :])
    amounts = programme.amounts(swapped)
    over = np.where(amounts > programme.ends, amounts / programme.cap, 0.0)
    stopper = programme.names[int(np.argmax(over))] if over.any() else ""
    peaked = amounts * programme.weight
    if model.problem.objective == "total_preload":
        total = float(sum(c[i] for c, i in zip(programme.cost, swapped, strict=True)))
        return total, total, stopper
    if model.problem.objective == "joint_stiffness":
        own = [joint == model.elements[index].joint for joint in programme.joints]
        least = float((1.0 / amounts[programme.weight > 0.0]).min())
        return float(peaked[own].max()), least, stopper
    return float(peaked.max()), float(peaked.max()), stopper


def _nearest_design(designs: Sequence[CatalogueDesign]) -> CatalogueDesign:
    """Return the feasible design of least preload, or that with the fewest limits exceeded."""
    feasible = [d for d in designs if d.feasible]
    if feasible:
        return min(feasible, key=lambda d: d.total_preload)
    return min(designs, key=lambda d: (len(d.exceeded), max(d.utilisations.values())))


def element_stoppers(model: PreloadModel, designs: Designs) -> tuple[Stopper, ...]:
    """Return elements without a feasible design, with the limit of the nearest one."""
    found = []
    for own in designs:
        if any(d.feasible for d in own):
            continue
        nearest = _nearest_design(own)
        name = nearest.stopper
        used = nearest.utilisations[name]
        slips = name == SLIP
        safety = model.slip_safety(nearest.joint)
        found.append(
            Stopper(
                limit=f"{name}, {nearest.key}",
                best=safety / used if slips else used,
                required=safety if slips else 1.0,
                unit="",
                against=f"the nearest of {len(own)} catalogue designs is {nearest.label}",
                remedy=f"{nearest.remedies[name]}, or more sizes, grades or counts in [choose]",
            )
        )
    return tuple(found)


def requirement_stoppers(programme: ChoiceProgramme, found: tuple[str, ...]) -> tuple[Stopper, ...]:
    """Return requirements that no combination meets, with the best reachable value.

    `found`: rows exceeded by the nearest combination, the largest excess first.
    """
    least = programme.least_amounts()
    alone = [i for i in range(len(programme.names)) if least[i] > programme.ends[i]]
    together = [programme.names.index(name) for name in found[:3]]
    worst: dict[str, int] = {}
    for i in alone or together:
        owner = programme.names[i].rsplit(",", 1)[0]
        if (
            owner not in worst
            or least[i] / programme.cap[i] > least[worst[owner]] / programme.cap[worst[owner]]
        ):
            worst[owner] = i
    against = (
        "the stiffest catalogue designs together reach no more"
        if alone
        else "it can be met alone, but not with the other requirements"
    )
    return tuple(
        _requirement_stopper(programme, i, float(least[i]), against) for i in worst.values()
    )


def _requirement_stopper(
    programme: ChoiceProgramme, row: int, least: float, against: str
) -> Stopper:
    fixed = np.concatenate([programme.base, np.linalg.norm(programme.rest, axis=1)])[row]
    share = max(1.0 - float(fixed) / least, 0.0) if least > 0.0 else 0.0
    remedy = (
        f"larger, more or better bolts in [choose] gain at most {100 * share:.1f} %, the share of "
        "the connections in the compliance; beyond it stiffer reducers, less load, or a lower "
        "requirement"
    )
    cap, name = float(programme.cap[row]), programme.names[row]
    if programme.joints[row] is None:
        return Stopper(name, least, cap, "m", against, remedy)
    return Stopper(name, 1.0 / least, 1.0 / cap, "N m/rad", against, remedy)
