"""stiffness.json, stiffness.csv and residuals.csv of a static set."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.files import atomic_write, write_csv
from stiffopt.identification.result import StaticStiffness
from stiffopt.identification.torque_dependence import TorqueDependence

JSON_FILE, CSV_FILE, POSES_FILE = "stiffness.json", "stiffness.csv", "residuals.csv"

_CSV = (
    "joint",
    "name",
    "status",
    "stiffness",
    "sd",
    "lower",
    "upper",
    "least_squares",
    "nominal",
    "z_nominal",
    "compliance",
    "compliance_sd",
)


def write_static(result: StaticStiffness, folder: Path) -> None:
    """Write stiffness.json, stiffness.csv and residuals.csv into `folder`."""
    write_csv(
        folder / CSV_FILE,
        _CSV,
        [
            ["" if getattr(joint, name) is None else getattr(joint, name) for name in _CSV]
            for joint in result.joints
        ],
    )
    _write_poses(result, folder / POSES_FILE)
    atomic_write(folder / JSON_FILE, json.dumps(as_data(result), indent=2, allow_nan=False) + "\n")


def as_data(result: StaticStiffness) -> dict[str, Any]:
    """Content of stiffness.json: SI numbers, null where there is none."""
    error = np.linalg.norm(result.rows.displacement - result.predicted, axis=1)
    return {
        "schema": 1,
        "kind": "stiffness",
        "name": result.source.name,
        "citation": result.source.citation,
        "poses": len(result.predicted),
        "joints": [dataclasses.asdict(joint) for joint in result.joints],
        "rms": {
            "of": "one component of the displacement",
            "unit": "m",
            **dataclasses.asdict(result.errors),
        },
        "noise": {"value": result.scale, "unit": "m"},
        "outliers": [
            {
                "pose": pose,
                "error": float(error[pose - 1]),
                "weight": float(result.weight[pose - 1]),
            }
            for pose in result.outliers
        ],
        "correlation": [
            [None if np.isnan(each) else float(each) for each in row] for row in result.correlation
        ],
        "torque_dependence": _dependence(result.torque_dependence),
        "assumptions": list(result.assumptions),
    }


def _dependence(found: TorqueDependence) -> dict[str, Any]:
    names = ("name", "formula", "candidate", "shape", "parameters", "fit", "left_out", "gain")
    return {
        "verdict": found.verdict,
        "sentence": found.sentence,
        "best": found.best or None,
        "models": [
            {
                **{name: getattr(model, name) for name in names},
                "chance": model.chance if model.candidate else None,
            }
            for model in found.models
        ],
        "secant_stiffness": [
            {"joint": joint, "share_of_poses": [0.05, 0.5, 0.95], "stiffness": list(values)}
            for joint, values in found.secant.items()
        ],
    }


def _write_poses(result: StaticStiffness, path: Path) -> None:
    axes = "xyz"
    columns = (
        "pose",
        *(f"measured_{axis}" for axis in axes),
        *(f"predicted_{axis}" for axis in axes),
        *(f"left_out_{axis}" for axis in axes),
        "weight",
    )
    table = np.column_stack(
        [result.rows.displacement, result.predicted, result.left_out, result.weight]
    )
    write_csv(path, columns, [[k, *row] for k, row in enumerate(table.tolist(), start=1)])
