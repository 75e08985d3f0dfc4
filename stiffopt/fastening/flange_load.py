"""Loads of a flange, forces on its bolts, and the clamp load that they require (VDI 2230 R2).

Loads are (..., 6) in the flange's own axes, the third along the axis of the joint, origin in the
middle of the pressed face: [F_x, F_y, F_z, M_x, M_y, T] in N and N m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class FlangeLoads:
    """Loads of one flange in all load cases."""

    names: tuple[str, ...]  # names of load cases and instants of motions
    values: np.ndarray  # (K, 6) [N], [N m]
    alternating: bool = False  # the torque, or a shear force, changes its sign during a motion

    @property
    def shear(self) -> np.ndarray:
        """|F_xy| (K,) [N]."""
        return np.asarray(np.hypot(self.values[:, 0], self.values[:, 1]))

    @property
    def axial(self) -> np.ndarray:
        """|F_z| (K,) [N]; the opening direction is unknown, so both signs are taken to open."""
        return np.asarray(np.abs(self.values[:, 2]))

    @property
    def tilting(self) -> np.ndarray:
        """|M_xy| (K,) [N m]."""
        return np.asarray(np.hypot(self.values[:, 3], self.values[:, 4]))

    @property
    def torque(self) -> np.ndarray:
        """|T| (K,) [N m]."""
        return np.asarray(np.abs(self.values[:, 5]))

    @property
    def has_force_or_tilting(self) -> bool:
        """True if a load case has a force or tilting moment besides torque."""
        return bool(self.values[:, :5].any())

    def torque_only(self) -> FlangeLoads:
        """Return the loads without forces and tilting moments, which a bearing carries."""
        values = np.zeros_like(self.values)
        values[:, 5] = self.values[:, 5]
        return FlangeLoads(names=self.names, values=values, alternating=self.alternating)


def bolt_angles(count: int) -> np.ndarray:
    """Return the angles of the bolts on their circle (count,) [rad], the first on the x axis."""
    return 2 * math.pi / count * np.arange(count)


def axial_forces(loads: np.ndarray, count: int, diameter: float, angles: np.ndarray) -> np.ndarray:
    """Return the axial working load F_A of bolts at given angles of a rigid flange (..., m) [N].

    F_A = F_z/n + 4 M/(n d) cos(angle from the most loaded bolt), positive where the load opens the
    joint: force and moment are in equilibrium ([VDI2230]_ part 2). At least three bolts: fewer
    cannot carry a moment about every axis.
    """
    tilt = loads[..., 3:4] * np.sin(angles) - loads[..., 4:5] * np.cos(angles)
    return np.asarray(loads[..., 2:3] / count + 4 / (count * diameter) * tilt)


def transverse_forces(
    loads: np.ndarray, count: int, radius: float, angles: np.ndarray
) -> np.ndarray:
    """Return the transverse loads F_Q (..., m, 2) of bolts: equal shares of shear and torque [N].

    `radius` is the lever of the torque: that of the bolt circle for bolts in shear, the friction
    radius for friction grip [m].
    """
    along = np.stack([-np.sin(angles), np.cos(angles)], axis=-1)
    share = loads[..., 5] / (count * radius)
    return np.asarray(loads[..., None, :2] / count + share[..., None, None] * along)


def friction_clamp_load(transverse: np.ndarray, friction: float) -> np.ndarray:
    """Return F_KQ = F_Q/mu_Tmin, clamp load that carries a transverse load (..., 2) [N] (R2/1)."""
    return np.asarray(np.linalg.norm(transverse, axis=-1) / friction)


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
    """Return the clamp load of one bolt at which the rim of a flange begins to open (R2/3).

    The load, |F_z| [N] and |M| [N m], reduces the uniform pressure n F_K/A by F_z/A + M R_o/I at
    the rim. Holes are subtracted from A and I, unless the undrilled ring opens earlier. `inner` and
    `outer` are radii of the ring, `circle` and `hole` diameters [m].
    """
    sections = [ring_section(inner, outer, count, circle, size) for size in (hole, 0.0)]
    lever = max(outer * area / moment for area, moment in sections)
    return np.asarray((axial + tilting * lever) / count)


def ring_section(
    inner: float, outer: float, count: int, circle: float, hole: float
) -> tuple[float, float]:
    """Return area [m^2] and second moment about a diameter [m^4] of a ring less its holes.

    Three or more evenly spaced holes have the same moment about every diameter.
    """
    one = math.pi / 4 * hole**2
    area = math.pi * (outer**2 - inner**2) - count * one
    moment = math.pi / 4 * (outer**4 - inner**4)
    moment -= count * (one * circle**2 / 8 + math.pi / 64 * hole**4)
    return area, moment
