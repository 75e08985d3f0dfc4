"""Motions of the folders of improvements and cycles, verified as those of solves are.

That of a cycle joins its certified legs one after another, with rests and events.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BPoly, CubicSpline

from stiffopt.errors import InputFileError
from stiffopt.export import motion_checks
from stiffopt.export.motion import (
    MotionEvent,
    SampledMotion,
    SplineMotion,
    StoredMotion,
    Which,
    read_motion,
)
from stiffopt.files import load_json
from stiffopt.folders import check_result
from stiffopt.improvement.improvement import problem_of_motion
from stiffopt.improvement.improvement_files import IMPROVEMENT_FILE
from stiffopt.path.load import load_problem
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.recipe.stored_result import read_changes
from stiffopt.result.assessment import Violation
from stiffopt.result.compensation import COMMAND_FILE
from stiffopt.result.cycle import CYCLE_FILE, JoinedMotion, leg_folder
from stiffopt.result.motion_table import read_motion_table
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
    table = read_motion_table(plan, len(names), ["q"])
    link = CubicSpline(table["t"], table["q"], bc_type="clamped")
    problem = _improved_problem(path, document, given, link)
    motion_checks.check_seal(path, document, problem, "the arm named in it")
    time, rows, _ = motion_checks.read_rows(plan, path, document, problem)
    motion_checks.judge_plan(problem, motion_checks.SampledRows(time, rows), plan)
    time, rows, _ = motion_checks.read_rows(command, path, document, problem)
    motion_checks.judge_samples(problem, motion_checks.SampledRows(time, rows, link), str(command))
    curve = BPoly.from_derivatives(time, rows.transpose(1, 0, 2))
    seal = motion_checks.sealed(path, document)
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


@dataclass(frozen=True, kw_only=True)
class StoredCycle(StoredMotion):
    """Motion of a cycle; `problem` and `link` are those of its first leg."""

    legs: tuple[StoredMotion, ...]
    starts: tuple[float, ...]  # of the legs [s]

    def judge(self, motion: SampledMotion) -> Violation:
        """Return the tightest limit of the drives at the samples of all legs."""
        found = []
        for start, leg in zip(self.starts, self.legs, strict=True):
            inside = (motion.time >= start) & (motion.time <= start + float(leg.curve.x[-1]))
            if np.count_nonzero(inside) > 1:
                rows = (motion.position, motion.velocity, motion.acceleration)
                sampled = motion_checks.SampledRows(
                    motion.time[inside] - start, [each[inside] for each in rows], leg.link
                )
                found.append(
                    motion_checks.judge_samples(leg.problem, sampled, f"{leg.title}, sampled")
                )
        return max(found, key=lambda each: each.value)


def read_stored(folder: Path, which: Which = "motor", problem: Path | None = None) -> StoredMotion:
    """Read the motion of a solve, a cycle or an improvement; parameters as of `read_motion`."""
    if (folder / IMPROVEMENT_FILE).is_file():
        return read_improved(folder, which, problem)
    if not (folder / CYCLE_FILE).is_file():
        return read_motion(folder, which, problem)
    path = folder / CYCLE_FILE
    check_result(folder, CYCLE_FILE)
    document = load_json(path)
    times = _read_times(path, document)
    problems = motion_checks.solved_legs(path, document, problem)
    legs = tuple(
        read_motion(folder / leg_folder(k + 1), which, stated=stated)
        for k, stated in enumerate(problems)
    )
    if len(legs) != len(times):
        raise InputFileError(path, "legs", "the cycle has another number of legs. Solve again.")
    starts = np.array([start for start, _, _ in times])
    end = max(leave for _, _, leave in times)
    curve = _joined_curve([leg.curve for leg in legs], starts, end)
    hashes = [leg.seal[key] for leg in legs for key in sorted(leg.seal)]
    events = [
        MotionEvent(time=arrival, kind=str(leg["event"]), mass=float(leg["mass_after"]))
        for leg, (_, arrival, _) in zip(document["legs"], times, strict=True)
        if leg["event"]
    ]
    first = legs[0]
    whole = hashlib.sha256(repr((hashes, times, events)).encode()).hexdigest()
    return StoredCycle(
        title=str(document.get("title") or folder.resolve().name),
        which=which,
        joint_names=first.joint_names,
        prismatic=first.prismatic,
        curve=curve,
        link=first.link,
        problem=first.problem,
        seal={**first.seal, "motion": whole},
        legs=legs,
        starts=tuple(starts.tolist()),
        events=tuple(events),
    )


def _read_times(path: Path, document: Any) -> list[tuple[float, float, float]]:
    """Start, arrival and departure [s] of each leg of a cycle.json."""
    try:
        found = [
            (float(leg["start"]), float(leg["arrival"]), float(leg["arrival"] + leg["dwell"]))
            for leg in document["legs"]
        ]
        _ = [(leg["event"], float(leg["mass_after"])) for leg in document["legs"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputFileError(path, "legs", f"has no usable {error}. Solve again.") from error
    if not found:
        raise InputFileError(path, "legs", "the solve found no motion to export.")
    return found


def _joined_curve(curves: list[Any], starts: np.ndarray, end: float) -> BPoly:
    """Position over the time of the cycle, with the rests."""
    joined = JoinedMotion([SplineMotion(each) for each in curves], starts, end)
    times = joined.times
    times = times[np.append(True, np.diff(times) > 1e-9)]
    return BPoly.from_derivatives(
        times, np.stack([joined(times, order) for order in range(3)], axis=1)
    )
