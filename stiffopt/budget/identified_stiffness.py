"""Uncertainty of an arm narrowed by its identified stiffness."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.budget.budget import ErrorModel
from stiffopt.elastic.uncertainty import Uncertainty, bounds_from_deviations
from stiffopt.errors import InputFileError
from stiffopt.files import load_json
from stiffopt.folders import check_result

_STIFFNESS_FILE = "stiffness.json"
_IDENTIFY_AGAIN = "Run identify-stiffness again."


def narrow_stiffness(model: ErrorModel, folder: Path) -> Uncertainty:
    """Return the uncertainty with the standard deviations of an identified stiffness.

    `folder`: of `stiffopt identify-stiffness`. Raises `InputFileError`: the folder has no stiffness
    of this arm.
    """
    check_result(folder, _STIFFNESS_FILE)
    path = folder / _STIFFNESS_FILE
    document = load_json(path)
    joints = document.get("joints") if isinstance(document, dict) else None
    if not isinstance(joints, list) or not all(isinstance(each, dict) for each in joints):
        raise InputFileError(path, "joints", f"is not a list of joints. {_IDENTIFY_AGAIN}")
    names = model.robot.joint_names
    known = np.full(len(names), np.nan)
    for number, joint in enumerate(joints):
        if joint.get("status") != "identified":
            continue
        deviation, value = (
            _positive_number(path, f"joints[{number}].{key}", joint.get(key))
            for key in ("sd", "stiffness")
        )
        # By name, else by number.
        place = names.index(joint["name"]) if joint.get("name") in names else number
        if place >= len(names):
            raise InputFileError(
                path,
                "joints",
                f"has {len(joints)} joints, {model.robot.name} has {len(names)}. Give the stiffness"
                " of the same arm.",
            )
        known[place] = deviation / value
    return bounds_from_deviations(model.uncertainty, known)


def _positive_number(path: Path, key: str, value: Any) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not 0.0 < value < math.inf:
        raise InputFileError(
            path, key, f"is {value!r}; allowed: a number above 0. {_IDENTIFY_AGAIN}"
        )
    return float(value)
