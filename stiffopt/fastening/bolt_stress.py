"""R8: stress of a bolt in service, tension and what tightening leaves of torsion."""

from __future__ import annotations

import math

from stiffopt.drivetrain.catalogue import BoltData
from stiffopt.symbolic import Quantity

# k_tau: part of the torsion that counts in service (VDI 2230 R8; 1 where the joint slips).
RESIDUAL_TORSION_SHARE = 0.5


def thread_torque(bolt: BoltData, preload: Quantity, friction: float) -> Quantity:
    """M_G = F_M d2/2 (P/(pi d2) + 1.155 mu_G) [N m], which twists the bolt (R8/3)."""
    lever = bolt.pitch / (2 * math.pi) + bolt.pitch_diameter / 2 * friction / math.cos(math.pi / 6)
    return preload * lever


def torsion_stress(bolt: BoltData, preload: Quantity, friction: float) -> Quantity:
    """Tau = M_G/W_P with W_P = pi/16 d_S^3 [Pa] (R8/3)."""
    return thread_torque(bolt, preload, friction) / (math.pi / 16 * bolt.stress_diameter**3)


def working_stress(
    bolt: BoltData, preload: Quantity, additional: Quantity, friction: float
) -> Quantity:
    """sigma_red,B = sqrt(sigma_z^2 + 3 (k_tau tau)^2) [Pa] (R8/4).

    Parameters
    ----------
    bolt : BoltData
    preload : scalar
        Largest assembly preload F_M [N].
    additional : scalar
        F_SA + what warming adds [N].
    friction : float
        mu_G.
    """
    tension = (preload + additional) / bolt.stress_area
    twist = RESIDUAL_TORSION_SHARE * torsion_stress(bolt, preload, friction)
    return (tension**2 + 3 * twist**2) ** 0.5


def largest_working_preload(
    bolt: BoltData, proof_stress: float, additional: float, friction: float
) -> float:
    """Preload at which the working stress reaches R_p0.2 [N]; 0 where the load alone does."""
    twist = 3 * (RESIDUAL_TORSION_SHARE * float(torsion_stress(bolt, 1.0, friction))) ** 2
    square = 1 / bolt.stress_area**2 + twist
    half = additional / bolt.stress_area**2
    rest = (additional / bolt.stress_area) ** 2 - proof_stress**2
    if rest >= 0.0:
        return 0.0
    return (-half + math.sqrt(half**2 - square * rest)) / square
