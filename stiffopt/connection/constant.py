"""Linear torsional spring of given stiffness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from stiffopt.connection.connection import LinearConnection
from stiffopt.declaration import POSITIVE, Doc, JointStiffness


@dataclass(frozen=True, kw_only=True)
class Constant(LinearConnection):
    """Linear torsional spring."""

    kind: ClassVar[str] = "constant"
    references: ClassVar[tuple[str, ...]] = ()
    stiffness: Annotated[JointStiffness, POSITIVE, Doc("Torsional stiffness.")]

    @property
    def compliance(self) -> float:
        """Wind-up per torque [rad/(N m)]."""
        return 1 / self.stiffness
