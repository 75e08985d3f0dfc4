"""Smooth contact of two cylinders along a line.

Source: Johnson, Contact Mechanics (1985), section 4.2.
"""

from __future__ import annotations

import math

import numpy as np

from stiffopt.symbolic import Quantity


def half_width(force_per_length: Quantity, radius: Quantity, contact_modulus: Quantity) -> Quantity:
    """Half width of the contact strip [m]: sqrt(4 F' R/(pi E*)).

    Parameters
    ----------
    force_per_length : float
        F' [N/m], 0 or above.
    radius : float
        Relative radius of curvature, 1/R = 1/R1 + 1/R2 [m].
    contact_modulus : float
        E* [Pa].
    """
    return np.sqrt(4 * force_per_length * radius / (math.pi * contact_modulus))


def mean_pressure(
    force_per_length: Quantity, radius: Quantity, contact_modulus: Quantity
) -> Quantity:
    """Mean pressure over the strip [Pa], sqrt(pi E* F'/(16 R)); the peak is 4/pi times larger."""
    return np.sqrt(math.pi * contact_modulus * force_per_length / (16 * radius))
