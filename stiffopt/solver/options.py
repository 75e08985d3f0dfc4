"""Options of the NLP solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class IpoptOptions:
    """What IPOPT is told; everything else stays at IPOPT's own defaults.

    Parameters
    ----------
    tol : float
        Relative tolerance of "optimal".
    acceptable_tol : float
        Tolerance of "acceptable".
    max_iterations : int
    max_seconds : float
        Wall clock for one solve [s].
    linear_solver : str
        "mumps", or "spral" with its environment variables set.
    print_level : int
        0 (silent) to 12.
    extra : mapping
        Further options of IPOPT by their own names.
    """

    tol: float = 1e-8
    acceptable_tol: float = 1e-6
    max_iterations: int = 500
    max_seconds: float = float("inf")
    linear_solver: str = "mumps"
    print_level: int = 0
    extra: Mapping[str, Any] = field(default_factory=dict)

    def for_ipopt(self) -> dict[str, Any]:
        """Return the options by IPOPT's names."""
        return {
            "tol": self.tol,
            "acceptable_tol": self.acceptable_tol,
            "max_iter": self.max_iterations,
            "linear_solver": self.linear_solver,
            "print_level": self.print_level,
            "sb": "yes",
            **self.extra,
        }
