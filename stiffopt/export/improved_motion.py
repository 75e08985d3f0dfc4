"""Motion of the folder of an improvement, verified as those of solves are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BPoly, CubicSpline

from stiffopt.errors import InputFileError
from stiffopt.export.motion import SplineMotion, StoredMotion, Which
from stiffopt.export.motion_checks import (
    SampledRows,
    check_seal,
    judge_plan,
    judge_samples,
    read_rows,
    sealed,
)
from stiffopt.files import load_json, read_table
from stiffopt.folders import check_result
from stiffopt.improvement.improvement import problem_of_motion
from stiffopt.improvement.improvement_files import IMPROVEMENT_FILE
from stiffopt.problem.files import load_problem
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.recipe.stored_result import read_changes
from stiffopt.result.compensation import COMMAND_FILE
from stiffopt.result.store import TRAJECTORY_FILE, read_joints
from stiffopt.robot.files import load_robot


def read_improved(folder: Path, which: Which, given: Path | None) -> StoredMotion:
    """Read the motion of a folder of `stiffopt improve`; parameters as of `read_motion`."""
    path = folder / IMPROVEMENT_FILE
    check_result(folder, IMPROVEMENT_FILE)
    document = load_json(path)
    if not document.get("kept"):
        raise InputFileError(
            path, "kept", "the improved motion exceeds a limit, which the page names, so it is not "
            "exported. Improve it with --retime, or within other limits."
        )  # fmt: skip
    names, prismatic = read_joints(document, path)
    plan, command = folder / TRAJECTORY_FILE, folder / COMMAND_FILE
    check_result(folder, IMPROVEMENT_FILE, TRAJECTORY_FILE, COMMAND_FILE)
    columns = [f"q{j}" for j in range(1, len(names) + 1)]
    table = read_table(plan, ["t", *columns])
    places = np.array([table[name] for name in columns]).T
    link = CubicSpline(table["t"], places, bc_type="clamped")
    problem = _improved_problem(path, document, given, link)
    check_seal(path, document, problem, "the arm named in it")
    time, rows, _ = read_rows(plan, path, document, problem)
    judge_plan(problem, SampledRows(time, rows), plan)
    time, rows, _ = read_rows(command, path, document, problem)
    judge_samples(problem, SampledRows(time, rows, link), str(command))
    curve = BPoly.from_derivatives(time, rows.transpose(1, 0, 2))
    seal = sealed(path, document)
    file = COMMAND_FILE if which == "motor" else TRAJECTORY_FILE
    return StoredMotion(
        title=str(document.get("title") or folder.resolve().name),
        which=which,
        joint_names=names,
        prismatic=prismatic,
        curve=link if which == "link" else curve,
        link=link if which == "motor" else None,
        problem=problem,
        seal={
            "motion": seal["files"][file],
            **{k: seal[k] for k in ("robot", "payload", "limits")},
        },
    )


def _improved_problem(
    path: Path, document: dict[str, Any], given: Path | None, link: CubicSpline
) -> TrajectoryProblem:
    """Return the statement of an improved motion by the robot or problem file that it names."""
    changes = read_changes(path, document)
    motion = SplineMotion(link)
    file = given or document.get("problem")
    if file is not None:
        settings = load_problem(given or path.parent / file, changes).problem
        return problem_of_motion(settings.robot, motion, settings)
    named = document.get("robot")
    if not isinstance(named, str):
        raise InputFileError(path, "robot", "names no robot. Improve the motion again.")
    beside = path.parent / named
    return problem_of_motion(
        load_robot(beside if beside.is_file() else named, changes=changes), motion
    )
