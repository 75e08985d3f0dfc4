"""Twist of a round shaft."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from stiffopt.connection.linear import LinearConnection
from stiffopt.contact.validate import require_not_negative, require_ordered, require_positive


@dataclass(frozen=True, kw_only=True)
class Shaft(LinearConnection):
    """Round shaft, solid or hollow, stiffness G pi (d^4 - d_i^4)/(32 L).

    Parameters
    ----------
    diameter, length : float
        [m].
    shear_modulus : float
        G [Pa]; steel 80e9.
    bore : float
        Inner diameter d_i [m], 0 for a solid shaft.
    """

    kind: ClassVar[str] = "shaft"
    diameter: float
    length: float
    shear_modulus: float = 80e9
    bore: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(
            self.owner,
            diameter=self.diameter,
            length=self.length,
            shear_modulus=self.shear_modulus,
        )
        require_not_negative(self.owner, bore=self.bore)
        require_ordered(self.owner, bore=self.bore, diameter=self.diameter)

    @property
    def is_contact(self) -> bool:
        """False."""
        return False

    @property
    def stiffness(self) -> float:
        """Torsional stiffness [N m/rad]."""
        polar = math.pi * (self.diameter**4 - self.bore**4) / 32
        return self.shear_modulus * polar / self.length

    @property
    def compliance(self) -> float:
        """Wind-up per torque [rad/(N m)]."""
        return 1 / self.stiffness
