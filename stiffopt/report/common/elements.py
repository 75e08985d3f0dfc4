"""Shares of a joint's compliance by kind of element, and the colour of each kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stiffopt.exact.chain import compliance_shares, windup_shares
from stiffopt.report.common.svg import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION

ELEMENT_COLOURS = {
    "reducer": BLUE,
    "key": VERMILLION,
    "bolted_flange": GREEN,
    "clamping_pins": PURPLE,
    "timing_belt": ORANGE,
    "gear_pair": SKY,
    "shaft": GREY,
    "constant": BLACK,
}


def windup_by_kind(chain: Any, torque: float) -> dict[str, float]:
    """Share of the wind-up at a torque by kind of element, largest first; empty if rigid."""
    return {} if chain is None else _by_kind(chain, windup_shares(chain, torque))


def compliance_by_kind(chain: Any, torque: float) -> dict[str, float]:
    """Share of the tangent compliance at a torque by kind of element, largest first."""
    return _by_kind(chain, compliance_shares(chain, torque))


def _by_kind(chain: Any, shares: Mapping[str, float]) -> dict[str, float]:
    elements = chain.elements
    totals: dict[str, float] = {}
    for name, share in shares.items():
        kind = elements[name].kind
        totals[kind] = totals.get(kind, 0.0) + float(share)
    return dict(sorted(totals.items(), key=lambda item: -item[1]))
