"""Self-loosening: transverse movement of the clamped parts at which a bolt turns itself loose."""

from __future__ import annotations

import math

from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.catalogue import BoltData


def transverse_slip_limit(
    bolt: BoltData, length: float, preload: float, head_friction: float
) -> float:
    """Movement of the parts at which the head slips on them [m].

    Both ends of the bolt clamped, it bends by s = F_Q l_K^3/(12 E I_3); the head slips where F_Q
    reaches mu_K F_V. Slip there again and again turns the bolt loose, whatever the torque.

    Parameters
    ----------
    bolt : BoltData
    length : float
        l_K [m].
    preload : float
        Least in service [N].
    head_friction : float
        Least mu_K.

    References
    ----------
    [Junker1969]_, [VDI2230]_ on self-loosening.
    """
    moment = math.pi / 64 * bolt.core_diameter**4
    return head_friction * preload * length**3 / (12 * catalogue.bolt_modulus() * moment)
