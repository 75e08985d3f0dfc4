"""Classical Runge-Kutta integration: an oracle that shares no formula with the package."""

from __future__ import annotations

import numpy as np


def integrate(slope, state, end, step=2e-5):
    """Return times (K,) and the first component (K,) of a solution of dx/dt = slope(t, x)."""
    found = [state[0]]
    for k in range(round(end / step)):
        t = k * step
        a = slope(t, state)
        b = slope(t + 0.5 * step, state + 0.5 * step * a)
        c = slope(t + 0.5 * step, state + 0.5 * step * b)
        state = state + step / 6.0 * (a + 2 * b + 2 * c + slope(t + step, state + step * c))
        found.append(state[0])
    return np.arange(len(found)) * step, np.array(found)
