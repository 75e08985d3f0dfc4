"""R2: the clamp load that a joint needs, against slip and against opening on one side."""

from __future__ import annotations

import math

import numpy as np


def friction_clamp_load(transverse: np.ndarray, friction: float) -> np.ndarray:
    """F_KQ = F_Q/mu_T: clamp load that holds a transverse load by friction (R2/1).

    Parameters
    ----------
    transverse : array (..., 2)
        F_Q of one bolt, shear and torque added as vectors [N].
    friction : float
        Least coefficient of the face, mu_Tmin.
    """
    return np.asarray(np.linalg.norm(transverse, axis=-1) / friction)


def eccentric_opening_load(
    axial: float,
    bending: float,
    *,
    area: float,
    moment_of_area: float,
    bolt_offset: float,
    load_offset: float,
    edge: float,
) -> float:
    """F_KA of a single bolt: clamp load at which the edge of its face begins to open (R2/3).

    F_KA = F_A A_D (a u - s u)/(I_BT + s u A_D) + M_B u A_D/(I_BT + s u A_D).

    Parameters
    ----------
    axial, bending : float
        F_A [N] and M_B [N m].
    area, moment_of_area : float
        A_D [m^2] and I_BT [m^4] of the face.
    bolt_offset, load_offset, edge : float
        s_sym, a and u: bolt, load and edge from the axis of the face [m].
    """
    below = moment_of_area + bolt_offset * edge * area
    return area * edge * (axial * (load_offset - bolt_offset) + bending) / below


def ring_opening_load(
    axial: np.ndarray,
    tilting: np.ndarray,
    *,
    inner: float,
    outer: float,
    count: int,
    circle: float,
    hole: float,
) -> np.ndarray:
    """Clamp load of one bolt at which the rim of a flange begins to open (R2/3 of the whole ring).

    The pressure n F_K/A is even before the load; F_z and M take off F_z/A + M R_o/I. Holes are
    subtracted from A and I, unless the undrilled ring opens earlier.

    Parameters
    ----------
    axial, tilting : array (K,)
        |F_z| [N], |M| [N m].
    inner, outer : float
        Radii of the ring [m].
    count : int
    circle, hole : float
        Diameters of the bolt circle and of one hole [m].
    """
    sections = [ring_section(inner, outer, count, circle, size) for size in (hole, 0.0)]
    lever = max(outer * area / moment for area, moment in sections)
    return np.asarray((axial + tilting * lever) / count)


def ring_section(
    inner: float, outer: float, count: int, circle: float, hole: float
) -> tuple[float, float]:
    """Area [m^2] and moment of area about a diameter [m^4] of a ring less its holes.

    At least three holes evenly on the circle have the same moment about every diameter.
    """
    one = math.pi / 4 * hole**2
    area = math.pi * (outer**2 - inner**2) - count * one
    moment = math.pi / 4 * (outer**4 - inner**4)
    moment -= count * (one * circle**2 / 8 + math.pi / 64 * hole**4)
    return area, moment
