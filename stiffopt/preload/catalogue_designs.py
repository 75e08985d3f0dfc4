"""Catalogue designs of one connection: bolts that fit its ring, with their tightening torques.

The ring is fixed; bolts of another size, grade or number replace the present ones, and lengths not
given in the robot file scale with their diameter. Of set screws only the torque is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

from stiffopt.connection import Bolt, BoltedFlange, ClampingPins
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Stage
from stiffopt.fastening.limits import (
    fastener_count,
    preload_limits,
    preload_loss,
    scatter,
    workshop_torque,
)
from stiffopt.fastening.tightening import standard_torques
from stiffopt.fastening.utilisation import PreloadLimit
from stiffopt.fastening.vdi_rows import vdi_rows
from stiffopt.preload.flange_loads import slip_safety, verification
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.problem import Choice, FreeElement, PreloadProblem

SLIP, LEAST, EMBEDDING = "slip safety", "least preload", "embedding loss"
# Remedies of the limits that are no row of VDI 2230 and no limit of the fastener.
_CONNECTION_REMEDIES = {
    SLIP: "more friction, more or larger bolts, a larger circle, or less scatter",
    LEAST: "a smaller require.least_preload, or a smaller bolt",
    EMBEDDING: "a larger clamp length, a larger torque, or smoother faces",
}


@dataclass(frozen=True, kw_only=True)
class CatalogueDesign:
    """Bolts or pins of one connection with their tightening torque."""

    key: str
    joint: int  # 1-based
    # Of one bolt or set screw; no grade for screws.
    size: str
    grade: str
    count: int  # bolts or pins
    torque: float  # setting of the wrench [N m]
    # Largest and least preload of one bolt or pin [N].
    preload: float
    least_preload: float
    stage: Stage  # the connection with these bolts and `preload`
    limits: tuple[PreloadLimit, ...]
    # Of every limit of this connection, by name; above 1 if exceeded.
    utilisations: Mapping[str, float]
    remedies: Mapping[str, str]  # by name of the limit: change of the design that relaxes it
    cost: float = 0.0  # in steps (`Choice.cost`)
    circle: float | None = None  # bolt circle diameter [m], if the study varies it

    @property
    def label(self) -> str:
        """Such as "9 x M5 12.9, 8 N m"."""
        return f"{self.bolts}, {self.torque:g} N m"

    @property
    def bolts(self) -> str:
        """Such as "9 x M5 12.9", "9 x M5 12.9 with nuts and washers"."""
        held = self.stage.element
        bolt = held.bolt if isinstance(held, BoltedFlange) else None
        parts = (
            f"{self.count} x {self.size}",
            self.grade,
            "" if bolt is None else bolt.added,
            "" if self.circle is None else f"on {1e3 * self.circle:g} mm",
        )
        return " ".join(part for part in parts if part)

    @property
    def exceeded(self) -> tuple[str, ...]:
        """Names of exceeded limits."""
        # Largest utilisation of a feasible design [-], with rounding.
        return tuple(name for name, used in self.utilisations.items() if used > 1.0 + 1e-9)

    @property
    def stopper(self) -> str:
        """Name of the limit exceeded most; "" if none."""
        return max(self.exceeded, key=lambda name: self.utilisations[name], default="")

    @property
    def feasible(self) -> bool:
        """True if every limit of this connection holds."""
        return not self.stopper

    @property
    def total_preload(self) -> float:
        """Sum of the preloads of all bolts or pins [N]."""
        return self.count * self.preload

    @property
    def load(self) -> float:
        """Largest utilisation of a limit that depends on the preload [-]."""
        return max(
            (float(lim.utilisation(self.preload)) for lim in self.limits if lim.depends_on_preload),
            default=0.0,
        )


def catalogue_designs(
    problem: PreloadProblem, element: FreeElement, cases: tuple[LoadCase, ...]
) -> tuple[CatalogueDesign, ...]:
    """Return all designs of one element in the study's catalogue, feasible or not, small to large.

    Without torques in `choose`, and for pins, these are the R20 preferred numbers from the least
    required preload to the largest that any limit allows; none outside is feasible.
    """
    found: list[CatalogueDesign] = []
    for stage in _stage_variants(element.stage, problem.choose or Choice()):
        found += _designs_by_torque(problem, element, stage, cases)
    return tuple(found)


def _stage_variants(stage: Stage, choose: Choice) -> Iterator[Stage]:
    flange = stage.element
    if not isinstance(flange, BoltedFlange):
        yield stage
        return
    bolt = flange.bolt
    assert isinstance(bolt, Bolt)  # an element with limits has a bolt
    # Holes of a purchased part are fixed: other bolts must fit them.
    free = choose.redrill or not flange.fixed_pattern
    sizes = sorted(
        set((choose.sizes if free else ()) or (bolt.size,)),
        key=lambda size: catalogue.bolt(size).diameter,
    )
    grades = sorted(set(choose.grades or (bolt.grade,)), key=catalogue.bolt_grades().index)
    counts = sorted(set((choose.counts if free else ()) or (flange.bolt_count,)))
    circles = sorted(set((choose.circles if free else ()) or (flange.circle_diameter,)))
    washers = (False, True) if choose.washers else (bolt.washer,)
    # Tapped holes of a purchased part cannot become through holes.
    nuts = (False, True) if choose.nuts and free else (bolt.nut,)
    for size, grade, count, circle, washer, nut in product(
        sizes, grades, counts, circles, washers, nuts
    ):
        held = replace(bolt, size=size, grade=grade, washer=washer, nut=nut)
        if size != bolt.size:
            # Shank dimensions are those of the former size.
            held = replace(held, shank_diameter=None, shank_length=None)
        if nut:
            held = replace(held, engagement=None)
        if not catalogue.bolt_grade(grade).heat_treated:
            held = replace(held, rolled="before")
        changed = replace(flange, bolt=held, bolt_count=count, circle_diameter=circle)
        yield replace(stage, element=changed)


def _designs_by_torque(
    problem: PreloadProblem, element: FreeElement, stage: Stage, cases: tuple[LoadCase, ...]
) -> Iterator[CatalogueDesign]:
    """Yield the designs of one kind of bolts, by torque."""
    fastened, tightening = stage.element, problem.tightening
    limits = preload_limits(fastened, tightening)
    loss, count = preload_loss(fastened, tightening), fastener_count(fastened)
    alpha = scatter(fastened, tightening)
    steps = verification(
        stage,
        element.joint,
        cases,
        tightening,
        slip_safety(problem.requirements.slip_safety, cases, element.joint),
    )
    lever = workshop_torque(fastened, 1.0, tightening).nominal
    remedies = _CONNECTION_REMEDIES | {limit.name: limit.remedy for limit in limits}
    allowed = {"bolt utilisation": problem.requirements.bolt_utilisation}
    ends = [limit.capacity for limit in limits if limit.depends_on_preload]
    floor = problem.requirements.least_preload * min(ends)
    given = problem.choose.torques if problem.choose and fastened.kind == "bolted_flange" else ()
    torques = sorted(set(given)) or standard_torques(floor * lever, max(ends) * lever)
    size, grade = _size_and_grade(fastened)
    choose = problem.choose or Choice()
    cost = design_cost(choose, stage, element.stage)
    circle = None
    if choose.circles and isinstance(fastened, BoltedFlange):
        circle = fastened.circle_diameter
    for torque in torques:
        preload = float(torque) / lever
        least = preload / alpha - loss
        utilisations = {
            limit.name: float(limit.utilisation(preload)) / allowed.get(limit.name, 1.0)
            for limit in limits
        }
        utilisations[EMBEDDING] = loss * alpha / preload
        utilisations[SLIP] = _slip_utilisation(problem, element, stage, least, cases)
        utilisations[LEAST] = floor / preload
        rows = [row for row in vdi_rows(steps, preload) if row.binding] if steps else []
        utilisations |= {row.kind: row.utilisation for row in rows}
        yield CatalogueDesign(
            key=element.key,
            joint=element.joint,
            size=size,
            grade=grade,
            count=count,
            torque=float(torque),
            preload=preload,
            least_preload=least,
            stage=replace(stage, element=fastened.with_preload(preload)),
            limits=limits,
            utilisations=utilisations,
            remedies=remedies | {row.kind: row.remedy for row in rows},
            cost=cost,
            circle=circle,
        )


def _size_and_grade(fastened: object) -> tuple[str, str]:
    """Return size and grade of one bolt or set screw."""
    if isinstance(fastened, BoltedFlange) and fastened.bolt is not None:
        return fastened.bolt.size, fastened.bolt.grade
    assert isinstance(fastened, ClampingPins)
    assert fastened.screw is not None  # an element with torques has a screw
    return fastened.screw.size, ""


def _slip_utilisation(
    problem: PreloadProblem,
    element: FreeElement,
    stage: Stage,
    least: float,
    cases: tuple[LoadCase, ...],
) -> float:
    """Return required slip safety times torque over slip torque [-]."""
    torque = max(abs(float(case.torque[element.joint - 1])) for case in cases)
    if torque == 0.0:
        return 0.0
    if least <= 0.0:
        return math.inf
    slip = float(stage.element.slip_torque(least)) * stage.reduction
    return slip_safety(problem.requirements.slip_safety, cases, element.joint) * torque / slip


def design_cost(choose: Choice, stage: Stage, present: Stage) -> float:
    """Return the cost of the bolts of one connection.

    `stage` and `present`: the connection with these bolts, and the present one; pins cost nothing.
    """
    flange, before = stage.element, present.element
    if choose.cost is None or not isinstance(flange, BoltedFlange):
        return 0.0
    assert isinstance(before, BoltedFlange)
    assert flange.bolt is not None
    cost, bolt = choose.cost, flange.bolt
    sizes = sorted(set(choose.sizes), key=lambda size: catalogue.bolt(size).diameter)
    grades = sorted(set(choose.grades), key=catalogue.bolt_grades().index)
    one = (
        cost.bolt
        + cost.size * _position_in(sizes, bolt.size)
        + cost.grade * _position_in(grades, bolt.grade)
    )
    one += cost.washer * bolt.washer + cost.nut * bolt.nut
    moved = flange.circle_diameter != before.circle_diameter
    return flange.bolt_count * one + cost.circle * moved


def _position_in(among: Sequence[object], item: object) -> int:
    """Return the position in a list; 0 if absent."""
    return list(among).index(item) if item in among else 0
