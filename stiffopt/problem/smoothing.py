"""Over what widths the optimiser's laws are smooth, as factors on those that they have by default.

They change between two solves of one programme: they are the parameters of the optimal-control
problem.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np

from stiffopt.symbolic import Quantity


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
