"""Spring of a given stiffness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from stiffopt.connection.linear import LinearConnection
from stiffopt.contact.validate import require_positive


@dataclass(frozen=True, kw_only=True)
class Constant(LinearConnection):
    """Linear torsional spring.

    Parameters
    ----------
    stiffness : float
        [N m/rad].
    """

    kind: ClassVar[str] = "constant"
    stiffness: float

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self.owner, stiffness=self.stiffness)

    @property
    def is_contact(self) -> bool:
        """False."""
        return False

    @property
    def compliance(self) -> float:
        """Wind-up per torque [rad/(N m)]."""
        return 1 / self.stiffness
