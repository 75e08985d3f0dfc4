"""One bound on the preload of a fastener."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stiffopt.symbolic import Quantity


@dataclass(frozen=True, kw_only=True)
class PreloadLimit:
    """Bound on the largest preload that assembly leaves in one bolt or pin.

    The utilisation is `fixed` + F/`capacity` and must not exceed 1.

    Parameters
    ----------
    name : str
    capacity : float
        [N]; infinite where the preload does not matter.
    fixed : float
        Utilisation whatever the preload [-].
    provenance : {"catalogue", "paper", "estimated"}
    source : str
        Where the permissible value comes from.
    remedy : str
        What to change where this bound stops a design.
    """

    name: str
    capacity: float
    fixed: float = 0.0
    provenance: str
    source: str
    remedy: str

    @property
    def depends_on_preload(self) -> bool:
        """Whether a smaller preload helps."""
        return math.isfinite(self.capacity)

    @property
    def largest_preload(self) -> float:
        """Preload at a utilisation of 1 [N]; infinite, or 0, where the preload does not matter."""
        if not self.depends_on_preload:
            return math.inf if self.fixed <= 1.0 else 0.0
        return (1.0 - self.fixed) * self.capacity

    def utilisation(self, preload: Quantity) -> Quantity:
        """Share of the bound in use [-], for scalar or (n,) `preload` [N]."""
        if not self.depends_on_preload:
            return self.fixed + 0.0 * preload
        return self.fixed + preload / self.capacity
