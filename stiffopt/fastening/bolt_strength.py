"""Strength of a bolt while it is tightened: tension and torsion together."""

from __future__ import annotations

import math

import numpy as np

from stiffopt.drivetrain.catalogue import BoltData
from stiffopt.symbolic import Quantity


def largest_assembly_preload(
    bolt: BoltData, proof_stress: Quantity, thread_friction: Quantity, yield_share: Quantity = 0.9
) -> Quantity:
    """Preload at which tightening uses the permitted share of the yield strength.

    F_M,zul = nu R_p0.2 A_0 / sqrt(1 + 3 [3/2 d2/d_S (P/(pi d2) + mu_G/cos 30 deg)]^2), with the
    stress area A_0 = A_S: socket head bolts as they are used at reducers have no thinner shank.

    Parameters
    ----------
    bolt : BoltData
    proof_stress : scalar [Pa]
        R_p0.2.
    thread_friction : scalar [-]
        mu_G; the torque that it needs twists the bolt.
    yield_share : scalar [-]
        nu.

    Returns
    -------
    scalar [N]

    References
    ----------
    [VDI2230]_, assembly preload; 1.155 = 1/cos 30 deg is printed there.
    """
    thread = bolt.pitch / (math.pi * bolt.pitch_diameter) + thread_friction / math.cos(math.pi / 6)
    torsion = 1.5 * bolt.pitch_diameter / bolt.stress_diameter * thread
    return yield_share * proof_stress * bolt.stress_area / np.sqrt(1 + 3 * torsion**2)
