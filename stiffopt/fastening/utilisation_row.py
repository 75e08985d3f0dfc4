"""One requirement of a design and how far it is used: a step of VDI 2230, or any other."""

from __future__ import annotations

from dataclasses import dataclass

from stiffopt.fastening.safety_factor import SafetyFactor

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
    def kept(self) -> bool:
        """Whether the limit holds, but for rounding; a warning is always kept."""
        return not self.binding or self.utilisation <= 1.0 + 1e-6
