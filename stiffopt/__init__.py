"""Stiff and true trajectories for industrial robot arms.

    from stiffopt import load_robot, Objective, Target, TrajectoryProblem, solve

Names are loaded when they are first used, so that importing the package costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "load_robot": "stiffopt.robot.files",
    "shipped_robots": "stiffopt.robot.files",
    "Robot": "stiffopt.robot.robot",
    "TrajectoryProblem": "stiffopt.problem.trajectory",
    "Target": "stiffopt.problem.trajectory",
    "Limits": "stiffopt.problem.trajectory",
    "Method": "stiffopt.problem.trajectory",
    "Objective": "stiffopt.problem.objectives",
    "load_problem": "stiffopt.problem.files",
    "solve": "stiffopt.solver.solve",
    "stiffness_study": "stiffopt.robot.stiffness_study",
    "assess": "stiffopt.certificate.assess",
    "Solution": "stiffopt.result.solution",
    "SolveStatus": "stiffopt.result.status",
    "Trajectory": "stiffopt.result.trajectory",
    "write_solve_report": "stiffopt.report.solve.page",
    "PreloadProblem": "stiffopt.preload.problem",
    "Requirements": "stiffopt.preload.problem",
    "Choice": "stiffopt.preload.problem",
    "LoadCase": "stiffopt.preload.load_case",
    "Tightening": "stiffopt.fastening.tightening",
    "load_study": "stiffopt.preload.files",
    "optimise_preloads": "stiffopt.preload.optimise",
    "preload_study": "stiffopt.preload.study",
    "write_preload_report": "stiffopt.report.preload.page",
    "load_recordings": "stiffopt.recording.recording_set",
    "diagnose": "stiffopt.discovery.diagnose",
    "Diagnosis": "stiffopt.discovery.diagnosis",
    "write_diagnosis": "stiffopt.discovery.store",
    "write_diagnosis_report": "stiffopt.report.diagnosis.page",
    "load_static_set": "stiffopt.recording.static_set",
    "identify_stiffness": "stiffopt.identification.stiffness",
    "StiffoptError": "stiffopt.errors",
    "InputError": "stiffopt.errors",
    "NoSolutionFound": "stiffopt.errors",
    "ProblemError": "stiffopt.errors",
}

__all__ = ["__version__", *sorted(_PUBLIC)]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'stiffopt' has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return list(__all__)
