"""What a flange carries, and what of it comes to each of its bolts.

Loads are (..., 6) in the flange's own axes, the third along the axis of the joint, origin in the
middle of the pressed face: [F_x, F_y, F_z, M_x, M_y, T] in N and N m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class FlangeLoads:
    """Loads of one flange, of which every check takes its own worst.

    Parameters
    ----------
    names : tuple of str
        Load cases, and instants of motions.
    values : array (K, 6)
        [N], [N m].
    alternating : bool
        Whether the torque, or a shear force, changes its sign during a motion.
    """

    names: tuple[str, ...]
    values: np.ndarray
    alternating: bool = False

    @property
    def shear(self) -> np.ndarray:
        """|F_xy| (K,) [N]."""
        return np.asarray(np.hypot(self.values[:, 0], self.values[:, 1]))

    @property
    def axial(self) -> np.ndarray:
        """|F_z| (K,) [N]: which way opens the joint is not known, so both are taken to."""
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
    def more_than_torque(self) -> bool:
        """Whether any force or tilting moment comes with the torque."""
        return bool(self.values[:, :5].any())

    def torque_alone(self) -> FlangeLoads:
        """What a bearing beside the flange leaves to it."""
        values = np.zeros_like(self.values)
        values[:, 5] = self.values[:, 5]
        return FlangeLoads(names=self.names, values=values, alternating=self.alternating)


def bolt_angles(count: int) -> np.ndarray:
    """Places of the bolts on their circle (count,) [rad], the first on the x axis."""
    return 2 * math.pi / count * np.arange(count)


def axial_forces(loads: np.ndarray, count: int, diameter: float, angles: np.ndarray) -> np.ndarray:
    """Axial working load F_A of bolts at some places of the circle.

    A rigid flange tilts without bending: F_z/n + 4 M/(n d) times the cosine of the angle from the
    bolt that the moment loads most. The forces of all bolts balance force and moment.

    Parameters
    ----------
    loads : array (..., 6)
    count : int
        n, at least 3: fewer bear no moment about every axis.
    diameter : float
        d of the bolt circle [m].
    angles : array (m,) [rad]

    Returns
    -------
    array (..., m) [N], above 0 where the load pulls the parts from each other

    References
    ----------
    [VDI2230]_ part 2, rigid flange.
    """
    tilt = loads[..., 3:4] * np.sin(angles) - loads[..., 4:5] * np.cos(angles)
    return np.asarray(loads[..., 2:3] / count + 4 / (count * diameter) * tilt)


def transverse_forces(
    loads: np.ndarray, count: int, radius: float, angles: np.ndarray
) -> np.ndarray:
    """Transverse load F_Q of bolts: equal shares of the shear, and the torque's along the circle.

    Parameters
    ----------
    loads : array (..., 6)
    count : int
    radius : float
        At which the torque acts: the bolt circle for bolts that bear, the friction radius of the
        ring where it holds by friction [m].
    angles : array (m,) [rad]

    Returns
    -------
    array (..., m, 2) [N]
    """
    along = np.stack([-np.sin(angles), np.cos(angles)], axis=-1)
    share = loads[..., 5] / (count * radius)
    return np.asarray(loads[..., None, :2] / count + share[..., None, None] * along)
