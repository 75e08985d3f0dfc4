"""Unsmoothed wind-up of a whole joint, by quadrature of the exact laws of its elements.

Series: wind-ups add at equal torque. Parallel (stages of one group): torques add at equal wind-up,
found by bracketed Newton steps on that wind-up: robust with jumps and kinks, and no formula shared
with the smooth split that the optimiser unrolls. Torques and wind-ups are those of the joint [N m],
[rad]; an empty chain is rigid.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.errors import InputError
from stiffopt.exact import connection
from stiffopt.exact.quadrature import Antiderivative, antiderivative

if TYPE_CHECKING:
    from stiffopt.connection import Connection
    from stiffopt.drivetrain.chain import Chain, Stage

Preloads = Mapping[str, float] | None
# Bisection alone exhausts double precision in 60 steps; Newton's steps converge long before.
_MAX_ROOT_STEPS = 80


def exact_compliance(chain: Chain, torque: np.ndarray, preloads: Preloads = None) -> np.ndarray:
    """Return the slope of the unsmoothed wind-up, (k,) [N m] -> (k,) [rad/(N m)].

    Infinite where an element slips. `preloads` [N] by element name replace the elements' own.
    """
    torque = np.asarray(torque, dtype=float)
    total = np.zeros_like(torque)
    for group in chain.groups(preloads):
        shares = torque_shares(group, torque, preloads)
        slopes = [
            stage_compliance(s, f * torque, preloads) for s, f in zip(group, shares, strict=True)
        ]
        total = total + (slopes[0] if len(group) == 1 else _parallel_compliance(slopes))
    return total


def exact_windup(chain: Chain, torque: np.ndarray, preloads: Preloads = None) -> np.ndarray:
    """Return the unsmoothed wind-up, (k,) [N m] -> (k,) [rad]; arguments as `exact_compliance`.

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
    """Return the share of each element in the tangent compliance at a torque; they sum to 1.

    A parallel group is split among its members by stiffness. A slipping element has share 1.
    """
    at, shares = np.array([float(torque)]), {}
    for group in chain.groups():
        splits = torque_shares(group, at, None)
        slopes = [stage_compliance(s, f * at, None) for s, f in zip(group, splits, strict=True)]
        whole = float(_parallel_compliance(slopes)[0])
        for stage, slope in zip(group, slopes, strict=True):
            part = whole / float(slope[0]) if np.isfinite(whole) else 1.0
            shares[stage.element.name] = whole * part
    return _normalise_shares(shares)


def windup_shares(chain: Chain, torque: float) -> dict[str, float]:
    """Return the share of each element in the wind-up from zero to a torque; they sum to 1.

    A parallel group is split among its members by the torque that each carries. An element that
    slips, or has no stiffness without pressure, has share 1. At zero torque the shares are their
    limit, those of the compliance.
    """
    if torque == 0.0:
        return compliance_shares(chain, torque)
    at, shares = np.array([abs(float(torque))]), {}
    for group in chain.groups():
        splits = torque_shares(group, at, None)
        whole = float(stage_windup(group[0], splits[0] * at, None)[0])
        for stage, split in zip(group, splits, strict=True):
            shares[stage.element.name] = whole * float(split[0])
    # Wind-ups underflow at tiny torques.
    return _normalise_shares(shares) if any(shares.values()) else compliance_shares(chain, 0.0)


def _parallel_compliance(compliances: list[np.ndarray]) -> np.ndarray:
    """Return the compliance of elements in parallel; infinite where all of them slip."""
    stiffness = np.sum([1.0 / c for c in compliances], axis=0)
    held = stiffness > 0.0
    return np.where(held, 1.0 / np.where(held, stiffness, 1.0), np.inf)


def _normalise_shares(shares: dict[str, float]) -> dict[str, float]:
    """Divide shares by their sum; an infinite one becomes 1."""
    if not np.isfinite(list(shares.values())).all():
        shares = {name: float(np.isinf(value)) for name, value in shares.items()}
    total = sum(shares.values())
    return {name: value / total for name, value in shares.items()}


def torque_shares(
    stages: Sequence[Stage], torque: np.ndarray, preloads: Preloads
) -> list[np.ndarray]:
    """Return each stage's share (k,) [-] of the joint torque (k,) [N m] of its group."""
    size = np.abs(np.asarray(torque, dtype=float))
    if len(stages) == 1:
        return [np.ones_like(size)]
    kinds = _equal_stages(stages, preloads)
    count = np.array([len(places) for places in kinds])
    own = _shares_of_kinds([stages[places[0]] for places in kinds], count, size, preloads)
    shares = {place: share for each, share in zip(kinds, own, strict=True) for place in each}
    return [shares[place] for place in range(len(stages))]


def _equal_stages(stages: Sequence[Stage], preloads: Preloads) -> list[list[int]]:
    """Return the places of stages that are equal but for their names, and carry equal torques."""
    kinds: dict[tuple[Stage, float | None], list[int]] = {}
    for place, stage in enumerate(stages):
        unnamed = replace(stage, element=_without_name(stage.element))
        kinds.setdefault((unnamed, _select_preload(stage, preloads)), []).append(place)
    return list(kinds.values())


def _shares_of_kinds(
    stages: Sequence[Stage], count: np.ndarray, size: np.ndarray, preloads: Preloads
) -> list[np.ndarray]:
    """Return the share (k,) of one stage of each kind in the torques (k,), none negative [N m].

    `count` (kinds,): number of stages of each kind.
    """
    # At zero torque the split is by the tangent stiffnesses there.
    stiffness = [1.0 / stage_compliance(s, np.zeros(1), preloads) for s in stages]
    at_rest = np.array([float(k[0]) for k in stiffness])
    shares = [np.full_like(size, part) for part in _split(at_rest, count)]
    loaded = size > 0.0
    if not loaded.any():
        return shares
    whole = size[loaded]
    # Two upper bounds of the wind-up: that of the stiffest alone under the whole torque, and the
    # largest of a split by slip torques (even where some cannot slip). At that wind-up each carries
    # at least its part, and nothing slips before all would.
    slip = np.array([stage_slip_torque(s, preloads) for s in stages])
    can_slip = bool(np.isfinite(slip).all())
    split = _split(slip if can_slip else np.zeros(len(stages)), count)
    together = np.max(
        [stage_windup(s, f * whole, preloads) for s, f in zip(stages, split, strict=True)], axis=0
    )
    held = np.isfinite(together)
    if len(stages) == 1 and held.all():
        return shares
    alone = np.min([stage_windup(s, whole, preloads) for s in stages], axis=0)
    upper = np.minimum(alone, together)
    held = np.isfinite(upper)
    if not held.all():
        if not can_slip:
            raise InputError("elements in parallel need a finite wind-up: give a pre-pressure.")
        # The whole group slips: each carries its slip torque, whatever the wind-up.
        for share, own in zip(shares, split, strict=True):
            share[loaded] = own
        if not held.any():
            return shares
        loaded[loaded] = held
        whole, upper = whole[held], upper[held]
    carried: list[np.ndarray] = []

    def surplus(windup: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        carried[:] = [_torque_at_windup(s, windup, whole, preloads) for s in stages]
        slopes = [
            1.0 / stage_compliance(s, t, preloads) for s, t in zip(stages, carried, strict=True)
        ]
        return count @ carried - whole, count @ slopes

    _find_root(surplus, np.zeros_like(upper), upper, upper, whole)
    for share, part in zip(shares, carried, strict=True):
        share[loaded] = part / (count @ carried)
    return shares


def _split(weights: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return shares in proportion to weights; equal ones without any, as of open contacts."""
    own = weights if weights.any() else np.ones(len(weights))
    return np.asarray(own / (count @ own))


def _torque_at_windup(
    stage: Stage, windup: np.ndarray, largest: np.ndarray, preloads: Preloads
) -> np.ndarray:
    """Return the torque of a stage at a given wind-up, at most `largest`."""

    def excess(torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slope = stage_compliance(stage, torque, preloads)
        return stage_windup(stage, torque, preloads) - windup, slope

    return _find_root(excess, np.zeros_like(largest), largest.copy(), largest / 2.0, windup)


def _find_root(
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    lower: np.ndarray,
    upper: np.ndarray,
    start: np.ndarray,
    scale: np.ndarray,
) -> np.ndarray:
    """Find the root of a rising function by bracketed Newton steps.

    The bracket is halved where a step would leave it or the law is infinite or kinked.
    """
    lower, upper, x = lower.copy(), upper.copy(), start.copy()
    for _ in range(_MAX_ROOT_STEPS):
        value, slope = function(x)
        if np.all((np.abs(value) <= 1e-13 * scale) | (upper - lower <= 1e-15 * upper)):
            break
        below = value < 0.0
        lower, upper = np.where(below, x, lower), np.where(below, upper, x)
        with np.errstate(invalid="ignore", divide="ignore"):
            step = x - value / slope
            inside = np.isfinite(step) & (step > lower) & (step < upper)
        x = np.where(inside, step, (lower + upper) / 2.0)
    return x


def stage_compliance(stage: Stage, torque: np.ndarray, preloads: Preloads) -> np.ndarray:
    """Return the slope of `stage_windup` [rad/(N m)] at joint torques (k,) [N m] of the stage."""
    down = stage.ratio * stage.efficiency
    own = connection.tangent_compliance(
        stage.element, torque / down, _select_preload(stage, preloads)
    )
    return own * (_joint_windup_per_element_windup(stage) / down)


def stage_windup(stage: Stage, torque: np.ndarray, preloads: Preloads) -> np.ndarray:
    """Return the wind-up at the joint [rad] by quadrature of the slope, (k,) [N m] -> (k,)."""
    own = torque / (stage.ratio * stage.efficiency)
    largest = float(np.max(np.abs(own), initial=0.0))
    base = stage.element.torque_max
    # Whole octaves of the largest torque, so that one cached curve serves many calls.
    octaves = max(0, math.ceil(math.log2(largest / base))) if largest > base else 0
    curve = _element_curve(
        _without_name(stage.element), _select_preload(stage, preloads), base * 2.0**octaves
    )
    return _joint_windup_per_element_windup(stage) * curve(own)


def stage_slip_torque(stage: Stage, preloads: Preloads) -> float:
    """Return the joint torque [N m] at which this stage alone would slip."""
    own = connection.slip_torque(stage.element, _select_preload(stage, preloads))
    return own * stage.ratio * stage.efficiency


def _joint_windup_per_element_windup(stage: Stage) -> float:
    """Wind-up of the joint per wind-up of the element [-]; see `Chain.reflect`."""
    return 1.0 / stage.ratio if stage.reflect else stage.ratio * stage.efficiency


def _select_preload(stage: Stage, preloads: Preloads) -> float | None:
    return (preloads or {}).get(stage.element.name)


@functools.lru_cache(maxsize=512)
def _without_name(element: Connection) -> Connection:
    """Return the element without its name, so that equal ones share a cached curve."""
    return replace(element, name="")


@functools.lru_cache(maxsize=512)
def _element_curve(element: Connection, preload: float | None, upper: float) -> Antiderivative:
    return antiderivative(
        lambda torque: connection.tangent_compliance(element, torque, preload),
        upper,
        connection.breakpoints(element),
    )


def windup_along(chain: Chain, torque: np.ndarray) -> np.ndarray:
    """Return `exact_windup` for the torques (k,) [N m] of a motion -> (k,) [rad]."""
    curve = _select_curve(chain, torque)
    return exact_windup(chain, torque) if curve is None else curve(torque)


def compliance_along(chain: Chain, torque: np.ndarray) -> np.ndarray:
    """Return `exact_compliance` to 1e-8, torques (k,) [N m] of a motion -> (k,) [rad/(N m)]."""
    curve = _select_curve(chain, torque)
    if curve is None:
        return exact_compliance(chain, torque)
    compliance, sharp = curve.slope(torque)
    if not sharp.all():
        compliance[~sharp] = exact_compliance(chain, torque[~sharp])
    return compliance


def _select_curve(chain: Chain, torque: np.ndarray) -> Antiderivative | None:
    """Return the curve up to the largest torque; None without elements or with parallel groups."""
    if not chain.stages or any(stage.group is not None for stage in chain.stages):
        return None
    base = max(stage.element.torque_max * stage.ratio * stage.efficiency for stage in chain.stages)
    largest = float(np.max(np.abs(torque), initial=0.0))
    # Whole octaves, so that one curve serves many motions.
    octaves = math.ceil(math.log2(largest / base)) if largest > base else 0
    return _joint_curve(chain, base * 2.0**octaves)


@functools.lru_cache(maxsize=128)
def _joint_curve(chain: Chain, upper: float) -> Antiderivative:
    return antiderivative(lambda torque: exact_compliance(chain, torque), upper, breakpoints(chain))
