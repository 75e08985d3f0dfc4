"""How sure values in newton metres are where the drives' torque constants have tolerances.

Recorded torques are currents times constants that nobody knows better than their tolerances. What
the nominal model says of a torque has these as nominal values of the fit; what an effect adds is
read on the same scale, which no noise, run or stretch tells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import Estimate


def doubted_by_scale(parameters: Estimate, selected: Sequence[Selected]) -> Estimate:
    """The estimate, where what the fit leaves open of a joint's scale counts as a deviation more.

    Parameters
    ----------
    parameters : Estimate
    selected : sequence of Selected
        The same effects; the scale is that of the channel that each changes most.

    Notes
    -----
    All amplitudes of an effect share one scale, so that their ratios are as sure as before.
    """
    known = np.sqrt(np.diag(parameters.covariance))
    scales = []
    for each in selected:
        name = f"torque_constant {each.channel + 1}"
        # Channels behind the last joint are angles.
        there = name in parameters.nuisance
        scales.append(float(known[parameters.nuisance.index(name)]) if there else 0.0)
    return parameters.scaled(scales)
