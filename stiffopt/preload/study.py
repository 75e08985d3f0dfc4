"""Preload study: optimum, curves, sensitivity, front, catalogue choice, results by name."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

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
from stiffopt.preload.solution import PreloadSolution
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.provenance import versions
from stiffopt.result.status import SolveStatus
from stiffopt.solver.monitor import Progress
from stiffopt.solver.solve_run import SolveProgress


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


def value_units(
    problem: PreloadProblem, *, front: bool = True, motion: bool = False
) -> dict[str, str]:
    """Return the names of a study's values with their SI units.

    `front` and `motion`: the study has a Pareto front, and a motion. Returns dict of name to unit:
    names include element keys, with _ for the dot: preload_joint_2_flexspline_flange.
    """
    units = {
        "objective": OBJECTIVES[problem.objective],
        "total_preload": "N",
        "bolt_utilisation": "",
        "slip_safety": "",
        "kkt_residual": "",
    }
    jacobians = [load.jacobian for load in problem.load_cases]
    jacobians += [load.jacobian for load in problem.histories]
    if any(jacobian is not None for jacobian in jacobians):
        units["tool_deflection"] = "m"
    for joint in problem.joints:
        units[f"stiffness_joint_{joint}"] = "N m/rad"
    for element in problem.elements:
        name = _value_name(element)
        units |= {
            f"preload_{name}": "N",
            f"least_preload_{name}": "N",
            f"tightening_torque_{name}": "N m",
            f"slip_safety_{name}": "",
            f"first_slip_fraction_{name}": "",
            f"slip_fraction_{name}": "",
        }
        if problem.individual:
            units |= {f"preload_{name}_{i}": "N" for i in range(1, element.count + 1)}
    if front:
        units |= {"knee_total_preload": "N", "knee_level": ""}
    if problem.choose is not None:
        units["catalogue_objective"] = OBJECTIVES[problem.objective]
    if motion:
        units |= {
            "deflection_start": "m",
            "deflection_separate": "m",
            "deflection_joint": "m",
            "gain_joint_study": "",
        }
    return units


def named_values(study: PreloadStudy) -> dict[str, tuple[float, str]]:
    """Return the values of a finished study.

    Returns dict of name to (value in SI, unit): names as in `value_units`; nan for missing values.
    """
    problem, solution = study.problem, study.solution
    bounded = {
        (e.key, limit.name)
        for e in problem.elements
        for limit in e.limits
        if limit.depends_on_preload
    }
    values = {
        "objective": solution.objective,
        "total_preload": solution.total_preload,
        "bolt_utilisation": max(r.value for r in solution.rows if (r.element, r.kind) in bounded),
        "kkt_residual": solution.kkt_residual,
        "slip_safety": min(r.value for r in solution.rows if r.kind == "slip safety"),
        "tool_deflection": float(np.max(solution.deflection, initial=0.0, where=posed))
        if (posed := np.isfinite(solution.deflection)).any()
        else np.nan,
    }
    for joint, row in zip(problem.joints, solution.stiffness, strict=True):
        values[f"stiffness_joint_{joint}"] = float(row.min())
    for element in problem.elements:
        values |= _element_values(study, element)
    if study.front is not None:
        knee = study.front.points[study.front.knee]
        values |= {"knee_total_preload": knee.total_preload, "knee_level": knee.level}
    if study.choice is not None:
        values["catalogue_objective"] = study.choice.objective
    if study.motion is not None:
        values |= {
            "deflection_start": study.motion.start,
            "deflection_separate": study.motion.separate,
            "deflection_joint": study.motion.joint,
            "gain_joint_study": study.motion.gain,
        }
    units = value_units(problem, motion=study.motion is not None)
    return {name: (values.get(name, np.nan), unit) for name, unit in units.items()}


def _value_name(element: FreeElement) -> str:
    return element.key.replace(".", "_")


def _element_values(study: PreloadStudy, element: FreeElement) -> dict[str, float]:
    solution, key, name = study.solution, element.key, _value_name(element)
    torque = solution.tightening[key]
    own = [r.value for r in solution.rows if r.kind == "slip safety" and r.element == key]
    least = element.least(solution.preloads[key])
    values = {
        f"preload_{name}": solution.preloads[key],
        f"least_preload_{name}": float(least),
        f"tightening_torque_{name}": np.nan if torque is None else torque.nominal,
        f"slip_safety_{name}": min(own),
        f"first_slip_fraction_{name}": study.loosening.first_slip_fraction[key],
        f"slip_fraction_{name}": study.loosening.slip_fraction[key],
    }
    for number, preload in enumerate(solution.individual.get(key, ()), start=1):
        values[f"preload_{name}_{number}"] = preload
    return values
