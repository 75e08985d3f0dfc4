"""R9: alternating stress of a bolt against what it endures for ever."""

from __future__ import annotations

from typing import Literal

from stiffopt.drivetrain.catalogue import BoltData
from stiffopt.symbolic import Quantity

# Asked for in design [-]; VDI 2230 leaves S_D to the engineer and names 1.2.
MIN_ENDURANCE_SAFETY = 1.2


def endurance_limit(
    bolt: BoltData,
    rolled: Literal["before", "after"],
    mean_force: Quantity = 0.0,
    proof_stress: float = 1.0,
) -> Quantity:
    """Stress amplitude that a thread endures, 2e6 cycles and more [Pa].

    Rolled before heat treatment sigma_ASV = 0.85 (150/d + 45) MPa with d in mm (R9/5); after it
    sigma_ASG = (2 - F_Sm/F_0.2) sigma_ASV (R9/6), here never below sigma_ASV.

    Parameters
    ----------
    bolt : BoltData
    rolled : {"before", "after"}
    mean_force : scalar
        F_Sm [N]; matters for "after" alone. Valid for 0.3 to 1 of F_0.2; below 0.3 what it has
        there is taken.
    proof_stress : float
        R_p0.2 [Pa].
    """
    before = 0.85e6 * (150e-3 / bolt.diameter + 45)
    if rolled == "before":
        return before
    share = mean_force / (proof_stress * bolt.stress_area)
    share = min(max(float(share), 0.3), 1.0)
    return (2.0 - share) * before


def stress_amplitude(bolt: BoltData, upper: Quantity, lower: Quantity) -> Quantity:
    """sigma_a = (F_SAo - F_SAu)/(2 A_S) [Pa] (R9/1), for the bolt's parts of the working load."""
    return (upper - lower) / (2 * bolt.stress_area)
