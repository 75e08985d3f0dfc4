"""Limits on preloads, safety factors and utilisation rows of a design."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from stiffopt.symbolic import Quantity


@dataclass(frozen=True, kw_only=True)
class PreloadLimit:
    """Limit on the largest assembly preload of one bolt or pin.

    The utilisation is `fixed` + F/`capacity` and must not exceed 1.
    """

    name: str
    capacity: float  # [N]; infinite if the limit does not depend on the preload
    fixed: float = 0.0  # utilisation at zero preload [-]
    provenance: str  # {"catalogue", "paper", "estimated"}
    source: str  # origin of the permissible value
    remedy: str  # change of the design that relaxes this limit

    @property
    def depends_on_preload(self) -> bool:
        """True if a smaller preload lowers the utilisation."""
        return math.isfinite(self.capacity)

    @property
    def largest_preload(self) -> float:
        """Preload at a utilisation of 1 [N]; infinite or 0 if independent of the preload."""
        if not self.depends_on_preload:
            return math.inf if self.fixed <= 1.0 else 0.0
        return (1.0 - self.fixed) * self.capacity

    def utilisation(self, preload: Quantity) -> Quantity:
        """Return the utilisation [-] for scalar or (n,) `preload` [N]."""
        if not self.depends_on_preload:
            return self.fixed + 0.0 * preload
        return self.fixed + preload / self.capacity


# Failure mode and formula of each safety factor (VDI 2230 part 1, R8 to R12).
SAFETY_FACTORS = {
    "S_F": ("yield in service", "R_p0.2 / σ_red,B"),
    "S_D": ("fatigue", "σ_AS / σ_a"),
    "S_P": ("surface pressure", "p_G A_p / F_S max"),
    "S_G": ("slip", "F_KR min / F_KQ erf"),
    "S_A": ("shear after slip", "τ_B A_τ / F_Q max"),
}


@dataclass(frozen=True)
class SafetyFactor:
    """Safety factor of one verification step."""

    symbol: str  # key of `SAFETY_FACTORS`
    value: float  # [-]; infinite without load
    required: float  # [-]


# A row within this of utilisation 1 is active [-]: below the digits of reports, above the accuracy
# of the optimiser.
ACTIVE_TOLERANCE = 1e-4


@dataclass(frozen=True, kw_only=True)
class UtilisationRow:
    """One requirement of a design with its utilisation."""

    kind: str  # "slip safety", "bolt utilisation", "joint stiffness", ...
    joint: int | None = None  # 1-based
    element: str = ""  # key of the element, "" if the row concerns none in particular
    case: str = ""  # load case, "" if independent of it
    # In `unit`.
    value: float
    limit: float
    unit: str = ""
    utilisation: float  # 1 at the limit, above 1 if exceeded [-]
    # Of the limit.
    provenance: str = "given"
    source: str = ""
    remedy: str = ""  # change of the design that relaxes this row
    equation: str = ""  # step of VDI 2230, if any
    safety: SafetyFactor | None = None  # of the step, if it has one
    binding: bool = True  # False: a warning that does not reject a design
    warns: str = ""  # of a warning: consequence of exceeding it

    @property
    def name(self) -> str:
        """Kind, element or joint, and load case, comma-separated."""
        owner = self.element or (f"joint {self.joint}" if self.joint else "")
        return ", ".join(part for part in (self.kind, owner, self.case) if part)

    @property
    def active(self) -> bool:
        """True if the design is at this limit."""
        return self.binding and self.utilisation >= 1.0 - ACTIVE_TOLERANCE

    @property
    def satisfied(self) -> bool:
        """True if the limit holds within rounding; always true for warnings."""
        return not self.binding or self.utilisation <= 1.0 + 1e-6


def governing_rows(rows: Iterable[UtilisationRow]) -> dict[str, UtilisationRow]:
    """Return the row of least safety over required safety, by symbol in the order of the steps."""
    found: dict[str, UtilisationRow] = {}
    for row in rows:
        own = row.safety
        if own is None:
            continue
        known = found.get(own.symbol)
        worst = None if known is None else known.safety
        if worst is None or own.value / own.required < worst.value / worst.required:
            found[own.symbol] = row
    return {symbol: found[symbol] for symbol in SAFETY_FACTORS if symbol in found}
