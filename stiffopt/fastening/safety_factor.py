"""Safety factors of a bolted joint by their names in VDI 2230."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stiffopt.fastening.utilisation_row import UtilisationRow

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
