"""How a torque splits among elements in parallel: equal wind-up, torques add.

With the secant compliance S_e = wind-up / torque of element e and its share s_e of the torque,
equal wind-up means ln S_e(s_e T) + ln s_e is the same for all e. In these logarithms the stiffness
laws (powers of the torque) are nearly straight lines, so Newton's method settles in a few steps, at
T = 0 too.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import numpy as np

from stiffopt.drivetrain.stage import Preloads, Stage
from stiffopt.errors import StiffoptError
from stiffopt.symbolic import Quantity

# Unrolled, so that the split stays a differentiable expression. Three steps leave 1e-12 of the
# wind-up for a key beside a bolted flange.
_STEPS = 4
# Bisection alone needs 60 to exhaust the precision; Newton's steps end it long before.
_ROOT_STEPS = 80

Law = Callable[[Quantity], Quantity]


def _newton(secants: Sequence[Law], tangents: Sequence[Law], torque: Quantity) -> list[Quantity]:
    count = len(secants)
    even = 1.0 / count + 0.0 * torque
    weights = [1.0 / secant(even * torque) for secant in secants]
    shares = [w / sum(weights) for w in weights]
    for _ in range(_STEPS):
        residuals, slopes = [], []
        for secant, tangent, share in zip(secants, tangents, shares, strict=True):
            compliance = secant(share * torque)
            residuals.append(np.log(compliance) + np.log(share))
            slopes.append(tangent(share * torque) / compliance)
        level = sum(f * r / b for f, r, b in zip(shares, residuals, slopes, strict=True)) / sum(
            f / b for f, b in zip(shares, slopes, strict=True)
        )
        raw = [
            f * np.exp((level - r) / b) for f, r, b in zip(shares, residuals, slopes, strict=True)
        ]
        whole = sum(raw)
        shares = [f / whole for f in raw]
    return shares


def smooth_shares(
    stages: Sequence[Stage], torque: Quantity, preloads: Preloads, smoothing: Quantity
) -> list[Quantity]:
    """Share of the torque that each stage of a group carries; a smooth expression.

    Parameters
    ----------
    stages : sequence of Stage
        At least two.
    torque : scalar or (n,) or SX or MX [N m]

    Returns
    -------
    list, one a stage, same kind as `torque` [-]; they sum to 1
    """
    if len(stages) == 1:
        return [1.0 + 0.0 * torque]
    extra = {"preloads": preloads, "smoothing": smoothing}
    return _newton(
        [functools.partial(s.secant_compliance, **extra) for s in stages],
        [functools.partial(s.tangent_compliance, **extra) for s in stages],
        torque,
    )


def exact_shares(
    stages: Sequence[Stage], torque: np.ndarray, preloads: Preloads
) -> list[np.ndarray]:
    """Share of the torque that each stage of a group carries, for the unsmoothed laws, (k,).

    By bracketed Newton steps on the common wind-up: safe with jumps and kinks, and no code shared
    with `smooth_shares`.
    """
    size = np.abs(np.asarray(torque, dtype=float))
    if len(stages) == 1:
        return [np.ones_like(size)]
    # At zero torque the split is by the tangent stiffnesses there.
    stiffness = [1.0 / s.exact_tangent_compliance(np.zeros(1), preloads) for s in stages]
    at_rest = np.array([float(k[0]) for k in stiffness])
    shares = [np.full_like(size, k / at_rest.sum()) for k in at_rest]
    loaded = size > 0.0
    if not loaded.any():
        return shares
    whole = size[loaded]
    # Two upper bounds of the wind-up: that of the stiffest alone under the whole torque, and the
    # largest of a split by slip torques (even where some cannot slip). At that wind-up each carries
    # at least its part, and nothing slips before all would.
    slip = np.array([s.slip_torque(preloads) for s in stages])
    can_slip = bool(np.isfinite(slip).all())
    split = slip / slip.sum() if can_slip else np.full(len(stages), 1.0 / len(stages))
    alone = np.min([s.exact_windup(whole, preloads) for s in stages], axis=0)
    together = np.max(
        [s.exact_windup(f * whole, preloads) for s, f in zip(stages, split, strict=True)], axis=0
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
            1.0 / s.exact_tangent_compliance(t, preloads)
            for s, t in zip(stages, carried, strict=True)
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
        slope = stage.exact_tangent_compliance(torque, preloads)
        return stage.exact_windup(torque, preloads) - windup, slope

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
