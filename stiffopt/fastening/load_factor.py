"""R3: which part of an axial working load the bolt takes, and which the clamped parts lose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Load introduction factor n by type of joint: rows l_A/h = 0, 0.1, 0.2, 0.3, columns
# a_k/h = 0, 0.1, 0.3, 0.5 (VDI 2230 Table 2).
_CONNECTION_DISTANCE_RATIOS, _CONNECTION_LENGTH_RATIOS = (0.0, 0.1, 0.3, 0.5), (0.0, 0.1, 0.2, 0.3)
_LOAD_INTRODUCTION_FACTORS = {
    "SV1": ((0.70, 0.55, 0.30, 0.13), (0.52, 0.41, 0.22, 0.10), (0.34, 0.28, 0.16, 0.07),
            (0.16, 0.14, 0.12, 0.04)),
    "SV2": ((0.57, 0.46, 0.30, 0.13), (0.44, 0.36, 0.21, 0.10), (0.30, 0.25, 0.16, 0.07),
            (0.16, 0.14, 0.12, 0.04)),
    "SV3": ((0.44, 0.37, 0.26, 0.12), (0.35, 0.30, 0.20, 0.09), (0.26, 0.23, 0.15, 0.07),
            (0.16, 0.14, 0.12, 0.04)),
    "SV4": ((0.42, 0.34, 0.25, 0.12), (0.33, 0.27, 0.16, 0.08), (0.23, 0.19, 0.12, 0.06),
            (0.14, 0.13, 0.10, 0.03)),
    "SV5": ((0.30, 0.25, 0.22, 0.10), (0.24, 0.21, 0.15, 0.07), (0.19, 0.17, 0.12, 0.06),
            (0.14, 0.13, 0.10, 0.03)),
    "SV6": ((0.15, 0.14, 0.14, 0.07), (0.13, 0.12, 0.10, 0.06), (0.11, 0.11, 0.09, 0.06),
            (0.10, 0.10, 0.08, 0.03)),
}  # fmt: skip


def load_introduction_factor(kind: str, a_over_h: float, l_over_h: float) -> float:
    """N of a type of joint SV1 to SV6, linear between the rows and columns of Table 2.

    Parameters
    ----------
    kind : str
        SV1 to SV6: where the load enters, from the head (SV1) to the face (SV6).
    a_over_h, l_over_h : float
        Distance of the connected body from the bolt and its length, over the height h of the
        clamped parts; beyond the table its last value.
    """
    table = np.array(_LOAD_INTRODUCTION_FACTORS[kind])
    rows = [np.interp(a_over_h, _CONNECTION_DISTANCE_RATIOS, row) for row in table]
    return float(np.interp(l_over_h, _CONNECTION_LENGTH_RATIOS, rows))


@dataclass(frozen=True)
class LoadFactor:
    """Part of F_A that the bolt takes, at both ends of what n may be.

    Parameters
    ----------
    most : float
        Phi with the largest n: loads the bolt.
    least : float
        Phi with the smallest n: 1 - Phi unloads the clamped parts.
    """

    most: float
    least: float


def load_factor(bolt: float, plates: float, introduction: float | None) -> LoadFactor:
    """Phi_n = n delta_P/(delta_S + delta_P), concentric (R3/1).

    Parameters
    ----------
    bolt, plates : float
        delta_S, delta_P [m/N].
    introduction : float or None
        n; None: unknown, so 1 for the bolt and 0 for the clamped parts.
    """
    whole = plates / (bolt + plates)
    if introduction is None:
        return LoadFactor(most=whole, least=0.0)
    return LoadFactor(most=introduction * whole, least=introduction * whole)


def eccentric_load_factor(
    bolt: float,
    plates: float,
    introduction: float,
    *,
    bolt_offset: float,
    load_offset: float,
    length: float,
    modulus: float,
    bending_moment_of_area: float,
) -> float:
    """Phi*_en = n delta_P**/(delta_S + delta_P*), bolt and load off the axis of the clamped parts.

    delta_P* = delta_P + s^2 l_K/(E I_Bers), delta_P** = delta_P + a s l_K/(E I_Bers).

    Parameters
    ----------
    bolt, plates : float
        delta_S, delta_P [m/N].
    introduction : float
        n.
    bolt_offset, load_offset : float
        s_sym and a, of the bolt and of the load from the axis of the clamped parts [m]; of one
        sign on one side.
    length : float
        l_K [m].
    modulus : float
        E of the clamped parts [Pa].
    bending_moment_of_area : float
        I_Bers [m^4].

    References
    ----------
    [VDI2230]_ R3, eccentric clamping and load.
    """
    bending = length / (modulus * bending_moment_of_area)
    clamped = plates + bolt_offset**2 * bending
    loaded = plates + load_offset * bolt_offset * bending
    return introduction * loaded / (bolt + clamped)
