"""The torque that a workshop sets."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WorkshopTorque:
    """Wrench setting for a largest assembly preload F, and the band around it.

    The stated friction is the lowest that can occur, so the setting must not be exceeded; higher
    friction and an inexact wrench leave less preload, down to F/alpha_A.

    Parameters
    ----------
    nominal : float
        Setting of the wrench: leaves F at the stated friction [N m].
    lower : float
        Leaves F/alpha_A, the least preload that the design counts on, at the stated friction; a
        bolt that turns further below it is too loose [N m].
    upper : float
        Torque that must not be exceeded; the nominal one [N m].
    friction_factor : float
        Friction may be this many times the stated one before the nominal torque leaves less than
        F/alpha_A [-].
    """

    nominal: float
    lower: float
    upper: float
    friction_factor: float
