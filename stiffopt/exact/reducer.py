"""The three slopes of a strain-wave reducer without smoothing: what its catalogue says.

The only place of this law; the smooth form is `stiffopt.connection.reducer`. Slopes and corners
may be CasADi expressions, since a recording may ask for other ones than the catalogue's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

# Of floats, arrays, SX or MX.
Slopes = tuple[Any, Any, Any]
Corners = tuple[Any, Any]


def reducer_windup(torque: Any, slopes: Slopes, corners: Corners) -> Any:
    """Wind-up [rad] with the slopes K1, K2, K3 [N m/rad] between the corners T1 <= T2 [N m].

    Odd and continuous in the torque [N m]; any shape, or a CasADi expression.
    """
    (k1, k2, k3), (t1, t2) = slopes, corners
    size = np.abs(torque)
    low = np.fmin(size, t1)
    middle = np.fmin(np.fmax(size - t1, 0.0), t2 - t1)
    high = np.fmax(size - t2, 0.0)
    return np.sign(torque) * (low / k1 + middle / k2 + high / k3)


def reducer_compliance(torque: Any, slopes: Slopes, corners: Corners) -> Any:
    """Slope of `reducer_windup` [rad/(N m)]; at a corner that of the torques beyond it."""
    (k1, k2, k3), (t1, t2) = slopes, corners
    size = np.abs(torque)
    return np.where(size < t1, 1.0 / k1, np.where(size < t2, 1.0 / k2, 1.0 / k3))
