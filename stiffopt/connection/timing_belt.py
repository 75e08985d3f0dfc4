"""Synchronous belt stage: teeth on two pulleys and the span between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from stiffopt.connection.linear import LinearConnection
from stiffopt.contact.validate import require_between, require_positive
from stiffopt.symbolic import Quantity


@dataclass(frozen=True, kw_only=True)
class TimingBelt(LinearConnection):
    """Belt stage, described on the shaft of the first pulley.

    The soft belt tooth is pressed by the flank of the pulley tooth: a rotation moves the flank
    along the tangent, which splits into a part normal to the flank (cos beta) and one along it
    (sin beta). A pulley has K = z_m R^2 (K_n cos^2 beta + K_t sin^2 beta) with
    K_n = E b h/(w/2) and K_t = G b h/(w/2); both spans act while they are taut.

    Parameters
    ----------
    teeth, teeth_driven : int
        Of the first and second pulley.
    pitch, width : float
        Belt pitch and width b [m].
    tooth_height, tooth_root_width : float
        h and w [m].
    wrap, wrap_driven : float
        Wrap angles on the pulleys [rad].
    flank_angle : float
        beta, between flank normal and tangent [rad].
    modulus, poisson : float
        Of the tooth material, [Pa] and [-].
    teeth_effective_max : float
        At most so many teeth carry, since the load falls off along the arc.
    span_stiffness : float
        Force per unit strain of one span [N].
    span_length : float
        Free length of one span [m].
    preload : float or None
        Pretension force of one span [N]; needed for `slack_torque`.

    Notes
    -----
    Valid up to `slack_torque`, where one span goes slack and the stage loses half of the spans'
    stiffness. Belt teeth are soft and smooth: no rough-contact law applies.
    """

    kind: ClassVar[str] = "timing_belt"
    takes_preload: ClassVar[bool] = True
    teeth: int
    teeth_driven: int
    pitch: float
    width: float
    tooth_height: float
    tooth_root_width: float
    span_stiffness: float
    span_length: float
    wrap: float = math.pi
    wrap_driven: float = math.pi
    flank_angle: float = math.radians(20.0)
    modulus: float = 60e6
    poisson: float = 0.48
    teeth_effective_max: float = 6.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(
            self.owner,
            teeth=self.teeth,
            teeth_driven=self.teeth_driven,
            pitch=self.pitch,
            width=self.width,
            tooth_height=self.tooth_height,
            tooth_root_width=self.tooth_root_width,
            span_stiffness=self.span_stiffness,
            span_length=self.span_length,
            modulus=self.modulus,
            teeth_effective_max=self.teeth_effective_max,
        )
        require_between(self.owner, 0.0, 2 * math.pi, wrap=self.wrap, wrap_driven=self.wrap_driven)
        require_between(self.owner, -0.1, math.pi / 2, flank_angle=self.flank_angle)
        require_between(self.owner, 0.0, 0.5, poisson=self.poisson)

    @property
    def radius(self) -> float:
        """Pitch radius of the first pulley [m]."""
        return self.teeth * self.pitch / (2 * math.pi)

    @property
    def tooth_stiffness(self) -> float:
        """Tangential stiffness of one belt tooth [N/m]."""
        block = self.width * self.tooth_height / (self.tooth_root_width / 2)
        shear_modulus = self.modulus / (2 * (1 + self.poisson))
        return block * (
            self.modulus * math.cos(self.flank_angle) ** 2
            + shear_modulus * math.sin(self.flank_angle) ** 2
        )

    def teeth_in_mesh(self) -> tuple[float, float]:
        """Teeth that carry on the first and the second pulley."""
        first = self.teeth * self.wrap / (2 * math.pi)
        second = self.teeth_driven * self.wrap_driven / (2 * math.pi)
        return min(first, self.teeth_effective_max), min(second, self.teeth_effective_max)

    @property
    def compliance(self) -> float:
        """Wind-up of the stage on the first shaft per torque there [rad/(N m)].

        The tangential force T/R is the same on both pulleys, and so is the travel that counts:
        all three springs act at the radius of the first pulley.
        """
        first, second = self.teeth_in_mesh()
        along = (1 / first + 1 / second) / self.tooth_stiffness
        span = self.span_length / (2 * self.span_stiffness)
        return (along + span) / self.radius**2

    def pressure(self, torque: Quantity, preload: Quantity | None = None) -> Quantity:
        """Pressure on the belt teeth of the pulley with fewer teeth in mesh [Pa]."""
        carrying = min(self.teeth_in_mesh()) * self.width * self.tooth_height
        return np.absolute(torque) / (self.radius * carrying)

    def slack_torque(self, preload: Quantity | None = None) -> Quantity:
        """Torque at which the slack span loses its tension, 2 F R [N m]; nan without preload."""
        force = self._preload(preload)
        return math.nan if force is None else 2 * force * self.radius
