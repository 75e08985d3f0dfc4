"""How a torque splits among elements in parallel by their unsmoothed laws.

Torques add at equal wind-up. By bracketed Newton steps on that wind-up: safe with jumps and kinks,
and no formula shared with the smooth split that the optimiser unrolls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.errors import StiffoptError
from stiffopt.exact.stage import Preloads, stage_compliance, stage_slip_torque, stage_windup

if TYPE_CHECKING:
    from stiffopt.drivetrain.stage import Stage

# Bisection alone needs 60 to exhaust the precision; Newton's steps end it long before.
_ROOT_STEPS = 80


def torque_shares(
    stages: Sequence[Stage], torque: np.ndarray, preloads: Preloads
) -> list[np.ndarray]:
    """Share of the joint torque (k,) [N m] that each stage of a group carries, (k,) [-] each."""
    size = np.abs(np.asarray(torque, dtype=float))
    if len(stages) == 1:
        return [np.ones_like(size)]
    # At zero torque the split is by the tangent stiffnesses there.
    stiffness = [1.0 / stage_compliance(s, np.zeros(1), preloads) for s in stages]
    at_rest = np.array([float(k[0]) for k in stiffness])
    shares = [np.full_like(size, k / at_rest.sum()) for k in at_rest]
    loaded = size > 0.0
    if not loaded.any():
        return shares
    whole = size[loaded]
    # Two upper bounds of the wind-up: that of the stiffest alone under the whole torque, and the
    # largest of a split by slip torques (even where some cannot slip). At that wind-up each carries
    # at least its part, and nothing slips before all would.
    slip = np.array([stage_slip_torque(s, preloads) for s in stages])
    can_slip = bool(np.isfinite(slip).all())
    split = slip / slip.sum() if can_slip else np.full(len(stages), 1.0 / len(stages))
    alone = np.min([stage_windup(s, whole, preloads) for s in stages], axis=0)
    together = np.max(
        [stage_windup(s, f * whole, preloads) for s, f in zip(stages, split, strict=True)], axis=0
    )
    upper = np.minimum(alone, together)
    held = np.isfinite(upper)
    if not held.all():
        if not can_slip:
            raise StiffoptError("elements in parallel need a finite wind-up; give a pre-pressure")
        # The whole group slips: each carries what it can, whatever the wind-up.
        for share, own in zip(shares, split, strict=True):
            share[loaded] = own
        if not held.any():
            return shares
        loaded[loaded] = held
        whole, upper = whole[held], upper[held]
    carried: list[np.ndarray] = []

    def surplus(windup: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        carried[:] = [_torque_at(s, windup, whole, preloads) for s in stages]
        slopes = [
            1.0 / stage_compliance(s, t, preloads) for s, t in zip(stages, carried, strict=True)
        ]
        return sum(carried) - whole, np.sum(slopes, axis=0)

    _root(surplus, np.zeros_like(upper), upper, upper, whole)
    for share, part in zip(shares, carried, strict=True):
        share[loaded] = part / sum(carried)
    return shares


def _torque_at(
    stage: Stage, windup: np.ndarray, largest: np.ndarray, preloads: Preloads
) -> np.ndarray:
    """Torque of a stage at a given wind-up, at most `largest`."""

    def excess(torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slope = stage_compliance(stage, torque, preloads)
        return stage_windup(stage, torque, preloads) - windup, slope

    return _root(excess, np.zeros_like(largest), largest.copy(), largest / 2.0, windup)


def _root(
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    lower: np.ndarray,
    upper: np.ndarray,
    start: np.ndarray,
    scale: np.ndarray,
) -> np.ndarray:
    """Root of a rising function in a bracket, by Newton steps that never leave it.

    Where a step would leave the bracket, or the law is infinite or kinked, it is halved instead.
    """
    lower, upper, x = lower.copy(), upper.copy(), start.copy()
    for _ in range(_ROOT_STEPS):
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
