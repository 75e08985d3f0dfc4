"""result.json and trajectory.csv: the files a solve leaves behind.

Values are SI with full precision; what is not a finite number is null in JSON. Joint numbers are
1-based.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.errors import InputError, InputFileError
from stiffopt.files import atomic_write, load_json, plain, write_csv
from stiffopt.folders import check_result
from stiffopt.result.assessment import Assessment, LowestStiffness, Violation
from stiffopt.result.compensation_store import compensation_document
from stiffopt.result.simulation import ElasticMotion, SimulatedPart, Simulation
from stiffopt.result.solution import Baseline, ObjectiveValue, Solution

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.compensation import Compensation

SCHEMA = 1
EXPORT_RATE = 500.0
# Of one motion in a table; at 500 Hz half an hour, in a file of 500 MB.
MAX_SAMPLES = 1_000_000
RESULT_FILE = "result.json"
TRAJECTORY_FILE = "trajectory.csv"
SIMULATION_FILE = "simulation.json"


def result_document(solution: Solution) -> dict[str, Any]:
    """Content of result.json.

    Parameters
    ----------
    solution : Solution
        Of any status; what does not exist (no motion, no certificate) is None.

    Returns
    -------
    dict
        Plain numbers, strings, lists and dicts; no NaN and no infinity.
    """
    document = {
        "schema": SCHEMA,
        "status": str(solution.status),
        "message": solution.message,
        "objective": _objective(solution.objective),
        "duration": solution.duration,
        "certificate": _certificate(solution.assessment),
        "baselines": {name: _baseline(each) for name, each in solution.baselines.items()},
        "ratio_to_better_baseline": solution.ratio_to_better_baseline,
        "strict_baseline": _strict(solution),
        "solver": vars(solution.solver),
        "notes": solution.notes,
        "simulation": simulation_document(solution.simulation),
        "compensation": compensation_document(solution.compensation),
        "inputs_hash": solution.inputs_hash,
        "versions": solution.versions,
    }
    return {key: plain(value) for key, value in document.items()}


def _strict(solution: Solution) -> dict[str, Any] | None:
    """The baseline that keeps every limit, with the ratio to it."""
    strict = solution.strict_baseline
    if strict is None:
        return None
    return {"name": strict.name, **_baseline(strict), "ratio": solution.ratio_to_strict_baseline}


def write_result(
    solution: Solution,
    directory: str | Path,
    problem: str | Path | None = None,
    *,
    stated: TrajectoryProblem | None = None,
    home: str | Path | None = None,
) -> Path:
    """Write result.json into `directory`; return its path.

    Parameters
    ----------
    solution : Solution
    directory : path
    problem : path, optional
        File that was solved; kept relative to the folder, so that both can move together.
    stated : TrajectoryProblem, optional
        Its title and the names of its joints go with the motion.
    home : path, optional
        Folder where the file will lie, where it is another than `directory`.
    """
    document = result_document(solution)
    if stated is not None:
        document["title"] = stated.title
        document["joints"] = [
            {"name": name, "slides": bool(slides)}
            for name, slides in zip(stated.robot.joint_names, stated.robot.prismatic, strict=True)
        ]
    if problem is not None:
        document["problem"] = Path(os.path.relpath(problem, home or directory)).as_posix()
    text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False)
    path = Path(directory) / RESULT_FILE
    atomic_write(path, text + "\n")
    return path


def read_document(path: Path) -> dict[str, Any]:
    """Content of a result.json.

    Raises
    ------
    InputFileError
        No such file, or one of something else.
    """
    check_result(path.parent, RESULT_FILE, TRAJECTORY_FILE)
    document = load_json(path)
    if not isinstance(document, dict) or "inputs_hash" not in document:
        raise InputFileError(path, "", "is no result of `stiffopt solve`.")
    return document


def joints_of(document: dict[str, Any], path: Path) -> tuple[tuple[str, ...], np.ndarray]:
    """Names of the joints of a result, and which of them slide (n,).

    Raises
    ------
    InputFileError
        The result does not say; `path` is its file.
    """
    try:
        joints = [(str(joint["name"]), bool(joint["slides"])) for joint in document["joints"]]
    except (KeyError, TypeError) as error:
        raise InputFileError(
            path, "joints", "this result does not name its joints. Solve again."
        ) from error
    return tuple(name for name, _ in joints), np.array([slides for _, slides in joints])


def check_samples(duration: float, rate: float) -> None:
    """Raise `InputError` where a motion [s] at a rate [Hz] has more samples than any table."""
    if not duration * rate <= MAX_SAMPLES + 1:
        raise InputError(
            f"{duration:.4g} s at {rate:.4g} Hz are more than {MAX_SAMPLES:.0e} samples. Check the"
            " times of the motion, or give a lower rate."
        )


def export_times(duration: float, rate: float | None = None) -> np.ndarray:
    """Instants of trajectory.csv: every 1/rate, the last one exactly the end.

    Parameters
    ----------
    duration : float [s]
    rate : float [Hz], optional
        `EXPORT_RATE`, or as many samples of a longer motion as a table takes.

    Returns
    -------
    array (K,) [s]

    Raises
    ------
    InputError
        More samples than `MAX_SAMPLES`.
    """
    rate = min(EXPORT_RATE, MAX_SAMPLES / duration) if rate is None else rate
    check_samples(duration, rate)
    # A last step shorter than a millionth of the others is rounding, not a sample.
    whole = math.floor(duration * rate - 1e-6)
    return np.append(np.arange(whole + 1) / rate, duration)


def trajectory_columns(joints: int) -> list[str]:
    """Column names of trajectory.csv for a number of joints."""
    names = ["t"]
    for quantity in ("q", "qd", "qdd", "tau", "tau_spring", "k", "windup"):
        names += [f"{quantity}{joint}" for joint in range(1, joints + 1)]
    for vector in ("tool", "deflection", "deflection_dynamic"):
        names += [f"{vector}_{axis}" for axis in "xyz"]
    return names


def write_trajectory(assessment: Assessment, directory: str | Path) -> Path:
    """Write trajectory.csv into `directory`; return its path.

    Where the links are planned apart from the motors, their positions follow as further columns:
    q is then the command that makes them do what they are planned to.

    Parameters
    ----------
    assessment : Assessment
        Evaluated at `export_times(duration)`.
    directory : path
    """
    columns = [
        assessment.time[:, None],
        assessment.position,
        assessment.velocity,
        assessment.acceleration,
        assessment.torque,
        assessment.spring_torque,
        assessment.stiffness,
        assessment.windup,
        assessment.tool,
        assessment.deflection["total"],
        assessment.deflection["dynamic"],
    ]
    path = Path(directory) / TRAJECTORY_FILE
    joints = assessment.position.shape[1]
    names = trajectory_columns(joints)
    if assessment.link is not None:
        columns.append(assessment.link)
        names += [f"link{joint}" for joint in range(1, joints + 1)]
    write_csv(path, names, np.hstack(columns).tolist())
    return path


def write_simulation(
    simulation: Simulation, directory: str | Path, compensation: Compensation | None = None
) -> Path:
    """Write simulation.json and simulation.csv (the optimised motion); return the first's path.

    With what the command gives on uncertain arms, where there is a command.
    """
    folder = Path(directory)
    content = {"schema": SCHEMA, **(simulation_document(simulation) or {})}
    if compensation is not None:
        # Of a command that exists already.
        led = {**(compensation_document(compensation) or {}), "command": compensation.file}
        content["compensation"] = {**led, "servo": compensation.loop or None}
    document = plain(content)
    found = simulation.optimised.simulated
    joints = range(1, found.position.shape[1] + 1)
    names = ["t", *(f"deviation_{axis}" for axis in "xyz")]
    names += [f"{quantity}{j}" for quantity in ("q", "qd", "tau_spring", "windup") for j in joints]
    columns = [
        found.time[:, None],
        found.deviation,
        found.position,
        found.velocity,
        found.spring_torque,
        found.windup,
    ]
    write_csv(folder / "simulation.csv", names, np.hstack(columns).tolist())
    text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False)
    atomic_write(folder / SIMULATION_FILE, text + "\n")
    return folder / SIMULATION_FILE


def _objective(objective: ObjectiveValue | None) -> dict[str, Any] | None:
    return None if objective is None else dict(vars(objective))


def _violation(violation: Violation) -> dict[str, Any]:
    # Limits that are no collision have neither pair nor distance.
    return {
        key: value
        for key, value in vars(violation).items()
        if value is not None or key not in ("pair", "distance")
    }


def _lowest(lowest: LowestStiffness) -> dict[str, Any]:
    return dict(vars(lowest))


def _deflection(assessment: Assessment) -> dict[str, Any]:
    return {part: dict(vars(value)) for part, value in assessment.deflection_summary().items()}


def _certificate(assessment: Assessment | None) -> dict[str, Any] | None:
    if assessment is None:
        return None
    return {
        "points": len(assessment.time),
        "worst_violation": _violation(assessment.worst_violation),
        "min_stiffness": _lowest(assessment.min_stiffness),
        "deflection": _deflection(assessment),
        "violations": [_violation(each) for each in assessment.violations],
        "lowest_stiffness": [_lowest(each) for each in assessment.lowest_stiffness],
        "integrals": assessment.integrals,
    }


def _baseline(baseline: Baseline) -> dict[str, Any]:
    motion = baseline.assessment
    return {
        "feasible": baseline.feasible,
        "duration": None if motion is None else motion.duration,
        "objective": baseline.objective,
        "deflection": None if motion is None else _deflection(motion),
        "min_stiffness": None if motion is None else _lowest(motion.min_stiffness),
        "worst_violation": None if motion is None else _violation(motion.worst_violation),
        "reason": baseline.reason,
    }


def simulation_document(simulation: Simulation | None) -> dict[str, Any] | None:
    """Content of `simulation` in result.json, and of simulation.json."""
    if simulation is None:
        return None
    return {
        "motions": {motion.name: _elastic(motion) for motion in simulation.motions},
        "ratio_to_better_baseline": simulation.ratio_to_better_baseline,
        "assumed_damping": simulation.assumed_damping,
        "typical_hysteresis": simulation.typical_hysteresis,
    }


def _part(part: SimulatedPart | None) -> dict[str, Any] | None:
    if part is None:
        return None
    planned, simulated = dict(vars(part.planned)), dict(vars(part.simulated))
    return {"part": part.name, "planned": planned, "in_flight": simulated}


def _elastic(motion: ElasticMotion) -> dict[str, Any]:
    simulated = motion.simulated
    return {
        "counted": motion.counted,
        "duration": simulated.duration,
        "planned": dict(vars(motion.planned)),
        "in_flight": {"peak": simulated.peak, "rms": simulated.rms},
        "minimised": _part(motion.minimised),
        "after_arrival": {"peak": simulated.peak_after, "rms": simulated.rms_after},
        "settling_time": simulated.settling_time,
        "settling_band": simulated.band,
        "notes": simulated.notes,
    }
