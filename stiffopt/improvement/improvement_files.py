"""Files of an improved motion: improvement.json, command.csv and trajectory.csv."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stiffopt.certificate.assess import assess
from stiffopt.files import atomic_write, pick, to_json_types
from stiffopt.improvement.improvement import AssessedMotion, Improvement
from stiffopt.result.compensation import COMMAND_FILE, compensation_document, write_command
from stiffopt.result.simulation import simulated_document
from stiffopt.result.store import (
    TRAJECTORY_FILE,
    export_times,
    motion_facts,
    write_trajectory,
)

IMPROVEMENT_FILE = "improvement.json"


def write_improvement(found: Improvement, folder: Path, origin: Mapping[str, Any]) -> None:
    """Write the files of an improved motion; those of the motion only where it keeps its limits.

    `origin` names robot or problem file, as seen from the folder, and the changes of its entries.
    """
    if found.kept:
        times = export_times(found.plan.duration)
        plan = assess(found.problem, found.plan, times=times)
        write_trajectory(plan, folder)
        if found.compensation is None:
            # Rigid: the motors follow the plan.
            write_trajectory(plan, folder, COMMAND_FILE)
        else:
            write_command(found.compensation, folder)
    facts = motion_facts(found.problem, folder) if found.kept else {}
    document = to_json_types({**improvement_document(found), **origin, **facts})
    atomic_write(folder / IMPROVEMENT_FILE, json.dumps(document, indent=1) + "\n")


def improvement_document(found: Improvement) -> dict[str, Any]:
    """Content of improvement.json, SI."""
    return {
        "schema": 1,
        "kept": found.kept,
        "duration": found.plan.duration,
        **pick(found, "retimed", "path_deviation", "margins"),
        "trajectory": TRAJECTORY_FILE if found.kept else None,
        "given": _motion_document(found.given),
        "improved": _motion_document(found.improved),
        "compensation": compensation_document(found.compensation),
        "notes": found.notes,
    }


def _motion_document(motion: AssessedMotion) -> dict[str, Any]:
    return {
        "duration": motion.assessment.duration,
        "limits": [{**vars(use), "share": use.share} for use in motion.uses],
        "exceeded": [dict(vars(each)) for each in motion.exceeded],
        "servo_peak": None if motion.servo is None else float(motion.servo.max()),
        "elastic": None if motion.elastic is None else simulated_document(motion.elastic),
        "simulated": None if motion.both is None else simulated_document(motion.both),
        "settling_time": None if motion.both is None else motion.both.settling_time,
    }
