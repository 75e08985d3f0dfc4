"""R11: thread that must be engaged so that the bolt breaks before a thread strips."""

from __future__ import annotations

import math

from stiffopt.drivetrain.catalogue import BoltData, ClampedMaterial

# Shear over tensile strength of bolts.
_BOLT_SHEAR = 0.6
_TAN_FLANK_ANGLE = math.tan(math.pi / 6)


def stripping_length(bolt: BoltData, tensile_strength: float, material: ClampedMaterial) -> float:
    """m_eff of a tapped hole at which either thread strips at R_m A_S of the bolt [m] (R11/1).

    m_eff = R_m A_S P/(C_3 tau_BM (P/2 + (d - D_2) tan 30 deg) pi d), and the like with C_2 for the
    bolt's own thread at D_1; C_2, C_3 by the ratio of strengths R_S. Run-out and chamfer, about
    two pitches, come on top.

    Parameters
    ----------
    bolt : BoltData
    tensile_strength : float
        R_m of the bolt [Pa].
    material : ClampedMaterial
        With the thread.

    References
    ----------
    [VDI2230]_ R11, after Alexander; C_1 = 1, since a tapped part does not widen as a nut does.
    """
    d, pitch, middle = bolt.diameter, bolt.pitch, bolt.pitch_diameter
    inner = d - 1.0825 * pitch
    # Shear areas a length of thread [m].
    tapped = math.pi * d * (0.5 + (d - middle) * _TAN_FLANK_ANGLE / pitch)
    own = math.pi * inner * (0.5 + (middle - inner) * _TAN_FLANK_ANGLE / pitch)
    strip_tapped = tapped * material.shear_ratio * material.strength
    strip_own = own * _BOLT_SHEAR * tensile_strength
    ratio = strip_tapped / strip_own
    strength = min(_tapped_factor(ratio) * strip_tapped, _bolt_factor(ratio) * strip_own)
    return tensile_strength * bolt.stress_area / strength


def _tapped_factor(ratio: float) -> float:
    """C_3 by R_S, the weaker the part."""
    if ratio >= 1.0:
        return 0.897
    r = max(ratio, 0.4)
    return 0.728 + 1.769 * r - 2.896 * r**2 + 1.296 * r**3


def _bolt_factor(ratio: float) -> float:
    """C_2 by R_S, the stronger the part."""
    if ratio <= 1.0:
        return 0.897
    r = min(ratio, 2.2)
    return 5.594 - 13.682 * r + 14.107 * r**2 - 6.057 * r**3 + 0.9353 * r**4
