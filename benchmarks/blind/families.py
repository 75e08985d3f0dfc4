"""Classes of effects, as the simulator sorts them."""

from __future__ import annotations

from benchmarks.simulator import EFFECTS


def family(effect: str) -> str:
    """Class of an effect of the catalogue; "user" of one that the simulator does not know."""
    return EFFECTS[effect].family if effect in EFFECTS else "user"
