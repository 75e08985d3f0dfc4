"""R4: how a change of temperature changes the preload of a bolt."""

from __future__ import annotations


def thermal_change(
    length: float, bolt_expansion: float, part_expansion: float, change: float, compliance: float
) -> float:
    """Delta F_Vth = l_K (alpha_S - alpha_P) Delta T/(delta_S + delta_P) [N] (R4/2).

    Preload that is lost, above 0, where a joint as warm as its bolt changes its temperature.

    Parameters
    ----------
    length : float
        l_K [m].
    bolt_expansion, part_expansion : float
        alpha_S, alpha_P, for 1 K.
    change : float
        Delta T from assembly [K].
    compliance : float
        delta_S + delta_P [m/N]; moduli as at assembly, which errs by 1 % for 30 K.
    """
    return length * (bolt_expansion - part_expansion) * change / compliance
