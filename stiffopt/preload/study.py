"""A whole preload study: the optimum, and around it everything that a designer asks next."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from stiffopt.preload.catalogue_choice import CatalogueChoice, choose_design
from stiffopt.preload.curves import PreloadCurve, preload_curves
from stiffopt.preload.loosening import Loosening, loosening
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.optimise import optimise_preloads
from stiffopt.preload.pareto import ParetoFront, pareto_front
from stiffopt.preload.problem import PreloadProblem
from stiffopt.preload.sensitivity import Sensitivity, sensitivity
from stiffopt.preload.solution import PreloadSolution
from stiffopt.preload.trajectory_study import MotionStudy, motion_study
from stiffopt.result.provenance import versions
from stiffopt.result.status import SolveStatus

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem


@dataclass(frozen=True, kw_only=True, eq=False)
class PreloadStudy:
    """Outcome of a study.

    Parameters
    ----------
    problem : PreloadProblem
    solution : PreloadSolution
        The optimum, or the best reachable with the reasons why the study cannot be met.
    curves : tuple of PreloadCurve
    loosening : Loosening
    sensitivity : Sensitivity
    front : ParetoFront or None
        None where the study cannot be met.
    choice : CatalogueChoice or None
        None unless the study has [choose].
    motion : MotionStudy or None
        None unless the study has [motion].
    seconds : float
    versions : dict of str
    """

    problem: PreloadProblem
    solution: PreloadSolution
    curves: tuple[PreloadCurve, ...]
    loosening: Loosening
    sensitivity: Sensitivity
    front: ParetoFront | None = None
    choice: CatalogueChoice | None = None
    motion: MotionStudy | None = None
    seconds: float = 0.0
    versions: dict[str, str]

    @property
    def status(self) -> SolveStatus:
        """Of the whole study: interrupted where any part of it was."""
        parts = (
            self.solution.status is SolveStatus.INTERRUPTED,
            self.front is not None and self.front.interrupted,
            self.motion is not None and self.motion.status is SolveStatus.INTERRUPTED,
        )
        return SolveStatus.INTERRUPTED if any(parts) else self.solution.status


def preload_study(
    problem: PreloadProblem,
    *,
    motion: TrajectoryProblem | None = None,
    rounds: int = 4,
    front_points: int = 15,
    progress: Callable[[Any], object] | None = None,
) -> PreloadStudy:
    """Run a study.

    Parameters
    ----------
    problem : PreloadProblem
    motion : TrajectoryProblem, optional
        To optimise together with the preloads.
    rounds : int
        Of that.
    front_points : int
        Of the Pareto front; 0 leaves it out.
    progress : callable, optional
        Called in every iteration of every solve.

    Returns
    -------
    PreloadStudy
        Of any status; a study that cannot be met has no front and no joint study.
    """
    begin = time.perf_counter()
    solution = optimise_preloads(problem, progress=progress, throw=False)
    model = PreloadModel(problem, solution.cases)
    fixed = replace(problem, load_cases=solution.cases, histories=())
    go_on = solution.status is not SolveStatus.INTERRUPTED
    usable = solution.status.usable
    front = choice = together = None
    if usable and front_points:
        front = pareto_front(problem, solution.cases, points=front_points, progress=progress)
        go_on = not front.interrupted
    if go_on and problem.choose is not None:
        choice = choose_design(fixed, progress=progress)
    if go_on and usable and motion is not None:
        together = motion_study(problem, motion, rounds=rounds, progress=progress)
    return PreloadStudy(
        problem=problem,
        solution=solution,
        curves=preload_curves(model, solution.vector),
        loosening=loosening(model, solution.vector),
        sensitivity=sensitivity(model, solution.vector),
        front=front,
        choice=choice,
        motion=together,
        seconds=time.perf_counter() - begin,
        versions=versions(),
    )
