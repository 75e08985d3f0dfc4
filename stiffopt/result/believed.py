"""What the optimiser believed of its own motion, as plain numbers that can be compared."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class PredictedMotion:
    """Quantities of the optimiser's model along the motion it found.

    Parameters
    ----------
    time : array (K,)
        Nodes and midpoints [s].
    spring_torque : array (K, n)
        Of the springs [N m].
    torque : array (K, n) or None
        Of the drives [N m]; None where the optimiser knows it nearly only.
    friction_width : array (n,)
        Speed within which the dry friction in `torque` is smoothed: tanh(velocity/width) [rad/s].
    windup : array (K, n) or None
        [rad]; None where stiffness plays no part in the problem.
    deflection : dict of array (K, 3)
        Parts of the tool's deflection, base frame [m]; empty where none plays a part.
    """

    time: np.ndarray
    spring_torque: np.ndarray
    torque: np.ndarray | None
    friction_width: np.ndarray
    windup: np.ndarray | None = None
    deflection: dict[str, np.ndarray] = field(default_factory=dict)
