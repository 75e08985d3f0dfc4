"""What an objective or a limit asks of the optimiser, in pieces of one stage.

The files of objectives and limits write their rows by plain arithmetic on the quantities that a
`StageModel` hands them, so that they need no CasADi and the certificate may import them; only
`problem.formulation` turns the pieces into an optimal-control problem. Every piece belongs to one
instant; what couples instants is an integral or a static variable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from stiffopt.result.assessment import Assessment
    from stiffopt.symbolic import Quantity

    OfIntegrals = Callable[[Quantity, Quantity], Quantity]


# Factors on the smoothing widths of the stiffness model, stage by stage. Reducer steps blur the
# tangent stiffness far more than the wind-up, so that what depends on it ends narrower.
UNSMOOTHED = (1.0,)
WINDUP_SMOOTHING = (4.0, 1.0, 0.25)
STIFFNESS_SMOOTHING = (4.0, 1.0, 0.25, 0.05)


@dataclass(frozen=True, kw_only=True)
class PathRows:
    """Rows that hold at every node and midpoint.

    Parameters
    ----------
    name : str
        What is limited; certificates and margins use the same name.
    labels : tuple of str (m,)
        "joint 2" or "tool".
    expressions : tuple of Quantity (m,)
        Relative to the limit, so that they are of the order of one.
    lower, upper : float
    """

    name: str
    labels: tuple[str, ...]
    expressions: tuple[Quantity, ...]
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
    """A non-negative variable of the whole motion, such as the bound of a peak.

    Parameters
    ----------
    name : str
    start : callable
        Its value on an assessed motion.
    scale : float or None
        Typical magnitude; None: that of the objective.
    """

    name: str
    start: Callable[[Assessment], float]
    scale: float | None = None


@dataclass(frozen=True, kw_only=True)
class ObjectiveTerms:
    """One objective in pieces.

    Parameters
    ----------
    value : callable
        The objective in SI from the integrals of `integrands` and the duration; linear in the
        integrals, else the Hessian becomes dense: a root goes through a static variable.
    integrands : tuple of Quantity
    path_rows : tuple of PathRows
    integral_rows : tuple of IntegralRow
    besides : callable, optional
        Of the integrals and the duration too: what is minimised among motions that are as good.
    """

    value: OfIntegrals
    integrands: tuple[Quantity, ...] = ()
    path_rows: tuple[PathRows, ...] = ()
    integral_rows: tuple[IntegralRow, ...] = ()
    robust_value: OfIntegrals | None = None


def squared_length(vector: Quantity) -> Quantity:
    """Square of the length of a vector (3,): smooth at zero."""
    return sum(vector[i] * vector[i] for i in range(3))


@dataclass(frozen=True)
class Smoothing:
    """Factors on the widths over which laws are smooth, numbers or symbols.

    Parameters
    ----------
    stiffness : float or SX
        Corners and steps of the joints' stiffness; from wide to narrow stage by stage.
    corners : float or SX
        The same corners, besides, in the law by which motors lead planned links: as wide as the
        motors' jerk needs them, while the deflection keeps its own.
    robust : float or SX
        From 0, the objective alone, to 1: what an objective asks besides, for arms that are not as
        modelled, with as much room for the motors as such arms take.
    """

    stiffness: Quantity
    corners: Quantity = 1.0
    robust: Quantity = 0.0

    @property
    def parameters(self) -> np.ndarray:
        """As the parameters of a programme (3,)."""
        return np.array(astuple(self), dtype=float)

    @property
    def law(self) -> float:
        """Factor on the widths of the law by which motors lead."""
        return float(self.stiffness * self.corners)

    def narrowed(self, share: float) -> Smoothing:
        """With stiffness that bends within a share of its widths; the motors' law is as wide."""
        corners = self.corners / share
        return replace(self, stiffness=share * self.stiffness, corners=corners)
