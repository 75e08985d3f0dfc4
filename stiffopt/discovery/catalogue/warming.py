"""Change within a run as a motor and its gear warm: first order in the time since its begin."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.effect import Shape
from stiffopt.discovery.signals import JointSignals
from stiffopt.symbolic import Quantity

# Time constants that are tried [s]: lubricant redistributes in seconds, windings warm in tens of
# seconds, housings in minutes, whose change within a run is a straight line.
TIME_CONSTANT = Shape("tau_w", "s", (1.0, 4.0, 20.0), 0.3, 1e3, 20.0)


def warmed_share(signals: JointSignals, time_constant: Quantity) -> Quantity:
    """Return the change since the begin of the run, 0 to 1 at its end [-].

    The amplitude is then the change over the run, which is determined where the time constant and
    the end value of a longer run are not.
    """
    elapsed = signals.time - signals.time[0]
    whole = elapsed[-1]
    return np.expm1(-elapsed / time_constant) / np.expm1(-whole / time_constant)
