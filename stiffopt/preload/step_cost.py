"""What catalogue designs cost in steps: one bolt more, one size up, another way to tighten."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from stiffopt.connection import BoltedFlange
from stiffopt.declaration import NOT_NEGATIVE, Doc, Ratio, check_fields
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Stage

if TYPE_CHECKING:
    from stiffopt.preload.problem import Choice


@dataclass(frozen=True, kw_only=True)
class StepCost:
    """Cost of one step of each kind, in a unit of one's own; what is left out costs nothing."""

    bolt: Annotated[Ratio, NOT_NEGATIVE, Doc("Of one bolt: hole, thread, tightening.")] = 0.0
    size: Annotated[Ratio, NOT_NEGATIVE, Doc("Of each bolt, for one place up in `sizes`.")] = 0.0
    grade: Annotated[Ratio, NOT_NEGATIVE, Doc("Of each bolt, for one place up in `grades`.")] = 0.0
    washer: Annotated[Ratio, NOT_NEGATIVE, Doc("Of the washers of one bolt.")] = 0.0
    nut: Annotated[Ratio, NOT_NEGATIVE, Doc("Of one nut.")] = 0.0
    circle: Annotated[
        Ratio, NOT_NEGATIVE, Doc("Of a flange with another pitch circle than at present.")
    ] = 0.0
    method: Annotated[Ratio, NOT_NEGATIVE, Doc("Of the study, for one place on in `methods`.")] = (
        0.0
    )
    coating: Annotated[
        Ratio, NOT_NEGATIVE, Doc("Of the study, for one place on in `coatings`.")
    ] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "choose.cost")


def design_cost(choose: Choice, stage: Stage, present: Stage) -> float:
    """Cost of the bolts of one connection.

    Parameters
    ----------
    choose : Choice
    stage, present : Stage
        The connection with these bolts, and as it is; pins cost nothing.
    """
    flange, before = stage.element, present.element
    if choose.cost is None or not isinstance(flange, BoltedFlange):
        return 0.0
    assert isinstance(before, BoltedFlange)
    assert flange.bolt is not None
    cost, bolt = choose.cost, flange.bolt
    sizes = sorted(set(choose.sizes), key=lambda size: catalogue.bolt(size).diameter)
    grades = sorted(set(choose.grades), key=catalogue.bolt_grades().index)
    one = cost.bolt + cost.size * _place(sizes, bolt.size) + cost.grade * _place(grades, bolt.grade)
    one += cost.washer * bolt.washer + cost.nut * bolt.nut
    moved = flange.circle_diameter != before.circle_diameter
    return flange.bolt_count * one + cost.circle * moved


def way_cost(choose: Choice, method: int, coating: int) -> float:
    """Cost of a tightening method and a coating by their places in the lists, for the study."""
    if choose.cost is None:
        return 0.0
    return choose.cost.method * method + choose.cost.coating * coating


def _place(among: Sequence[object], what: object) -> int:
    """Position in a list; 0 in none."""
    return list(among).index(what) if what in among else 0
