"""Ways to tighten that a study lets choose: methods by coatings."""

from __future__ import annotations

from dataclasses import dataclass, replace

from stiffopt.drivetrain import catalogue
from stiffopt.fastening.tightening import Tightening
from stiffopt.preload.problem import Choice
from stiffopt.preload.step_cost import way_cost
from stiffopt.result.status import SolveStatus


@dataclass(frozen=True, kw_only=True)
class TighteningWay:
    """Best for one method and coating; lowest and highest friction [-], cost in steps."""

    method: str
    friction: float
    friction_highest: float | None
    status: SolveStatus
    objective: float
    cost: float = float("nan")


def ways_to_tighten(tightening: Tightening, choose: Choice) -> list[tuple[Tightening, float]]:
    """Every method with every coating that the study names, and what it costs in steps."""
    methods = [
        replace(tightening, method=method, scatter=None)  # type: ignore[arg-type]
        for method in choose.methods
    ] or [tightening]
    coatings = [catalogue.coating(name) for name in choose.coatings]
    if not coatings:
        return [(method, way_cost(choose, i, 0)) for i, method in enumerate(methods)]
    return [
        (
            replace(
                method,
                thread_friction=coating.least,
                head_friction=coating.least,
                friction_highest=coating.largest,
            ),
            way_cost(choose, i, k),
        )
        for i, method in enumerate(methods)
        for k, coating in enumerate(coatings)
    ]
