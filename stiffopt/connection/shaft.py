"""Twist of a round shaft."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from stiffopt.connection.connection import LinearConnection
from stiffopt.contact.validate import require_ordered
from stiffopt.declaration import MODULUS, NOT_NEGATIVE, PART, Doc, Length, Pressure


@dataclass(frozen=True, kw_only=True)
class Shaft(LinearConnection):
    """Round shaft, solid or hollow, stiffness G pi (d^4 - d_i^4)/(32 L)."""

    kind: ClassVar[str] = "shaft"
    diameter: Annotated[Length, PART, Doc("Outer diameter d.")]
    length: Annotated[Length, PART, Doc("Length L between the two ends that twist.")]
    shear_modulus: Annotated[Pressure, MODULUS, Doc("Shear modulus G; default steel.")] = 80e9
    bore: Annotated[Length, NOT_NEGATIVE, Doc("Inner diameter d_i, 0 for a solid shaft.")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_ordered(self.owner, bore=self.bore, diameter=self.diameter)

    @property
    def stiffness(self) -> float:
        """Torsional stiffness [N m/rad]."""
        polar = math.pi * (self.diameter**4 - self.bore**4) / 32
        return self.shear_modulus * polar / self.length

    @property
    def compliance(self) -> float:
        """Wind-up per torque [rad/(N m)]."""
        return 1 / self.stiffness
