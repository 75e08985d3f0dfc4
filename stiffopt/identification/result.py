"""Result of a static set: stiffness of the joints, errors, torque dependence, and its files."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stiffopt.files import SCHEMA, atomic_write, write_csv
from stiffopt.identification.bearing_tilt import BearingTilt
from stiffopt.identification.static_rows import StaticRows
from stiffopt.identification.torque_dependence import TorqueDependence
from stiffopt.recording.static_set import StaticSet
from stiffopt.result.motion_table import motion_columns

Status = Literal["identified", "lower_bound", "not_loaded", "confounded"]


@dataclass(frozen=True, kw_only=True)
class JointStiffness:
    """Identified stiffness of one joint [N m/rad, N/m for a prismatic joint]."""

    joint: int  # from 1
    name: str
    unit: str
    # "identified"; "lower_bound": a rigid joint is not excluded; "not_loaded" and "confounded": not
    # identifiable alone.
    status: Status
    reason: str  # a sentence; empty if identified
    # Estimate and its standard deviation.
    stiffness: float | None
    sd: float | None
    # 95 % confidence interval; an upper end of None is rigid.
    lower: float | None
    upper: float | None
    least_squares: float | None  # estimate of unweighted least squares with rigid bearings
    compliance: float | None  # [rad/(N m)]
    # By the jackknife; by the covariance of equal independent errors; by the bootstrap. The larger
    # of the first two determines `sd` and the interval.
    compliance_sd: float | None
    compliance_sd_alike: float | None
    compliance_sd_bootstrap: float | None
    # 95 % bootstrap interval.
    bootstrap_lower: float | None
    bootstrap_upper: float | None
    nominal: float | None
    z_nominal: float | None  # identified less nominal compliance, in standard deviations
    # 5, 50 and 95 % quantiles of the magnitude of the joint's torque [N m].
    torque: tuple[float, float, float]
    # Displacement of the tool by this joint over that by the joint of the largest, at equal
    # stiffness.
    leverage: float


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Root mean square of one component of the displacement or of its error [m]."""

    displacement: float  # measured
    # Of the robust fit on its own poses; on poses left out one at a time.
    fit: float
    left_out: float
    # The same by plain least squares with rigid bearings.
    least_squares: float
    least_squares_left_out: float
    nominal: float | None  # with the nominal stiffness
    rigid_bearings: float  # on poses left out, with no bearing that tilts


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticStiffness:
    """Answer of `identify_stiffness`."""

    source: StaticSet
    rows: StaticRows
    joints: tuple[JointStiffness, ...]
    errors: Errors
    # (m, 3) displacement by the fit, and by the fit without that pose [m].
    predicted: np.ndarray
    left_out: np.ndarray
    weight: np.ndarray  # (m,) huber weight of each pose
    scale: float  # robust standard deviation of one component [m]
    outliers: tuple[int, ...]  # numbers of outlying poses, from 1
    correlation: np.ndarray  # (n, n) of the compliances; nan for joints that are not identifiable
    torque_dependence: TorqueDependence
    tilt: tuple[BearingTilt, ...]  # bearings whose tilt the poses support
    assumptions: tuple[str, ...]


JSON_FILE, CSV_FILE, POSES_FILE = "stiffness.json", "stiffness.csv", "residuals.csv"

_CSV_COLUMNS = (
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
        _CSV_COLUMNS,
        [
            ["" if getattr(joint, name) is None else getattr(joint, name) for name in _CSV_COLUMNS]
            for joint in result.joints
        ],
    )
    _write_poses(result, folder / POSES_FILE)
    atomic_write(
        folder / JSON_FILE, json.dumps(stiffness_document(result), indent=2, allow_nan=False) + "\n"
    )


def stiffness_document(result: StaticStiffness) -> dict[str, Any]:
    """Content of stiffness.json: SI numbers, null where there is none."""
    error = np.linalg.norm(result.rows.displacement - result.predicted, axis=1)
    return {
        "schema": SCHEMA,
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
        "torque_dependence": _torque_dependence_entry(result.torque_dependence),
        "bearing_tilt": [dataclasses.asdict(each) for each in result.tilt],
        "assumptions": list(result.assumptions),
    }


def _torque_dependence_entry(found: TorqueDependence) -> dict[str, Any]:
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
    table = motion_columns(
        {
            "measured_": result.rows.displacement,
            "predicted_": result.predicted,
            "left_out_": result.left_out,
            "weight": result.weight,
        }
    )
    rows = zip(*(column.tolist() for column in table.values()), strict=True)
    write_csv(path, ("pose", *table), ((k, *row) for k, row in enumerate(rows, start=1)))
