"""Outcome of a solve: motion, certificate, baselines and solver record."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from typing import Any

import numpy as np

from stiffopt.errors import InputError
from stiffopt.result.assessment import Assessment
from stiffopt.result.compensation import Compensation
from stiffopt.result.motion_table import motion_columns
from stiffopt.result.simulation import Simulation
from stiffopt.result.status import SolveStatus
from stiffopt.result.trajectory import Trajectory


class DisplayedResult:
    """Result with a short display and a data frame; subclasses give facts and table."""

    def facts(self) -> dict[str, str]:
        """Main facts by name; the first is the heading."""
        raise NotImplementedError

    def table(self) -> dict[str, Any]:
        """Columns of the data frame, of equal length."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {', '.join(self.facts().values())}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th>"
            f"<td style='text-align:left'>{escape(value)}</td></tr>"
            for name, value in self.facts().items()
        )
        return f"<table>{rows}</table>"

    def to_dataframe(self) -> Any:
        """Return the table of the result as a pandas.DataFrame, SI.

        Raises `InputError`: pandas is not installed.
        """
        try:
            pandas = import_module("pandas")
        except ModuleNotFoundError as error:
            raise InputError(
                "to_dataframe needs pandas. Install it: pip install 'stiffopt[notebook]'"
            ) from error
        return pandas.DataFrame(self.table())

    def plot(self) -> Any:
        """Return the figure of the result, a matplotlib.figure.Figure; notebooks show it."""
        # Loaded on demand: `report` is a higher layer.
        return import_module("stiffopt.report.notebook").figure_of(self)


@dataclass(frozen=True, kw_only=True)
class ObjectiveValue:
    """Certified value of the objective, in SI.

    `terms` holds the value of each weighted term when there are several.
    """

    name: str
    measure: str
    value: float
    unit: str
    terms: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """Baseline motion, or the reason for its absence.

    `feasible` is False where a limit is exceeded; such a baseline is shown but not compared.
    """

    name: str
    assessment: Assessment | None
    objective: float | None
    feasible: bool
    reason: str
    trajectory: Trajectory | None = None


@dataclass(frozen=True, kw_only=True)
class SolverRecord:
    """Solver effort, for reports, regression tests and `stiffopt replay`.

    `homotopy` are the programmes solved, in order; `exchanges` are the objections to the motions
    found, each with its step, its reason, the iterations of the solve, whether that motion was
    accepted and how its last programme ended; `left_out` names the steps that the time limit ended
    or left out, empty where the answer does not depend on the speed of the machine.
    """

    iterations: int
    build_s: float
    solve_s: float
    transcription: str
    intervals: int
    homotopy: tuple[dict[str, float | str], ...]
    exchanges: tuple[dict[str, int | str | bool], ...] = ()
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, repr=False)
class Solution(DisplayedResult):
    """Outcome of `stiffopt.solve`.

    Parameters
    ----------
    message : str
        Sentence on the outcome and the remedy.
    trajectory : Trajectory or None
        Callable `trajectory(t, order=0)`; None if no motion was found.
    assessment : Assessment or None
        Certificate: fine grid, unsmoothed model.
    objective : ObjectiveValue or None
        Evaluated on the certificate's grid.
    baselines : dict
        "toppra" and "quintic"; "detour" where a path around obstacles was sought.
    ratio_to_better_baseline : float or None
        Objective over that of the better feasible baseline; below one is an improvement of a
        minimised objective. None without a feasible baseline.
    notes : tuple of str
        Bounds of the objective, estimated inputs and other remarks.
    strict_baseline : Baseline or None
        Best baseline that keeps every limit, slowed if none does at the problem's duration.
    ratio_to_strict_baseline : float or None
        Objective over that of the strict baseline.
    simulation : Simulation or None
        Elastic simulation of this motion and the baselines; None if not simulated.
    compensation : Compensation or None
        Command that makes the links follow this motion, and its effect on uncertain arms.
    """

    status: SolveStatus
    message: str
    trajectory: Trajectory | None
    assessment: Assessment | None
    objective: ObjectiveValue | None
    baselines: dict[str, Baseline]
    ratio_to_better_baseline: float | None
    solver: SolverRecord
    notes: tuple[str, ...]
    inputs_hash: str
    versions: dict[str, str]
    strict_baseline: Baseline | None = None
    ratio_to_strict_baseline: float | None = None
    simulation: Simulation | None = None
    compensation: Compensation | None = None

    @property
    def guess(self) -> Assessment:
        """Initial guess for another solve: `solve(problem, guess=solution.guess)`.

        Raises
        ------
        ValueError
            No motion was found.
        """
        if self.assessment is None:
            raise ValueError("no motion was found that could be an initial guess.")
        return self.assessment

    def facts(self) -> dict[str, str]:
        """Status, objective, duration and ratio as short texts."""
        found = {"status": str(self.status)}
        if self.objective is not None:
            value = self.objective
            name = f"{value.name} {value.measure}".strip()
            found["objective"] = f"{name} {value.value:.4g} {value.unit}".strip()
        if self.assessment is not None:
            found["duration"] = f"{self.assessment.duration:.4g} s"
            found["tightest limit"] = f"{self.assessment.worst_violation.limit}"
        if self.ratio_to_better_baseline is not None:
            found["over the better baseline"] = f"ratio {self.ratio_to_better_baseline:.3g}"
        return found

    def table(self) -> dict[str, np.ndarray]:
        """Motion on the certificate's grid: t, q1.., qd1.., qdd1.., tau1.., deflection.

        Raises
        ------
        InputError
            There is no motion.
        """
        motion = self.assessment
        if motion is None:
            raise InputError(f"there is no motion: {self.message}")
        arrays = {
            "t": motion.time,
            "q": motion.position,
            "qd": motion.velocity,
            "qdd": motion.acceleration,
            "tau": motion.torque,
            "tau_spring": motion.spring_torque,
            "windup": motion.windup,
            "tool_": motion.tool,
        }
        for part, vectors in motion.deflection.items():
            arrays[f"deflection_{part}"] = np.linalg.norm(vectors, axis=1)
        return motion_columns(arrays)

    @property
    def duration(self) -> float | None:
        """Duration of the motion [s]."""
        return None if self.assessment is None else self.assessment.duration
