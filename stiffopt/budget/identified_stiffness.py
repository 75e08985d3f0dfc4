"""Uncertainty of an arm narrowed by its identified stiffness."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.budget.budget import ErrorModel
from stiffopt.elastic.uncertainty import Uncertainty, bounds_from_deviations
from stiffopt.errors import InputFileError
from stiffopt.files import load_json
from stiffopt.folders import check_result

_STIFFNESS_FILE = "stiffness.json"


def narrow_stiffness(model: ErrorModel, folder: Path) -> Uncertainty:
    """Return the uncertainty with the standard deviations of an identified stiffness.

    `folder`: of `stiffopt identify-stiffness`. Raises `InputFileError`: the folder has no stiffness
    of this arm.
    """
    check_result(folder, _STIFFNESS_FILE)
    path = folder / _STIFFNESS_FILE
    document = load_json(path)
    known = np.full(model.robot.n, np.nan)
    try:
        joints = document["joints"]
        for number, joint in enumerate(joints):
            if joint["status"] == "identified":
                place = _joint_place(model, joint, number)
                known[place] = float(joint["sd"]) / float(joint["stiffness"])
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise InputFileError(
            path, "joints", f"has no usable {error}. Run identify-stiffness again."
        ) from error
    except IndexError as error:
        raise InputFileError(
            path, "joints", f"has {len(joints)} joints, {model.robot.name} has {model.robot.n}. "
            "Give the stiffness of the same arm."
        ) from error  # fmt: skip
    return bounds_from_deviations(model.uncertainty, known)


def _joint_place(model: ErrorModel, joint: dict[str, Any], number: int) -> int:
    """Index of a joint of the file: by name, else by number."""
    names = model.robot.joint_names
    if joint["name"] in names:
        return names.index(joint["name"])
    if number >= len(names):
        raise IndexError(number)
    return number
