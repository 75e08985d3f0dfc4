"""Tightening of bolts: torque from preload and back, tightening factor, standard torques."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from stiffopt.contact.validate import require_positive
from stiffopt.declaration import (
    FRICTION,
    Bounds,
    Doc,
    Length,
    Ratio,
    TemperatureDifference,
    check_fields,
)
from stiffopt.drivetrain.fasteners import BoltData
from stiffopt.symbolic import Quantity

# Tightening factor alpha_A = F_max/F_min by method: unfavourable end of VDI 2230 Table A8. A torque
# wrench has 1.6 to 2.0 with estimated friction (class B), 1.4 to 1.6 with friction measured on the
# parts.
SCATTER_BY_METHOD = {
    "torque_wrench": 2.0,
    "torque_wrench_tested": 1.6,
    "angle": 1.4,
    "yield": 1.4,
    "hydraulic": 1.6,
    "elongation": 1.3,
    "impact": 4.0,
}
# Scatter of a torque wrench of +-5 %, largest over least.
_WRENCH_SCATTER = 1.05 / 0.95

_FRICTION_BOUNDS = Bounds(above=0.0, below=1.0, plausible=FRICTION.plausible)

# Preferred numbers R20 of ISO 3 between 1 and 10.
_R20_PREFERRED_NUMBERS = (
    *(1.0, 1.12, 1.25, 1.4, 1.6, 1.8, 2.0, 2.24, 2.5, 2.8),
    *(3.15, 3.55, 4.0, 4.5, 5.0, 5.6, 6.3, 7.1, 8.0, 9.0),
)


@dataclass(frozen=True, kw_only=True)
class Tightening:
    """Tightening of bolts and pins: method, friction, losses."""

    method: Annotated[
        Literal[
            "torque_wrench",
            "torque_wrench_tested",
            "angle",
            "yield",
            "hydraulic",
            "elongation",
            "impact",
        ],
        Doc("Control of tightening; tested: with friction measured on the parts."),
    ] = "torque_wrench"
    scatter: Annotated[
        Ratio | None,
        Bounds(least=1.0, plausible=(1.0, 10.0)),
        Doc("alpha_A, largest over least preload at assembly; default that of the method."),
    ] = None
    thread_friction: Annotated[
        Ratio,
        _FRICTION_BOUNDS,
        Doc("Lowest coefficient to be expected in the thread; higher is part of the scatter."),
    ] = 0.12
    head_friction: Annotated[
        Ratio,
        _FRICTION_BOUNDS,
        Doc("Lowest coefficient to be expected under the head; higher is part of the scatter."),
    ] = 0.12
    friction_highest: Annotated[
        Ratio | None,
        _FRICTION_BOUNDS,
        Doc(
            "Highest coefficient in thread and head to be expected: alpha_A of each bolt is at "
            "least that of this friction and a wrench of +-5 %."
        ),
    ] = None
    embedding: Annotated[
        Length | None,
        Bounds(least=0.0, most=1e-2, plausible=(1e-8, 3e-4)),
        Doc(
            "Embedding f_Z of one fastener, sum over its interfaces; default by roughness and "
            "number of interfaces (VDI 2230 Table 5)."
        ),
    ] = None
    temperature_change: Annotated[
        TemperatureDifference,
        Bounds(least=0.0, most=3000.0),
        Doc("Above or below assembly: differing thermal expansion changes the preload."),
    ] = 30.0

    def __post_init__(self) -> None:
        check_fields(self, "tightening")

    @property
    def alpha(self) -> float:
        """alpha_A = F_max/F_min at assembly, stated or of the method [-]."""
        return SCATTER_BY_METHOD[self.method] if self.scatter is None else self.scatter

    def alpha_of(self, bolt: BoltData | None) -> float:
        """Return alpha_A of a bolt [-] (R1), at least that of `friction_highest`; None: a screw."""
        if self.friction_highest is None or bolt is None:
            return self.alpha
        high = max(self.friction_highest, self.thread_friction)
        levers = [
            float(_torque_per_preload(bolt, high, max(self.friction_highest, self.head_friction))),
            float(_torque_per_preload(bolt, self.thread_friction, self.head_friction)),
        ]
        return max(self.alpha, _WRENCH_SCATTER * levers[0] / levers[1])


@dataclass(frozen=True)
class WorkshopTorque:
    """Wrench setting for a largest assembly preload F, with its tolerance band.

    The stated friction is the lowest expected, so the setting must not be exceeded; higher friction
    and wrench error leave less preload, down to F/alpha_A.
    """

    nominal: float  # setting of the wrench: leaves F at the stated friction [N m]
    # Leaves F/alpha_A, the least preload of the design, at the stated friction; a bolt that still
    # turns below it is too loose [N m].
    lower: float
    upper: float  # torque that must not be exceeded; the nominal one [N m]
    # Factor on the stated friction at which the nominal torque leaves F/alpha_A [-].
    friction_factor: float


def _torque_per_preload(
    bolt: BoltData, thread_friction: Quantity, head_friction: Quantity
) -> Quantity:
    """Return tightening torque over preload [m]."""
    return (
        bolt.pitch / (2 * math.pi)
        + bolt.pitch_diameter / (2 * math.cos(math.pi / 6)) * thread_friction
        + bolt.friction_diameter / 2 * head_friction
    )


def tightening_torque(
    bolt: BoltData, preload: Quantity, thread_friction: Quantity, head_friction: Quantity
) -> Quantity:
    """Return the tightening torque for a preload, scalar or (n,) [N m].

    M_A = F (P/(2 pi) + d2/(2 cos 30 deg) mu_G + D_Km/2 mu_K); VDI 2230 prints rounded coefficients,
    F (0.16 P + 0.58 d2 mu_G + D_Km/2 mu_K).
    """
    return preload * _torque_per_preload(bolt, thread_friction, head_friction)


def preload_at_torque(
    bolt: BoltData, torque: Quantity, thread_friction: Quantity, head_friction: Quantity
) -> Quantity:
    """Return the preload [N] at a tightening torque [N m]; inverse of `tightening_torque`."""
    return torque / _torque_per_preload(bolt, thread_friction, head_friction)


def standard_torques(lower: float, upper: float) -> np.ndarray:
    """Return the preferred numbers R20 of ISO 3 from `lower` > 0 to `upper`, ascending [N m]."""
    require_positive("standard torques", lower=lower, upper=upper)
    decades = range(math.floor(math.log10(lower)) - 1, math.floor(math.log10(upper)) + 2)
    # Rounded to the decimals printed on wrenches.
    torques = np.array(
        [round(step * 10.0**e, 3 - e) for e in decades for step in _R20_PREFERRED_NUMBERS]
    )
    slack = 1e-9
    return torques[(torques >= lower * (1 - slack)) & (torques <= upper * (1 + slack))]
