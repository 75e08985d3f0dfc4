"""A case as a folder that an engineer could have, and its truth as a file of its own."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from .robots import Robot
from .spec import Case
from .world import IDENTIFIED_AT, TOLERANCE


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)


def _table(name: str, entries: dict[str, Any]) -> str:
    head = [f"[{name}]"] if name else []
    return "\n".join(head + [f"{key} = {_toml(value)}" for key, value in entries.items()]) + "\n"


def _nominal(robot: Robot) -> tuple[dict[str, Any], dict[str, Any]]:
    nominal = {
        "gear_ratio": robot.gear_ratio,
        "rotor_inertia": robot.rotor_inertia,
        "coulomb": robot.coulomb,
        "viscous": robot.viscous,
        "friction_temperature": IDENTIFIED_AT,
        "torque_max": robot.torque_max,
        "torque_rated": robot.torque_rated,
        "pole_pairs": robot.pole_pairs,
        "joint_damping": robot.joint_damping,
        "contact_stiffness": robot.contact_stiffness,
        "connections": list(robot.connections),
    }
    names = ("K1", "K2", "K3", "T1", "T2")
    curve = dict(zip(names, np.vstack([robot.slopes, robot.corners]), strict=True))
    return nominal, curve


def recordings_toml(case: Case) -> str:
    """The description beside the recordings; nothing in it depends on the effects."""
    robot, spec = case.robot, case.spec
    joints = range(1, robot.joints + 1)
    signals: dict[str, Any] = {"time": "t"}
    keys = {"position": "q", "velocity": "qd", "link_position": "ql", "torque": "tau"}
    for key, letter in keys.items():
        if key != "link_position" or spec.link_encoders:
            signals[key] = [f"{letter}{j}" for j in joints]
    signals["torque_side"] = "motor"
    stated = {
        key: value if key.endswith("resolution") else np.multiply(value, spec.stated_noise).tolist()
        for key, value in case.noise.items()
        if spec.link_encoders or not key.startswith("link")
    }
    nominal, reducer = _nominal(robot)
    parts = [
        _table(
            "",
            {
                "schema": 1,
                "name": spec.case_name,
                "citation": "simulated with two masses a joint and a drive controller in the loop",
                "licence": "MIT",
                "robot": "robot.urdf",
                "joints": [f"joint{j}" for j in joints],
                "tool_frame": "tool0",
                "gravity": [0.0, 0.0, -9.81],
            },
        ),
        _table("signals", signals),
        _table("nominal", nominal),
        _table("nominal.reducer", reducer),
        _table("tolerance", TOLERANCE),
        _table("noise", stated),
    ]
    for run in case.runs:
        parts.append(
            "[[runs]]\n"
            + _table(
                "",
                {
                    "file": f"{run.plan.name}.npz",
                    "role": run.plan.role,
                    "session_time": run.plan.session_time,
                    "housing_temperature": np.round(run.plan.temperature),
                },
            )
        )
    return "\n".join(parts)


def write_case(case: Case, folder: str | Path) -> Path:
    """Write the recording set; the truth stays out, but for the hash of its file."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(case.robot.urdf(), encoding="utf-8")
    (folder / "recordings.toml").write_text(recordings_toml(case), encoding="utf-8")
    for run in case.runs:
        np.savez_compressed(folder / f"{run.plan.name}.npz", **run.columns)
    digest = hashlib.sha256(truth_text(case).encode()).hexdigest()
    (folder / "commitment.txt").write_text(digest + "\n", encoding="utf-8")
    return folder


def truth_text(case: Case) -> str:
    return json.dumps(case.truth, indent=1, sort_keys=True, default=float) + "\n"


def write_truth(case: Case, path: str | Path) -> Path:
    """Write what was hidden in a case, apart from its folder."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(truth_text(case), encoding="utf-8")
    return path
