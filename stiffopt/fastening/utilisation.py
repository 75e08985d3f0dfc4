"""Limits on preloads, safety factors and utilisation rows of a design."""

from __future__ import annotations

import math
from collections.abc import Iterable
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


# What each is the safety against, and its formula (VDI 2230 part 1, R8 to R12).
SAFETY_FACTORS = {
    "S_F": ("yield in service", "R_p0.2 / σ_red,B"),
    "S_D": ("fatigue", "σ_AS / σ_a"),
    "S_P": ("surface pressure", "p_G A_p / F_S max"),
    "S_G": ("slip", "F_KR min / F_KQ erf"),
    "S_A": ("shear after slip", "τ_B A_τ / F_Q max"),
}


@dataclass(frozen=True)
class SafetyFactor:
    """One safety factor of a step.

    Parameters
    ----------
    symbol : str
        Of `SAFETY_FACTORS`.
    value : float
        [-]; infinite without load.
    required : float
        [-]
    """

    symbol: str
    value: float
    required: float


# A row this close to its limit is called active: less than reports show of a utilisation, more than
# the optimiser leaves.
ACTIVE_TOLERANCE = 1e-4


@dataclass(frozen=True, kw_only=True)
class UtilisationRow:
    """One requirement and how far it is used.

    Parameters
    ----------
    kind : str
        "slip safety", "bolt utilisation", "joint stiffness", ...
    joint : int or None
        1-based.
    element : str
        Key of the element, "" where the row is of no single one.
    case : str
        Load case, "" where it does not matter.
    value, limit : float
        In `unit`.
    utilisation : float
        1 at the limit, above where it is exceeded.
    provenance, source : str
        Of the limit.
    remedy : str
        What to change where this row stops a study.
    equation : str
        Step of VDI 2230, where it is one.
    safety : SafetyFactor or None
        Where the step has one.
    binding : bool
        False: tells, but stops no design.
    warns : str
        Of a row that stops no design: what counts where it is exceeded, the design or the warning.
    """

    kind: str
    joint: int | None = None
    element: str = ""
    case: str = ""
    value: float
    limit: float
    unit: str
    utilisation: float
    provenance: str = "given"
    source: str = ""
    remedy: str = ""
    equation: str = ""
    safety: SafetyFactor | None = None
    binding: bool = True
    warns: str = ""

    @property
    def name(self) -> str:
        """Kind, element or joint, and load case."""
        owner = self.element or (f"joint {self.joint}" if self.joint else "")
        return ", ".join(part for part in (self.kind, owner, self.case) if part)

    @property
    def active(self) -> bool:
        """Whether the design lies at this limit."""
        return self.binding and self.utilisation >= 1.0 - ACTIVE_TOLERANCE

    @property
    def satisfied(self) -> bool:
        """Whether the limit holds, but for rounding; a warning is always kept."""
        return not self.binding or self.utilisation <= 1.0 + 1e-6


def governing_rows(rows: Iterable[UtilisationRow]) -> dict[str, UtilisationRow]:
    """Row with the least safety over what is required, by symbol in the order of the steps."""
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
