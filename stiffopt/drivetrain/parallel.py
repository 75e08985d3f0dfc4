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
from stiffopt.symbolic import Quantity

# Unrolled, so that the split stays a differentiable expression. Three steps leave 1e-12 of the
# wind-up for a key beside a bolted flange.
_STEPS = 4

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
