"""Result files of a solve: result.json, trajectory.csv and simulation.json.

Values are SI with full precision; numbers that are not finite are null in JSON. Joint numbers are
1-based.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.errors import InputError, InputFileError
from stiffopt.files import SCHEMA, load_json, pick, to_json_types, write_json
from stiffopt.folders import check_result
from stiffopt.result.assessment import Assessment, Violation
from stiffopt.result.compensation import (
    COMMAND_FILE,
    RIVAL_COMMAND_FILE,
    RIVAL_TRAJECTORY_FILE,
    compensation_document,
    write_motors,
)
from stiffopt.result.motion_table import write_motion_table
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.simulation import Simulation, simulation_document
from stiffopt.result.solution import Baseline, Solution

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.compensation import Compensation

# Rate of trajectory.csv [Hz].
EXPORT_RATE = 500.0
# Samples of one motion in a table: half an hour at 500 Hz, a file of 500 MB.
MAX_SAMPLES = 1_000_000
RESULT_FILE = "result.json"
TRAJECTORY_FILE = "trajectory.csv"
SIMULATION_FILE = "simulation.json"

# Columns of trajectory.csv, and of command.csv as far as it has them; N counts joints from 1.
COLUMNS = {
    "t": ("s", "Time, every 2 ms and at the end."),
    "qN, qdN, qddN": (
        "rad, rad/s, rad/s^2 (m, m/s, m/s^2)",
        "Motion of the motors; of motors and links alike without linkN columns.",
    ),
    "tauN": (
        "N m (N)",
        "Drive torque: of links that follow linkN if present, else qN; rotor inertia and friction "
        "of motors that follow qN.",
    ),
    "tau_springN, kN, windupN": (
        "N m, N m/rad, rad",
        "Torque, tangent stiffness and wind-up of the joint's spring for the links' motion, as "
        "tauN. Inverse dynamics of qN gives other values if linkN columns are present.",
    ),
    "tool_x, tool_y, tool_z": ("m", "Planned position of the tool."),
    "deflection_x ..., deflection_dynamic_x ...": (
        "m",
        "Deflection of the tool: total and dynamic.",
    ),
    "force_x, force_y, force_z": ("N", "Process force along a path, base axes."),
    "linkN": (
        "rad (m)",
        "Position of the links, where the motors lead them by the wind-up: tool_deviation, "
        "shaped_deviation, limits after arrival, and command.csv.",
    ),
}


def result_document(solution: Solution) -> dict[str, Any]:
    """Content of result.json.

    `solution`: solution of any status; missing parts (no motion, no certificate) are None. Plain
    numbers, strings, lists and dicts; no NaN and no infinity.
    """
    document = {
        "schema": SCHEMA,
        "status": str(solution.status),
        **pick(solution, "message", "objective", "duration"),
        "certificate": _certificate_document(solution.assessment),
        "baselines": {name: _baseline_document(each) for name, each in solution.baselines.items()},
        "ratio_to_better_baseline": solution.ratio_to_better_baseline,
        "strict_baseline": _strict_baseline_document(solution),
        **pick(solution, "solver", "notes"),
        "simulation": simulation_document(solution.simulation),
        "compensation": compensation_document(solution.compensation),
        **pick(solution, "inputs_hash", "versions"),
    }
    found: dict[str, Any] = to_json_types(document)
    return found


def _strict_baseline_document(solution: Solution) -> dict[str, Any] | None:
    """Baseline that keeps every limit, with the ratio to it."""
    strict = solution.strict_baseline
    if strict is None:
        return None
    return {
        "name": strict.name,
        **_baseline_document(strict),
        "ratio": solution.ratio_to_strict_baseline,
    }


def write_result(
    solution: Solution,
    directory: str | Path,
    problem: str | Path | None = None,
    *,
    stated: TrajectoryProblem | None = None,
    home: str | Path | None = None,
    changes: Sequence[str] = (),
    model: str | Path | None = None,
    effects: str | Path | None = None,
    leg: int | None = None,
    guess: str | Path | None = None,
) -> Path:
    """Write result.json into `directory`, after the motion files; return its path.

    Parameters
    ----------
    problem : path, optional
        Solved file; stored relative to the folder, so that both can move together.
    stated : TrajectoryProblem, optional
        Adds title, joint names, and hashes of motion, robot, payload and limits.
    home : path, optional
        Final folder of the file, if other than `directory`.
    changes : sequence of str, optional
        Changed entries of the problem file, as given to --set.
    model, effects : path, optional
        Extended model of the plan, and the file of its effects.
    leg : int, optional
        Number (from 1) of the leg of a cycle that this is, whose duration is that of `stated`.
    guess : path, optional
        Result folder whose solved state the solve started from.
    """
    document = result_document(solution)
    if leg is not None and stated is not None:
        document["leg"] = {"number": leg, "duration": stated.duration}
    if stated is not None:
        document |= {"title": stated.title, **motion_facts(stated, directory)}
        if stated.path_choice is not None:
            document["path_choice"] = stated.path_choice
    named = {"problem": problem, "model": model, "effects": effects, "guess": guess}
    for key, file in named.items():
        if file is not None:
            document[key] = Path(os.path.relpath(file, home or directory)).as_posix()
    if changes:
        document["changes"] = list(changes)
    path = Path(directory) / RESULT_FILE
    write_json(path, document)
    return path


def motion_facts(stated: TrajectoryProblem, directory: str | Path) -> dict[str, Any]:
    """Joints and seal of a certified motion, which its export needs; as of `motion_seal`."""
    robot = stated.robot
    joints = [
        {"name": name, "slides": bool(slides)}
        for name, slides in zip(robot.joint_names, robot.prismatic, strict=True)
    ]
    return {"joints": joints, "seal": motion_seal(stated, directory)}


def motion_seal(stated: TrajectoryProblem, directory: str | Path) -> dict[str, Any]:
    """Hashes (SHA-256) of robot, payload, limits and files of a certified motion.

    `directory`: folder of trajectory.csv and command.csv, as far as written.
    """
    return {
        # Payload before robot, which contains it: the first difference names the cause.
        "payload": inputs_hash(getattr(stated.robot, "payload", None)),
        "robot": inputs_hash(stated.robot),
        "limits": inputs_hash(stated.active_limits),
        "files": {
            name: file_hash(Path(directory) / name)
            for name in (TRAJECTORY_FILE, COMMAND_FILE)
            if (Path(directory) / name).is_file()
        },
    }


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def read_document(path: Path) -> dict[str, Any]:
    """Content of a result.json; raise `InputFileError` if it is missing or no result."""
    check_result(path.parent, RESULT_FILE, TRAJECTORY_FILE)
    document = load_json(path)
    if not isinstance(document, dict) or "inputs_hash" not in document:
        raise InputFileError(path, "", "is no result of `stiffopt solve`.")
    return document


def read_joints(document: dict[str, Any], path: Path) -> tuple[tuple[str, ...], np.ndarray]:
    """Joint names of a result, and its prismatic joints (n,).

    Raises `InputFileError`: the result has no joint names; `path` is its file.
    """
    try:
        joints = [(str(joint["name"]), bool(joint["slides"])) for joint in document["joints"]]
    except (KeyError, TypeError) as error:
        raise InputFileError(
            path, "joints", "this result does not name its joints. Solve again."
        ) from error
    return tuple(name for name, _ in joints), np.array([slides for _, slides in joints])


def check_samples(duration: float, rate: float) -> None:
    """Raise `InputError` where duration [s] times rate [Hz] exceeds `MAX_SAMPLES`."""
    if not duration * rate <= MAX_SAMPLES + 1:
        raise InputError(
            f"{duration:.4g} s at {rate:.4g} Hz are more than {MAX_SAMPLES:.0e} samples. Check the"
            " times of the motion, or give a lower rate."
        )


def export_times(duration: float, rate: float | None = None) -> np.ndarray:
    """Times (K,) of trajectory.csv [s]: every 1/rate (default `EXPORT_RATE`), and exactly the end.

    A long motion has as many samples as a table holds; raises `InputError` where more than
    `MAX_SAMPLES` are asked for.
    """
    rate = min(EXPORT_RATE, MAX_SAMPLES / duration) if rate is None else rate
    check_samples(duration, rate)
    # A last step below a millionth of the others is rounding, not a sample.
    whole = math.floor(duration * rate - 1e-6)
    return np.append(np.arange(whole + 1) / rate, duration)


def write_trajectory(
    assessment: Assessment, directory: str | Path, name: str = TRAJECTORY_FILE
) -> Path:
    """Write a trajectory file into `directory`; return its path.

    With planned links, link positions are added as columns: q is then the motor command, and
    torques are those of the links' motion (`COLUMNS`). `assessment`: evaluated at
    `export_times(duration)`. `name`: of the file.
    """
    arrays = {
        "t": assessment.time,
        "q": assessment.position,
        "qd": assessment.velocity,
        "qdd": assessment.acceleration,
        "tau": assessment.torque,
        "tau_spring": assessment.spring_torque,
        "k": assessment.stiffness,
        "windup": assessment.windup,
        "tool_": assessment.tool,
        "deflection_": assessment.deflection["total"],
        "deflection_dynamic_": assessment.deflection["dynamic"],
        "link": assessment.link,
        "force_": assessment.force,
    }
    path = Path(directory) / name
    write_motion_table(path, arrays)
    return path


def write_rival(compensation: Compensation | None, directory: Path) -> None:
    """Write motion and command of the best rival, where it wins; else remove earlier ones."""
    plan = None if compensation is None else compensation.rival_plan
    if plan is None:
        (directory / RIVAL_TRAJECTORY_FILE).unlink(missing_ok=True)
    else:
        write_trajectory(plan, directory, RIVAL_TRAJECTORY_FILE)
    command = None if compensation is None else compensation.rival_command
    write_motors(command, directory / RIVAL_COMMAND_FILE)


def write_simulation(
    simulation: Simulation, directory: str | Path, compensation: Compensation | None = None
) -> Path:
    """Write simulation.json and simulation.csv (the optimised motion); return the first's path.

    Includes the effect of the command on uncertain arms, if there is one.
    """
    folder = Path(directory)
    content = {"schema": SCHEMA, **(simulation_document(simulation) or {})}
    if compensation is not None:
        # The command was written by an earlier solve.
        led = {**(compensation_document(compensation) or {}), "command": compensation.file}
        content["compensation"] = {**led, "servo": compensation.loop or None}
    found = simulation.optimised.simulated
    arrays = {
        "t": found.time,
        "deviation_": found.error.position,
        "rotation_": found.error.orientation,
        **pick(found.error, "along", "across"),
        "q": found.position,
        "qd": found.velocity,
        "tau_spring": found.spring_torque,
        "windup": found.windup,
    }
    write_motion_table(folder / "simulation.csv", arrays)
    write_json(folder / SIMULATION_FILE, content)
    return folder / SIMULATION_FILE


def _violation_document(violation: Violation) -> dict[str, Any]:
    # Only collisions have pair and distance.
    return {
        key: value
        for key, value in vars(violation).items()
        if value is not None or key not in ("pair", "distance")
    }


def _certificate_document(assessment: Assessment | None) -> dict[str, Any] | None:
    if assessment is None:
        return None
    return {
        "points": len(assessment.time),
        "worst_violation": _violation_document(assessment.worst_violation),
        "min_stiffness": assessment.min_stiffness,
        "deflection": assessment.deflection_summary(),
        "violations": [_violation_document(each) for each in assessment.violations],
        **pick(assessment, "lowest_stiffness", "integrals"),
    }


def _baseline_document(baseline: Baseline) -> dict[str, Any]:
    motion = baseline.assessment
    return {
        "feasible": baseline.feasible,
        "duration": None if motion is None else motion.duration,
        "objective": baseline.objective,
        "deflection": motion and motion.deflection_summary(),
        "min_stiffness": motion and motion.min_stiffness,
        "worst_violation": None if motion is None else _violation_document(motion.worst_violation),
        "reason": baseline.reason,
    }
