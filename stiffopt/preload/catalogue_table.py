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
    rows = []
    for index, own in enumerate(designs):
        kept = [d for d in own if d.feasible]
        for bolts in dict.fromkeys(d.bolts for d in own):
            kind = [d for d in own if d.bolts == bolts]
            if programme is None or picks is None:
                rows.append(_limit_row(kind))
                continue
            swaps = [
                (_SwappedDesign(model, programme, picks, index, kept.index(d)), d)
                for d in kind
                if d.feasible
            ]
            rows.append(_study_row(kind, swaps, kept[picks[index]]))
    return tuple(rows)


class _SwappedDesign:
    """Chosen combination with the design of one element replaced."""

    def __init__(
        self,
        model: PreloadModel,
        programme: ChoiceProgramme,
        picks: tuple[int, ...],
        index: int,
        position: int,
    ) -> None:
        swapped = (*picks[:index], position, *picks[index + 1 :])
        amounts = programme.amounts(swapped)
        over = np.where(amounts > programme.ends, amounts / programme.cap, 0.0)
        self.stopper = programme.names[int(np.argmax(over))] if over.any() else ""
        peaked = amounts * programme.weight
        if model.problem.objective == "total_preload":
            total = sum(c[i] for c, i in zip(programme.cost, swapped, strict=True))
            self.value = self.level = float(total)
        elif model.problem.objective == "joint_stiffness":
            own = [joint == model.elements[index].joint for joint in programme.joints]
            self.level = float(peaked[own].max())
            self.value = float((1.0 / amounts[programme.weight > 0.0]).min())
        else:
            self.value = self.level = float(peaked.max())


def _study_row(
    kind: Sequence[CatalogueDesign],
    swaps: Sequence[tuple[_SwappedDesign, CatalogueDesign]],
    chosen: CatalogueDesign,
) -> TableRow:
    able = [(swap, d) for swap, d in swaps if not swap.stopper]
    if not able and not swaps:
        return _limit_row(kind)
    # If none is feasible, the stiffest is nearest to the requirements.
    swap, design = (
        min(able, key=lambda each: each[0].level)
        if able
        else max(swaps, key=lambda each: each[1].preload)
    )
    if any(d is chosen for _, d in able):
        swap, design = next(each for each in able if each[1] is chosen)
    return TableRow(
        design=design,
        objective=swap.value,
        stopper=swap.stopper,
        utilisation=max(design.utilisations.values()),
        torques=len(kind),
        chosen=design is chosen,
    )


def _limit_row(kind: Sequence[CatalogueDesign]) -> TableRow:
    nearest = _nearest_design(kind)
    return TableRow(
        design=nearest,
        objective=float("nan"),
        stopper=nearest.stopper,
        utilisation=max(nearest.utilisations.values()),
        torques=len(kind),
        chosen=False,
    )


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
                remedy=f"{nearest.remedy(name)}, or more sizes, grades or counts in [choose]",
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
