"""Rows, integrands and static variables that objectives and limits contribute to a stage.

Objectives and limits write their rows by plain arithmetic on the quantities of a `StageModel`, so
that they need no CasADi and the certificate may import them; only `problem.formulation` builds the
optimal-control problem. Rows belong to one instant; integrals and static variables couple instants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from stiffopt.result.assessment import Assessment
    from stiffopt.symbolic import Quantity

    # (integrals of the objective's own integrands, duration) -> scalar
    OfIntegrals = Callable[[Quantity, Quantity], Quantity]


# Factors on the smoothing widths of the stiffness model, stage by stage. Reducer steps blur the
# tangent stiffness far more than the wind-up, so that its list ends narrower.
UNSMOOTHED = (1.0,)
WINDUP_SMOOTHING = (4.0, 1.0, 0.25)
STIFFNESS_SMOOTHING = (4.0, 1.0, 0.25, 0.05)


@dataclass(frozen=True, kw_only=True)
class PathRows:
    """Constraint rows at every node and midpoint."""

    name: str  # limited quantity; certificates and back-offs use the same name
    labels: tuple[str, ...]  # (m,) "joint 2" or "tool"
    expressions: tuple[Quantity, ...]  # (m,) relative to the limit, so that they are of order one
    lower: float = -np.inf
    upper: float = 0.0


@dataclass(frozen=True, kw_only=True)
class IntegralRow:
    """One row <= 0 on integrals over the whole motion."""

    name: str
    label: str
    expression: OfIntegrals


@dataclass(frozen=True, kw_only=True)
class StaticVariable:
    """A non-negative variable of the whole motion, such as the bound of a peak."""

    name: str
    start: Callable[[Assessment], float]  # initial value, from an assessed motion
    scale: float | None = None  # typical magnitude; None: that of the objective


@dataclass(frozen=True, kw_only=True)
class ObjectiveTerms:
    """Contributions of one objective.

    `value`: the objective in SI from the integrals of `integrands` and the duration; linear in the
    integrals, else the Hessian becomes dense: a root goes through a static variable.
    `robust_value`: function of integrals and duration that is minimised among motions of about
    equal value, for robustness to model errors.
    """

    value: OfIntegrals
    integrands: tuple[Quantity, ...] = ()
    path_rows: tuple[PathRows, ...] = ()
    integral_rows: tuple[IntegralRow, ...] = ()
    robust_value: OfIntegrals | None = None


def squared_length(vector: Quantity) -> Quantity:
    """Squared length of a vector (3,), smooth at zero."""
    return sum(vector[i] * vector[i] for i in range(3))


@dataclass(frozen=True)
class Smoothing:
    """Factors on the default smoothing widths of the optimiser's laws, numbers or symbols.

    They are parameters of the optimal-control problem: one programme is solved for several.
    """

    # On the kinks and steps of the joints' stiffness; from wide to narrow stage by stage.
    stiffness: Quantity
    # Further factor in the feedforward-lead law of planned links: as wide as the motors' jerk limit
    # needs, while the deflection keeps its own width.
    lead: Quantity = 1.0
    # From 0, the objective alone, to 1, its robust value, with the motor back-off that uncertain
    # arms need.
    robust: Quantity = 0.0
    # On the widths of objectives' kinks at zero, that of dry friction in the drive torque included:
    # narrow from the start, they make every reversal of a joint a choice of its own.
    kinks: Quantity = 1.0
    # From 0, dry friction is charged in full at any speed, to 1, only by the smooth law, which
    # favours joints at rest, and as much those that creep.
    creeping: Quantity = 0.0
    # From 0, exact second derivatives of the charge of dry friction, to 1, without its concave
    # part: a joint about to reverse would else shorten the steps of all others.
    convexity: Quantity = 0.0

    @property
    def parameters(self) -> np.ndarray:
        """Parameter vector of the programme (6,)."""
        return np.array(astuple(self), dtype=float)

    @property
    def law(self) -> float:
        """Factor on the widths of the feedforward-lead law."""
        return float(self.stiffness * self.lead)

    def narrowed(self, share: float) -> Smoothing:
        """Narrow the stiffness widths to a share; the feedforward-lead law keeps its widths."""
        return replace(self, stiffness=share * self.stiffness, lead=self.lead / share)
