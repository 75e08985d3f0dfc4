"""Results of earlier solves: read for a simulation, an initial guess or an error budget."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, make_interp_spline

from stiffopt.baseline.baselines import quintic_motion
from stiffopt.budget.sources import States
from stiffopt.certificate.assess import assess
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.command.command_lead import ExistingCommand
from stiffopt.command.simulation import PlannedMotion, rival_motions
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.uncertainty import Uncertainty
from stiffopt.errors import InputFileError, shortened
from stiffopt.folders import check_result, is_regular
from stiffopt.path.load import load_problem
from stiffopt.problem.files import LoadedProblem
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.archive import ARCHIVE_FILE, read_archive
from stiffopt.result.assessment import Assessment
from stiffopt.result.compensation import COMMAND_FILE
from stiffopt.result.motion_table import read_motion_table
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.simulation import PeakRms
from stiffopt.result.solution import Solution
from stiffopt.result.store import RESULT_FILE, TRAJECTORY_FILE, read_document
from stiffopt.result.trajectory import ForceHistory, JointMotion
from stiffopt.solver.family import WarmStart
from stiffopt.transcription.prepared import read_prepared, write_prepared

# Variables and multipliers at the end of a solve, from which --guess starts.
STATE_FILE = "state.bin"
# Formulas of its programme.
PREPARED_FILE = "formulas.npz"


@dataclass(frozen=True, kw_only=True)
class StoredResult:
    """Motion of a result folder with its problem."""

    problem: TrajectoryProblem  # as it was solved, but for changed tolerances
    uncertainty: Uncertainty  # with changes; the problem's where there are none
    motion: ResolvedMotion
    optimised: PlannedMotion
    windup: np.ndarray  # (K, n) of the joints along the stored motion [rad]
    command: ExistingCommand | None = None  # of command.csv, where there is one
    force: ForceHistory | None = None  # process force along a path
    model: Path | None = None  # extended model that the motion was planned with

    def motions(self) -> list[PlannedMotion]:
        """Return the stored motion, then recomputed rivals."""
        duration = float(self.optimised.time[-1])
        return [self.optimised, *rival_motions(self.problem, self.motion, duration)]


def read_result(
    folder: Path,
    problem: Path | None = None,
    changes: Sequence[str] = (),
    extend: Callable[[TrajectoryProblem, Path, Path | None], TrajectoryProblem] | None = None,
) -> StoredResult:
    """Read result.json and trajectory.csv of a folder, and the problem that they name.

    `problem`: problem file, replaces the one that the result names. `changes`: of entries of its
    [uncertainty] and [tolerances], such as "uncertainty.stiffness=0.3"; the motion does not depend
    on them. `extend`: (problem, extended model, effects) -> problem of the extended robot, for
    motions that were planned with one; without it they are refused. Raises `InputFileError`: a file
    is missing or invalid, names no problem, or the problem has changed.
    """
    path = folder / RESULT_FILE
    document = read_document(path)
    loaded = read_problem(path, document, problem)
    problem, stated = loaded.path, loaded.problem
    model, effects = (_named_file(path, document, key) for key in ("model", "effects"))
    if model is not None and extend is not None:
        stated = extend(stated, model, effects)
    check_inputs(path, document, problem, stated)
    judged = read_problem(path, document, problem, changes) if changes else loaded
    certificate = document.get("certificate")
    if not isinstance(certificate, dict):
        raise InputFileError(path, "certificate", "this solve found no motion to simulate.")
    try:
        parts = {
            name: PeakRms(**{key: float(value) for key, value in part.items()})
            for name, part in certificate["deflection"].items()
        }
        _ = parts["dynamic"]
        worst = float(certificate["worst_violation"]["value"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputFileError(
            path, "certificate", f"has no usable numbers: {shortened(error)}. Solve again."
        ) from error
    time, position, velocity, windup = _read_joint_table(
        folder / TRAJECTORY_FILE, stated.joints, ("q", "qd", "windup")
    )
    own = PlannedMotion(
        name="optimised",
        time=time,
        position=position,
        velocity=velocity,
        parts=parts,
        counted=worst <= CERTIFICATE_TOLERANCE,
        path=_read_planned_links(folder, stated.joints),
    )
    return StoredResult(
        problem=replace(stated, tolerances=judged.problem.tolerances),
        uncertainty=judged.problem.uncertainty,
        motion=resolve(stated),
        optimised=own,
        windup=windup,
        command=_read_command(folder, document, own),
        force=_read_force(folder / TRAJECTORY_FILE),
        model=model,
    )


def _named_file(path: Path, document: dict[str, Any], key: str) -> Path | None:
    """Return a file that a result.json at `path` names; None where it names none."""
    named = document.get(key)
    return path.parent / named if isinstance(named, str) else None


def _read_force(path: Path) -> ForceHistory | None:
    """Read the force along the path from trajectory.csv, None where there is none."""
    table = read_motion_table(path, 0, (), ["force_"])
    if "force_" not in table:
        return None
    return ForceHistory(table["t"], table["force_"])


def problem_file(path: Path, document: dict[str, Any], given: Path | None = None) -> Path:
    """Return the problem file of a result.json at `path`: the one given, else the one it names.

    Raises `InputFileError`: it names none, or there is none.
    """
    if given is not None:
        return given
    named = document.get("problem")
    if not isinstance(named, str):
        raise InputFileError(
            path,
            "problem",
            "this result does not say which problem file it solved. Give it as --problem, or "
            "solve again.",
        )
    problem = path.parent / named
    if not problem.is_file():
        raise InputFileError(
            path, "problem", f"there is no problem file {problem}. Give it as --problem."
        )
    return problem


def read_changes(path: Path, document: dict[str, Any]) -> tuple[str, ...]:
    """Return the entries of the problem file that the solve changed, as --set has them."""
    changes = document.get("changes", [])
    if not isinstance(changes, list) or not all(isinstance(each, str) for each in changes):
        raise InputFileError(path, "changes", "is no list of texts KEY=VALUE. Solve again.")
    return tuple(changes)


def read_problem(
    path: Path,
    document: dict[str, Any],
    given: Path | None = None,
    changes: Sequence[str] = (),
) -> LoadedProblem:
    """Read the problem of a result.json at `path` as it was solved, and further changes.

    The freedom of its path is as the solve chose it.
    """
    file, solved = problem_file(path, document, given), read_changes(path, document)
    return load_problem(file, (*solved, *changes), choice=document.get("path_choice"))


def check_inputs(
    path: Path, document: dict[str, Any], problem: Path, stated: TrajectoryProblem
) -> None:
    """Raise `InputFileError` unless a result at `path` is of this problem, read from a file."""
    if inputs_hash(stated) != document.get("inputs_hash"):
        with_model = ", or the solve was with --model" if "model" in document else ""
        raise InputFileError(
            path,
            "inputs_hash",
            f"{problem} differs from the problem solved: it or its robot has changed since"
            f"{with_model}. Solve it again.",
        )


def _read_command(
    folder: Path, document: dict[str, Any], planned: PlannedMotion
) -> ExistingCommand | None:
    """Read the command that the solve wrote, None where it wrote none."""
    path, joints = folder / COMMAND_FILE, planned.position.shape[1]
    try:
        made = document["compensation"]
        if made is None or made["command"] is None:
            return None
        own = made["motions"]["optimised"]
        spacing, share = own["knot_spacing"], float(own["share_of_windup"])
        spacing = None if spacing is None else float(spacing)
    except (KeyError, TypeError, ValueError) as error:
        raise InputFileError(
            folder / RESULT_FILE, "compensation", f"has no usable {error}."
        ) from error
    check_result(folder, RESULT_FILE, COMMAND_FILE)
    quantities = ("q", "qd", "qdd")
    rows = _read_joint_table(path, joints, quantities)
    motors = _TableMotion(*rows)
    link = planned.path or _TableMotion(
        *_read_joint_table(folder / TRAJECTORY_FILE, joints, quantities)
    )
    if isinstance(link, _TableMotion):
        link.force = _read_force(folder / TRAJECTORY_FILE)
    motors.link = link
    return ExistingCommand(motors, spacing, share)


def _read_planned_links(folder: Path, joints: int) -> JointMotion | None:
    """Read the planned motion of the links, None where the motors follow the plan."""
    table = read_motion_table(folder / TRAJECTORY_FILE, joints, (), ["link"])
    if "link" not in table:
        return None
    moments = table["t"]
    links = CubicSpline(moments, table["link"], bc_type="clamped")
    return _TableMotion(moments, links(moments), links(moments, 1), links(moments, 2))


def _read_joint_table(path: Path, joints: int, quantities: Sequence[str]) -> tuple[np.ndarray, ...]:
    """Read times (K,) and joint quantities (K, n) of a table."""
    table = read_motion_table(path, joints, quantities)
    if table["t"][0] != 0.0 or not np.all(np.diff(table["t"]) > 0.0):
        raise InputFileError(path, "t", "the times must begin at 0 and increase.")
    return tuple(table.values())


def read_guess(folder: Path, problem: TrajectoryProblem) -> Assessment:
    """Read the motion of a result folder of the same arm as an initial guess.

    Raises `InputFileError`: the folder has no motion of as many joints.
    """
    check_result(folder, TRAJECTORY_FILE)
    time, position, velocity = _read_joint_table(
        folder / TRAJECTORY_FILE, problem.joints, ("q", "qd")
    )
    return assess(problem, _TableMotion(time, position, velocity), times=time)


def read_state(folder: Path) -> WarmStart | None:
    """Read the solved state of a result folder; None where it has none that can be used."""
    if not is_regular(folder, STATE_FILE):
        return None
    prepared = is_regular(folder, PREPARED_FILE)
    check_result(folder, STATE_FILE, *([PREPARED_FILE] if prepared else []))
    if prepared:
        read_prepared(folder / PREPARED_FILE)
    return WarmStart.from_bytes((folder / STATE_FILE).read_bytes())


def write_state(state: WarmStart | None, folder: Path) -> None:
    """Write the solved state into a result folder, where there is one, and its functions."""
    if state is not None:
        (folder / STATE_FILE).write_bytes(state.to_bytes())
        write_prepared(folder / PREPARED_FILE)


def read_stored_solution(folder: Path) -> tuple[TrajectoryProblem, Solution]:
    """Return problem and solution of a solve without a report, as they were.

    Raises `InputFileError`: a file is missing or damaged, the problem has changed, or the solve
    drew its report.
    """
    path = folder / RESULT_FILE
    document = read_document(path)
    if not is_regular(folder, ARCHIVE_FILE):
        drawn = is_regular(folder, "report.html")
        raise InputFileError(
            folder / ARCHIVE_FILE,
            "",
            "is missing: `stiffopt solve` drew report.html itself and stored nothing to draw from."
            if drawn
            else "is missing: `stiffopt solve --no-report` stores what a page shows. Solve again.",
        )
    check_result(folder, ARCHIVE_FILE)
    loaded = read_problem(path, document)
    check_inputs(path, document, loaded.path, loaded.problem)
    return loaded.problem, read_archive(folder)


class _TableMotion:
    """Motion between the rows of a table, by cubic polynomials.

    Accelerations of the table are interpolated linearly, so that neither they nor their slope
    exceed those of the motion; `link` is the motion of the links, where it differs, `force` that of
    the process along its path.
    """

    def __init__(
        self,
        time: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        acceleration: np.ndarray | None = None,
    ) -> None:
        self._orders = [CubicHermiteSpline(time, position, velocity)]
        for _ in range(3):
            self._orders.append(self._orders[-1].derivative())
        if acceleration is not None:
            straight = make_interp_spline(time, acceleration, k=1)
            self._orders[2:] = [straight, straight.derivative()]
        self.duration = float(time[-1])
        self.link: JointMotion | None = None
        self.force: ForceHistory | None = None

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        return np.asarray(self._orders[order](t))


# Instants of a budget along a motion.
_INSTANT_COUNT = 121


def problem_states(problem: TrajectoryProblem) -> States:
    """Return the states of the quintic motion of a problem, at the least duration allowed."""
    motion = MotorMotion.of(quintic_motion(problem, resolve(problem)))
    return _sample_states(motion, motion, problem)


def solved_states(stored: StoredResult) -> States:
    """Return the states of a solved motion; the servos follow its command, if there is one."""
    own = stored.optimised
    motion = MotorMotion(own.time, own.position, own.velocity)
    command = motion if stored.command is None else MotorMotion.of(stored.command.motors)
    return _sample_states(motion, command, stored.problem)


def _sample_states(motion: MotorMotion, command: MotorMotion, problem: TrajectoryProblem) -> States:
    time = np.linspace(0.0, motion.duration, _INSTANT_COUNT)
    # Commands are sent ahead of the plan by the known dead time.
    followed = problem.servo.follow(command, motion.duration, problem.led_servo.dead_time)
    lag = followed.position(time) - motion.position(time)
    return States(
        time=time,
        position=motion(time),
        velocity=motion(time, 1),
        acceleration=motion(time, 2),
        lag=lag,
    )
