"""Exact law of a whole joint as one interpolated curve, for the many torques of a motion.

`exact.chain` evaluates every element at every torque. Here their sum is expanded once, which
serves thousands of torques at a tenth of the cost.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.exact.chain import breakpoints, exact_compliance, exact_windup
from stiffopt.exact.quadrature import Antiderivative, antiderivative

if TYPE_CHECKING:
    from stiffopt.drivetrain.chain import Chain


def windup_along(chain: Chain, torque: np.ndarray) -> np.ndarray:
    """Return `exact_windup` for the torques (k,) [N m] of a motion -> (k,) [rad]."""
    curve = _select_curve(chain, torque)
    return exact_windup(chain, torque) if curve is None else curve(torque)


def compliance_along(chain: Chain, torque: np.ndarray) -> np.ndarray:
    """Return `exact_compliance`, to 1e-8, for torques (k,) [N m] of a motion -> (k,) [rad/(N m)]."""
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
    return _cached_curve(chain, base * 2.0**octaves)


@functools.lru_cache(maxsize=128)
def _cached_curve(chain: Chain, upper: float) -> Antiderivative:
    return antiderivative(lambda torque: exact_compliance(chain, torque), upper, breakpoints(chain))
