"""Preload study: optimum, curves, sensitivity, front, catalogue choice, results by name."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter

import numpy as np

from stiffopt.drivetrain.tables import with_own
from stiffopt.preload.catalogue_choice import CatalogueChoice, choose_design
from stiffopt.preload.curves import PreloadCurve, preload_curves
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.motion_study import MotionStudy, motion_study
from stiffopt.preload.optimise import optimise_preloads
from stiffopt.preload.pareto import ParetoFront, pareto_front
from stiffopt.preload.problem import OBJECTIVES, FreeElement, PreloadProblem
from stiffopt.preload.sensitivity import Loosening, Sensitivity, loosening, sensitivity
from stiffopt.preload.solution import PreloadSolution, largest_utilisation
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.provenance import versions
from stiffopt.result.status import SolveProgress, SolveStatus
from stiffopt.solver.monitor import Progress


@dataclass(frozen=True, kw_only=True, eq=False)
class PreloadStudy:
    """Result of a study."""

    problem: PreloadProblem
    # The optimum, or the best reachable design with the reasons of infeasibility.
    solution: PreloadSolution
    curves: tuple[PreloadCurve, ...]
    loosening: Loosening
    sensitivity: Sensitivity
    front: ParetoFront | None = None  # None if infeasible
    choice: CatalogueChoice | None = None  # None unless the study has [choose]
    motion: MotionStudy | None = None  # None unless the study has [motion]
    stopped: bool = False  # stopped by Ctrl-C between solves; missing parts are None
    seconds: float = 0.0
    versions: dict[str, str]

    @property
    def status(self) -> SolveStatus:
        """Status of the study; interrupted if any part was."""
        parts = (
            self.stopped,
            self.solution.status is SolveStatus.INTERRUPTED,
            self.front is not None and self.front.interrupted,
            self.motion is not None and self.motion.status is SolveStatus.INTERRUPTED,
        )
        return SolveStatus.INTERRUPTED if any(parts) else self.solution.status

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the preloads, and on parts that Ctrl-C left incomplete."""
        cut = SolveStatus.INTERRUPTED
        if self.status is not cut or self.solution.status is cut:
            return self.solution.notes
        return (
            "Stopped by the user: the preloads are those of the finished optimisation; what follows"
            " it (Pareto front, catalogue, motion) is incomplete or left out.",
            *self.solution.notes,
        )


def preload_study(
    problem: PreloadProblem,
    *,
    motion: TrajectoryProblem | None = None,
    rounds: int = 4,
    front_points: int = 15,
    progress: Callable[[SolveProgress | Progress], object] | None = None,
) -> PreloadStudy:
    """Run a study.

    Parameters
    ----------
    motion : TrajectoryProblem, optional
        Optimised together with the preloads.
    rounds : int
        Largest number of rounds of the joint study.
    front_points : int
        Of the Pareto front; 0 leaves it out.
    progress : callable, optional
        Called in every iteration of every solve.

    Returns
    -------
    PreloadStudy
        Of any status; an infeasible study has no front and no joint study.
    """
    with with_own(problem.robot.own):
        begin = time.perf_counter()
        solution = optimise_preloads(problem, progress=progress, throw=False)
        model = PreloadModel(problem, solution.cases)
        fixed = replace(problem, load_cases=solution.cases, histories=())
        go_on = solution.status is not SolveStatus.INTERRUPTED
        usable = solution.status.usable
        front = choice = together = None
        stopped = False
        try:
            if usable and front_points:
                front = pareto_front(
                    problem, solution.cases, points=front_points, progress=progress
                )
                go_on = not front.interrupted
            if go_on and problem.choose is not None:
                choice = choose_design(fixed, progress=progress)
            if go_on and usable and motion is not None:
                together = motion_study(problem, motion, rounds=rounds, progress=progress)
        except KeyboardInterrupt:  # finished parts are kept
            stopped = True
        return PreloadStudy(
            problem=problem,
            solution=solution,
            curves=preload_curves(model, solution.vector),
            loosening=loosening(model, solution.vector),
            sensitivity=sensitivity(model, solution.vector),
            front=front,
            choice=choice,
            motion=together,
            stopped=stopped,
            seconds=time.perf_counter() - begin,
            versions=versions(),
        )


# Name, SI unit and evaluation of a value.
_ValueRow = tuple[str, str, Callable[[PreloadStudy], float]]


def value_units(
    problem: PreloadProblem, *, front: bool = True, motion: bool = False
) -> dict[str, str]:
    """Return the names of a study's values with their SI units.

    `front` and `motion`: the study has a Pareto front, and a motion. Returns dict of name to unit:
    names include element keys, with _ for the dot: preload_joint_2_flexspline_flange.
    """
    return {name: unit for name, unit, _ in _value_rows(problem, front=front, motion=motion)}


def named_values(study: PreloadStudy) -> dict[str, tuple[float, str]]:
    """Return the values of a finished study.

    Returns dict of name to (value in SI, unit): names as in `value_units`; nan for missing values.
    """
    rows = _value_rows(study.problem, front=True, motion=study.motion is not None)
    return {name: (float(value(study)), unit) for name, unit, value in rows}


def _value_rows(problem: PreloadProblem, *, front: bool, motion: bool) -> Iterator[_ValueRow]:
    """Yield name, SI unit and evaluation of every value of a study."""
    yield "objective", OBJECTIVES[problem.objective], lambda s: s.solution.objective
    yield "total_preload", "N", lambda s: s.solution.total_preload
    yield "bolt_utilisation", "", _bolt_utilisation
    yield "slip_safety", "", _least_slip_safety
    yield "kkt_residual", "", lambda s: s.solution.kkt_residual
    jacobians = [load.jacobian for load in problem.load_cases]
    jacobians += [load.jacobian for load in problem.histories]
    if any(jacobian is not None for jacobian in jacobians):
        yield "tool_deflection", "m", lambda s: s.solution.largest_deflection
    for row, joint in enumerate(problem.joints):
        yield (
            f"stiffness_joint_{joint}",
            "N m/rad",
            partial(lambda row, s: s.solution.stiffness[row].min(), row),
        )
    for element in problem.elements:
        yield from _element_rows(element, individual=problem.individual)
    if front:
        yield "knee_total_preload", "N", partial(_at_knee, "total_preload")
        yield "knee_level", "", partial(_at_knee, "level")
    if problem.choose is not None:
        unit = OBJECTIVES[problem.objective]
        yield "catalogue_objective", unit, lambda s: s.choice.objective if s.choice else np.nan
    if motion:
        for part in ("start", "separate", "joint"):
            yield f"deflection_{part}", "m", attrgetter(f"motion.{part}")
        yield "gain_joint_study", "", attrgetter("motion.gain")


def _element_rows(element: FreeElement, *, individual: bool) -> Iterator[_ValueRow]:
    key, name = element.key, element.key.replace(".", "_")

    def torque(study: PreloadStudy) -> float:
        found = study.solution.tightening[key]
        return np.nan if found is None else found.nominal

    yield f"preload_{name}", "N", lambda s: s.solution.preloads[key]
    yield f"least_preload_{name}", "N", lambda s: element.least(s.solution.preloads[key])
    yield f"tightening_torque_{name}", "N m", torque
    yield f"slip_safety_{name}", "", partial(_least_slip_safety, key=key)
    yield f"first_slip_fraction_{name}", "", lambda s: s.loosening.first_slip_fraction[key]
    yield f"slip_fraction_{name}", "", lambda s: s.loosening.slip_fraction[key]
    for i in range(element.count if individual else 0):
        each = partial(lambda i, s: s.solution.individual[key][i], i)
        yield f"preload_{name}_{i + 1}", "N", each


def _bolt_utilisation(study: PreloadStudy) -> float:
    model = PreloadModel(study.problem, study.solution.cases)
    return largest_utilisation(model, study.solution.vector)


def _least_slip_safety(study: PreloadStudy, key: str | None = None) -> float:
    """Return the least slip safety of an element, or of all [-]."""
    own = (r for r in study.solution.rows if r.kind == "slip safety")
    return min(r.value for r in own if key in (None, r.element))


def _at_knee(quantity: str, study: PreloadStudy) -> float:
    """Return a quantity of the front's knee; nan without a front."""
    front = study.front
    return np.nan if front is None else getattr(front.points[front.knee], quantity)
