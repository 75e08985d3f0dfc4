"""Result files of a preload study: study.json and study.csv.

Values are SI with full precision; values that are not finite are null in JSON. Joint numbers are
1-based.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.connection import Bolt
from stiffopt.drivetrain.tables import with_own
from stiffopt.fastening.utilisation import SAFETY_FACTORS, UtilisationRow
from stiffopt.files import SCHEMA, pick, to_json_types, write_csv, write_json
from stiffopt.preload.bolt_sheet import BoltSheet, bolt_sheets
from stiffopt.preload.catalogue_choice import CatalogueChoice
from stiffopt.preload.catalogue_designs import CatalogueDesign
from stiffopt.preload.curves import curve_rows
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.motion_study import MotionStudy
from stiffopt.preload.problem import OBJECTIVES, PreloadProblem
from stiffopt.preload.solution import PreloadSolution
from stiffopt.preload.study import PreloadStudy, named_values
from stiffopt.result.provenance import inputs_hash

STUDY_FILE = "study.json"
CURVES_FILE = "study.csv"


def study_document(study: PreloadStudy) -> dict[str, Any]:
    """Content of study.json as plain data; missing parts (front, choice, motion) are None."""
    with with_own(study.problem.robot.own):
        problem, solution = study.problem, study.solution
        sheets = bolt_sheets(PreloadModel(problem, solution.cases), solution.vector)
        document = {
            "schema": SCHEMA,
            "status": str(solution.status),
            "message": solution.message,
            "objective": {
                "name": problem.objective,
                "value": solution.objective,
                "unit": OBJECTIVES[problem.objective],
            },
            **pick(solution, "preloads", "individual"),
            "least_preloads": {e.key: e.least(solution.preloads[e.key]) for e in problem.elements},
            "tightening_torques": solution.tightening,
            "utilisations": {row.name: row.utilisation for row in solution.rows},
            "active_limits": solution.active,
            **_stiffness_entries(study),
            "tool_deflection": _values_by_case(solution, solution.deflection),
            "tool_deflection_before": _values_by_case(solution, solution.deflection_before),
            **pick(solution, "kkt_residual", "iterations"),
            "values": {name: value for name, (value, _) in named_values(study).items()},
            "rows": [
                {"name": row.name, **vars(row), "active": row.active} for row in solution.rows
            ],
            "bolts": {sheet.key: _sheet_entry(sheet) for sheet in sheets},
            "stoppers": solution.stoppers,
            "load_cases": [
                pick(c, "name", "torque", "wrench", "time", "source") for c in solution.cases
            ],
            "tightening": {**vars(problem.tightening), "scatter": problem.tightening.alpha},
            "front": study.front,
            "choice": None if study.choice is None else _choice_entry(study.choice),
            "sensitivity": {
                "worth": study.sensitivity.worth,
                "windup_shares": study.sensitivity.shares,
                "weakest": study.sensitivity.weakest,
            },
            "loosening": study.loosening,
            "motion": None if study.motion is None else _motion_entry(study.motion),
            **pick(study, "notes", "seconds"),
            "inputs_hash": study_hash(problem),
            "versions": study.versions,
        }
        found: dict[str, Any] = to_json_types(document)
        return found


def study_hash(problem: PreloadProblem) -> str:
    """Return `inputs_hash` of a study, including user data of its bolt sizes."""
    sizes = set() if problem.choose is None else set(problem.choose.sizes)
    for joint in problem.joints:
        chain = problem.robot.chains[joint - 1]
        bolts = [] if chain is None else [getattr(s.element, "bolt", None) for s in chain.stages]
        sizes |= {bolt.size for bolt in bolts if isinstance(bolt, Bolt)}
    own = {
        kind: {size: row for size, row in problem.robot.own.get(kind, {}).items() if size in sizes}
        for kind in ("bolt", "washer")
    }
    own = {kind: parts for kind, parts in own.items() if parts}
    return inputs_hash((problem, own) if own else problem)


def write_study(study: PreloadStudy, directory: str | Path) -> Path:
    """Write study.json into `directory`; return its path."""
    path = Path(directory) / STUDY_FILE
    write_json(path, study_document(study))
    return path


def write_curves(study: PreloadStudy, directory: str | Path) -> Path:
    """Write study.csv, the curves of the report, into `directory`; return its path."""
    path = Path(directory) / CURVES_FILE
    columns, rows = curve_rows(study.curves)
    write_csv(path, columns, rows)
    return path


def _values_by_case(
    solution: PreloadSolution, values: Sequence[float] | np.ndarray
) -> dict[str, Any]:
    """Return the values by name of load case."""
    return {case.name: value for case, value in zip(solution.cases, values, strict=True)}


def _stiffness_entries(study: PreloadStudy) -> dict[str, Any]:
    """Return present and former stiffness of every joint: least, and by load case."""
    document: dict[str, Any] = {}
    now, before = study.solution.stiffness, study.solution.stiffness_before
    for when, table in (("", now), ("_before", before)):
        of_joint = dict(zip(study.problem.joints, table, strict=True))
        document[f"stiffness{when}"] = {j: row.min() for j, row in of_joint.items()}
        document[f"stiffness_by_case{when}"] = {
            j: _values_by_case(study.solution, row) for j, row in of_joint.items()
        }
    return document


def _sheet_entry(sheet: BoltSheet) -> dict[str, Any]:
    """Return the entries of one bolt sheet."""
    left_out = ("key", "flange", "loads", "chance", "safety")
    own = {key: value for key, value in vars(sheet).items() if key not in left_out}
    loads = dict(zip(sheet.loads.names, sheet.loads.values, strict=True))
    own |= {"slip_probability": sheet.chance}
    safety = {symbol: _safety_entry(row) for symbol, row in sheet.safety.items()}
    alternating = sheet.loads.alternating
    return {**own, "safety_factors": safety, "loads": loads, "alternating": alternating}


def _safety_entry(row: UtilisationRow) -> dict[str, Any]:
    """Return a safety factor with its formula and governing load case."""
    assert row.safety is not None  # governing rows have one
    against, formula = SAFETY_FACTORS[row.safety.symbol]
    return {
        **pick(row.safety, "value", "required"),
        "against": against,
        "formula": formula,
        **pick(row, "equation", "case"),
    }


def _choice_entry(choice: CatalogueChoice) -> dict[str, Any]:
    return {
        **pick(choice, "status", "message", "objective", "cost", "gap"),
        "designs": {key: _design_entry(design) for key, design in choice.designs.items()},
        "table": [{**vars(row), "design": _design_entry(row.design)} for row in choice.table],
        **pick(choice, "proof", "tie_proofs", "stoppers", "ways"),
    }


def _design_entry(design: CatalogueDesign) -> dict[str, Any]:
    left_out = ("stage", "limits", "remedies")
    return {key: value for key, value in vars(design).items() if key not in left_out}


def _motion_entry(motion: MotionStudy) -> dict[str, Any]:
    left_out = ("trajectory", "separate_trajectory", "preload_solution", "rounds")
    document: Mapping[str, Any] = {k: v for k, v in vars(motion).items() if k not in left_out}
    return {
        **document,
        "rounds": motion.rounds,
        "trajectory_inputs_hash": motion.trajectory.inputs_hash,
    }
