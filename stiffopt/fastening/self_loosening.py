"""Self-loosening: transverse movement of the clamped parts at which a bolt turns itself loose."""

from __future__ import annotations

import math

from stiffopt.drivetrain.fasteners import BoltData


def transverse_slip_limit(
    bolt: BoltData, length: float, preload: float, head_friction: float, modulus: float
) -> float:
    """Movement of the parts at which the head slips on them [m].

    Both ends of the bolt clamped against rotation, a beam of cylinders bends by s = F_Q c; c is
    l_K^3/(12 E I_3) where the thread is all. The head slips where F_Q reaches mu_K F_V. Slip there
    again and again turns the bolt loose, whatever the torque.

    Parameters
    ----------
    bolt : BoltData
    length : float
        l_K [m].
    preload : float
        Least in service [N].
    head_friction : float
        Least mu_K.
    modulus : float
        Young's modulus of the bolt [Pa].

    References
    ----------
    [Junker1969]_, [VDI2230]_ on self-loosening.
    """
    # Rotation by a unit moment, by a unit force at the end, and deflection by that force: integrals
    # of 1, x and x^2 over 1/(E I).
    turn, both, moved, start = 0.0, 0.0, 0.0, 0.0
    for part, diameter in bolt.sections(length):
        stiffness, end = modulus * math.pi / 64 * diameter**4, start + part
        turn += part / stiffness
        both += (end**2 - start**2) / (2 * stiffness)
        moved += (end**3 - start**3) / (3 * stiffness)
        start = end
    return head_friction * preload * (moved - both**2 / turn)
