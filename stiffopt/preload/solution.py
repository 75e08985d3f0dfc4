"""Outcome of a preload optimisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from stiffopt.fastening.limits import WorkshopTorque
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.rows import UtilisationRow
from stiffopt.result.status import SolveStatus


@dataclass(frozen=True)
class Stopper:
    """Why no preload meets the study.

    Parameters
    ----------
    limit : str
        Name of the requirement that cannot be met.
    best, required : float
        Best reachable and required value, in `unit`.
    unit : str
    against : str
        What stands against it; "" where nothing more is to be said.
    remedy : str
        What to change.
    """

    limit: str
    best: float
    required: float
    unit: str
    against: str
    remedy: str

    def __str__(self) -> str:
        required, best = self.amounts
        stop = f" What stops it: {self.against}." if self.against else ""
        return (
            f"{self.limit[:1].upper()}{self.limit[1:]}: required {required}, best reachable "
            f"{best}.{stop} To change: {self.remedy}."
        )

    @property
    def amounts(self) -> tuple[str, str]:
        """Required and best value with unit, with the digits at which they differ."""
        factor, unit = _READ_IN.get(self.unit, (1.0, self.unit))
        for digits in range(4, 10):
            required = f"{_significant(factor * self.required, digits)} {unit}".rstrip()
            best = f"{_significant(factor * self.best, digits)} {unit}".rstrip()
            if required != best:
                break
        return required, best


# Units that read better than SI, with their factor.
_READ_IN = {"m": (1e3, "mm"), "Pa": (1e-6, "MPa")}


def _significant(value: float, digits: int) -> str:
    """Without an exponent for what bolts and joints have."""
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e9 else text


@dataclass(frozen=True, kw_only=True, eq=False)
class PreloadSolution:
    """Preloads of a study and what they lead to, by the exact law.

    Parameters
    ----------
    status : SolveStatus
    message : str
    preloads : mapping of element key to float
        Largest preload of one bolt or pin that tightening leaves [N]; of individual preloads the
        mean.
    individual : mapping of element key to tuple of float
        One number a bolt or pin [N]; empty unless the study asks for them.
    tightening : mapping of element key to WorkshopTorque or None
        None where no screw is known.
    vector : array (size,)
        The design vector [N].
    cases : tuple of LoadCase
        Load cases used, the worst instants of motions among them.
    rows, rows_before : tuple of UtilisationRow
        Of this design and of the robot's present preloads.
    stiffness, stiffness_before : array (joints, cases)
        Tangent stiffness [N m/rad]; zero where a connection slips.
    deflection, deflection_before : array (cases,)
        Of the tool [m]; nan for cases without a pose.
    objective : float
        In its unit.
    total_preload : float
        [N]
    kkt_residual : float
        See `stiffopt.solver.kkt`; nan where nothing was solved.
    iterations : int
    stoppers : tuple of Stopper
        Why the study cannot be met; empty where it can.
    notes : tuple of str
    """

    status: SolveStatus
    message: str
    preloads: Mapping[str, float]
    individual: Mapping[str, tuple[float, ...]]
    tightening: Mapping[str, WorkshopTorque | None]
    vector: np.ndarray
    cases: tuple[LoadCase, ...]
    rows: tuple[UtilisationRow, ...]
    rows_before: tuple[UtilisationRow, ...]
    stiffness: np.ndarray
    stiffness_before: np.ndarray
    deflection: np.ndarray
    deflection_before: np.ndarray
    objective: float
    total_preload: float
    kkt_residual: float
    iterations: int
    stoppers: tuple[Stopper, ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the rows that the design lies at."""
        return tuple(row.name for row in self.rows if row.active)
