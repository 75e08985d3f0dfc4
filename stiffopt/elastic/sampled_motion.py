"""Motion through samples."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

if TYPE_CHECKING:
    from stiffopt.result.trajectory import JointMotion


class SampledMotion:
    """Motion through samples (K, n) [rad], at rest at both ends."""

    def __init__(self, time: np.ndarray, values: np.ndarray) -> None:
        self.duration = float(time[-1])
        self._spline = CubicSpline(time, values, bc_type="clamped")
        self._before: JointMotion | None = None

    def after(self, plan: JointMotion) -> SampledMotion:
        """Return the motion added to a plan of the same duration."""
        found = copy.copy(self)
        found._before = plan
        return found

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Positions (order 0) or their derivatives (K, n) at times (K,)."""
        own = np.asarray(self._spline(t, order))
        return own if self._before is None else own + self._before(t, order)
