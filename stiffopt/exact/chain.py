"""Unsmoothed wind-up of a whole joint, by quadrature of the exact laws of its elements.

Series: wind-ups add at equal torque. Parallel (stages of one group): torques add at equal wind-up.
Torques and wind-ups are those of the joint [N m], [rad]; an empty chain is rigid.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.exact import connection
from stiffopt.exact.parallel import torque_shares
from stiffopt.exact.stage import Preloads, stage_compliance, stage_windup

if TYPE_CHECKING:
    from stiffopt.drivetrain.chain import Chain


def exact_compliance(chain: Chain, torque: np.ndarray, preloads: Preloads = None) -> np.ndarray:
    """Slope of the unsmoothed wind-up, (k,) [N m] -> (k,) [rad/(N m)]; infinite where it slips.

    `preloads` [N] by element name stand in place of the elements' own.
    """
    torque = np.asarray(torque, dtype=float)
    total = np.zeros_like(torque)
    for group in chain.groups(preloads):
        shares = torque_shares(group, torque, preloads)
        slopes = [
            stage_compliance(s, f * torque, preloads) for s, f in zip(group, shares, strict=True)
        ]
        total = total + (slopes[0] if len(group) == 1 else _side_by_side(slopes))
    return total


def exact_windup(chain: Chain, torque: np.ndarray, preloads: Preloads = None) -> np.ndarray:
    """Unsmoothed wind-up, (k,) [N m] -> (k,) [rad]; arguments as in `exact_compliance`.

    Notes
    -----
    Accurate to about 1e-9 of itself. Infinite where a contact has no stiffness at zero pressure (a
    key without pre-pressure).
    """
    torque = np.asarray(torque, dtype=float)
    total = np.zeros_like(torque)
    for group in chain.groups(preloads):
        shares = torque_shares(group, torque, preloads)
        total = total + stage_windup(group[0], shares[0] * torque, preloads)
    return total


def breakpoints(chain: Chain) -> tuple[float, ...]:
    """Positive joint torques at which the exact law jumps or kinks [N m], ascending."""
    found = {
        torque * stage.ratio * stage.efficiency
        for stage in chain.stages
        for torque in connection.breakpoints(stage.element)
    }
    return tuple(sorted(found))


def compliance_shares(chain: Chain, torque: float) -> dict[str, float]:
    """Share of each element in the tangent compliance at a torque; they sum to 1.

    A group in parallel is split among its members by the stiffness of each.
    """
    at, shares = np.array([float(torque)]), {}
    for group in chain.groups():
        splits = torque_shares(group, at, None)
        stiff = [
            1.0 / float(stage_compliance(s, f * at, None)[0])
            for s, f in zip(group, splits, strict=True)
        ]
        for stage, k in zip(group, stiff, strict=True):
            shares[stage.element.name] = k / sum(stiff) ** 2
    return _normalised(shares)


def windup_shares(chain: Chain, torque: float) -> dict[str, float]:
    """Share of each element in the wind-up from zero to a torque; they sum to 1.

    A group in parallel is split among its members by the torque that each carries. Without torque
    the shares are their limit, those of the compliance.
    """
    if torque == 0.0:
        return compliance_shares(chain, torque)
    at, shares = np.array([float(torque)]), {}
    for group in chain.groups():
        splits = torque_shares(group, at, None)
        whole = float(stage_windup(group[0], splits[0] * at, None)[0])
        for stage, split in zip(group, splits, strict=True):
            shares[stage.element.name] = whole * float(split[0])
    return _normalised(shares)


def _side_by_side(compliances: list[np.ndarray]) -> np.ndarray:
    """Compliance of elements in parallel; infinite where all of them slip."""
    stiffness = np.sum([1.0 / c for c in compliances], axis=0)
    held = stiffness > 0.0
    return np.where(held, 1.0 / np.where(held, stiffness, 1.0), np.inf)


def _normalised(shares: dict[str, float]) -> dict[str, float]:
    total = sum(shares.values())
    return {name: value / total for name, value in shares.items()}
