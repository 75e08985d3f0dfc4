"""Synchronous belt stage: teeth on two pulleys and the span between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from stiffopt.connection.connection import LinearConnection
from stiffopt.declaration import (
    DETAIL,
    MODULUS,
    PART,
    POSITIVE,
    Angle,
    Bounds,
    Doc,
    Force,
    Length,
    Pressure,
    Ratio,
)
from stiffopt.symbolic import Quantity

# Plausible span stiffness [N per unit strain], from rubber of 1 mm^2 to wide steel.
_SPAN_STIFFNESS_BOUNDS = Bounds(above=0.0, plausible=(1.0, 1e9))
_WRAP_ANGLE_BOUNDS = Bounds(above=0.0, below=2 * math.pi)


@dataclass(frozen=True, kw_only=True)
class TimingBelt(LinearConnection):
    """Belt stage, referred to the shaft of the first pulley.

    The pulley flank moves along the tangent, with components normal (cos beta) and parallel (sin
    beta) to the flank of the soft belt tooth. A pulley has K = z_m R^2 (K_n cos^2 beta + K_t sin^2
    beta) with K_n = E b h/(w/2) and K_t = G b h/(w/2); both spans act while they are taut. Valid up
    to `slack_torque`, where one span goes slack and the stage loses half of the spans' stiffness.
    Belt teeth are soft and smooth: no rough-contact law applies.
    """

    kind: ClassVar[str] = "timing_belt"
    takes_preload: ClassVar[bool] = True
    teeth: Annotated[int, POSITIVE, Doc("Teeth of the first pulley, on the motor's side.")]
    teeth_driven: Annotated[int, POSITIVE, Doc("Teeth of the second pulley.")]
    pitch: Annotated[Length, DETAIL, Doc("Pitch of the belt.")]
    width: Annotated[Length, PART, Doc("Width b of the belt.")]
    tooth_height: Annotated[Length, DETAIL, Doc("Height h of a belt tooth.")]
    tooth_root_width: Annotated[Length, DETAIL, Doc("Width w of a belt tooth at its root.")]
    span_stiffness: Annotated[
        Force, _SPAN_STIFFNESS_BOUNDS, Doc("Force per unit strain of one span.")
    ]
    span_length: Annotated[Length, PART, Doc("Free length of one span.")]
    wrap: Annotated[Angle, _WRAP_ANGLE_BOUNDS, Doc("Wrap angle on the first pulley.")] = math.pi
    wrap_driven: Annotated[Angle, _WRAP_ANGLE_BOUNDS, Doc("Wrap angle on the second pulley.")] = (
        math.pi
    )
    flank_angle: Annotated[
        Angle,
        Bounds(above=-0.1, below=math.pi / 2),
        Doc("Angle beta between the normal of a flank and the tangent."),
    ] = math.pi / 9
    tooth_modulus: Annotated[Pressure, MODULUS, Doc("Young's modulus of the tooth.")] = 60e6
    tooth_poisson: Annotated[
        Ratio, Bounds(above=0.0, below=0.5), Doc("Poisson's ratio of the tooth.")
    ] = 0.48
    teeth_in_mesh_max: Annotated[
        Ratio,
        POSITIVE,
        Doc("Largest number of teeth that carry load, since it falls off along the arc."),
    ] = 6.0

    @property
    def radius(self) -> float:
        """Pitch radius of the first pulley [m]."""
        return self.teeth * self.pitch / (2 * math.pi)

    @property
    def tooth_stiffness(self) -> float:
        """Tangential stiffness of one belt tooth [N/m]."""
        block = self.width * self.tooth_height / (self.tooth_root_width / 2)
        shear_modulus = self.tooth_modulus / (2 * (1 + self.tooth_poisson))
        return block * (
            self.tooth_modulus * math.cos(self.flank_angle) ** 2
            + shear_modulus * math.sin(self.flank_angle) ** 2
        )

    def teeth_in_mesh(self) -> tuple[float, float]:
        """Return the number of loaded teeth on the first and second pulley."""
        first = self.teeth * self.wrap / (2 * math.pi)
        second = self.teeth_driven * self.wrap_driven / (2 * math.pi)
        return min(first, self.teeth_in_mesh_max), min(second, self.teeth_in_mesh_max)

    @property
    def compliance(self) -> float:
        """Wind-up of the stage on the first shaft per torque there [rad/(N m)].

        The tangential force T/R is the same on both pulleys: all three springs act in series at
        the radius of the first pulley.
        """
        first, second = self.teeth_in_mesh()
        along = (1 / first + 1 / second) / self.tooth_stiffness
        span = self.span_length / (2 * self.span_stiffness)
        return (along + span) / self.radius**2

    def slack_torque(self, preload: Quantity | None = None) -> Quantity:
        """Return the torque at which a span goes slack, 2 F R [N m]; nan without preload."""
        force = self._preload_or_own(preload)
        return math.nan if force is None else 2 * force * self.radius
