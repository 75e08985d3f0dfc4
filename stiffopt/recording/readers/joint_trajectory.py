"""Joint trajectories of ROS: points with times from the start, in any order of joints.

trajectory_msgs/msg/JointTrajectory as JSON or YAML, also inside a moveit_msgs/msg/RobotTrajectory
or the answer of a planning service.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.columns import Table, expand_vectors

_JOINT_NAMES, _POINTS_FIELD, _TIME_FIELD = "joint_names", "points", "time_from_start"
_QUANTITY_OF_FIELD = {
    "positions": "position",
    "velocities": "velocity",
    "accelerations": "acceleration",
}
_NANOSECOND_KEYS = ("nanosec", "nsec", "nsecs", "nanosecs")


def find_joint_trajectory(document: Any, depth: int = 0) -> Mapping[str, Any] | None:
    """Return the first joint trajectory with points in a nested document; None without one."""
    if depth > 8 or not isinstance(document, Mapping | list):
        return None
    if isinstance(document, Mapping) and document.get(_POINTS_FIELD) and _JOINT_NAMES in document:
        return document
    inner = document.values() if isinstance(document, Mapping) else document
    found = (find_joint_trajectory(each, depth + 1) for each in inner)
    return next((each for each in found if each is not None), None)


def columns_of_trajectory(message: Mapping[str, Any], path: Path) -> Table:
    """Return columns "time_from_start", "position[elbow]", ... of a joint trajectory."""
    names, points = message[_JOINT_NAMES], message[_POINTS_FIELD]
    table: Table = {_TIME_FIELD: np.array([_seconds(point.get(_TIME_FIELD)) for point in points])}
    for key, quantity in _QUANTITY_OF_FIELD.items():
        rows = [point.get(key) or [] for point in points]
        if not any(rows):
            continue
        for number, row in enumerate(rows, start=1):
            if len(row) != len(names):
                raise InputFileError(
                    path, f"points[{number}].{key}", f"has {len(row)} numbers for {len(names)} "
                    "joints. Give one a joint in every point, or leave them out of all."
                )  # fmt: skip
        table |= expand_vectors(quantity, np.array(rows, dtype=float), names)
    return table


def _seconds(stamp: Any) -> float:
    """Return a duration [s] of ROS 1 or 2, or a number."""
    if not isinstance(stamp, Mapping):
        return float("nan") if stamp is None else float(stamp)
    rest = next((stamp[key] for key in _NANOSECOND_KEYS if key in stamp), 0)
    return float(stamp.get("sec", stamp.get("secs", 0))) + 1e-9 * float(rest)
