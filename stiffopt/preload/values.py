"""Results of a study as named numbers: what a file expects and a verification compares."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.preload.problem import OBJECTIVES, FreeElement, PreloadProblem

if TYPE_CHECKING:
    from stiffopt.preload.study import PreloadStudy


def value_units(
    problem: PreloadProblem, *, front: bool = True, motion: bool = False
) -> dict[str, str]:
    """Names of the values that a study will have, with their SI units.

    Parameters
    ----------
    problem : PreloadProblem
    front, motion : bool
        Whether the study has a Pareto front, and a motion.

    Returns
    -------
    dict of name to unit
        Element keys are part of names, with _ for the dot: preload_joint_2_flexspline_flange.
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
        name = _name(element)
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
    """Values of a finished study.

    Returns
    -------
    dict of name to (value in SI, unit)
        Names of `value_units`; nan where a study ended without the value.
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
        values |= _of_element(study, element)
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


def _name(element: FreeElement) -> str:
    return element.key.replace(".", "_")


def _of_element(study: PreloadStudy, element: FreeElement) -> dict[str, float]:
    solution, key, name = study.solution, element.key, _name(element)
    torque = solution.tightening[key]
    own = [r.value for r in solution.rows if r.kind == "slip safety" and r.element == key]
    least = element.least(solution.preloads[key], study.problem.tightening.alpha)
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
