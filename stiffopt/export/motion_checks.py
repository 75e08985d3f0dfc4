"""Assessment of a stored motion before its export.

Files can change after certification. Rows are therefore checked against hashes, duration and the
limits of the problem, by the certificate's own model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from stiffopt.certificate.assess import assess, drive_violations
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.discovery.extended.planning import extended_problem, planner_model, read_model
from stiffopt.errors import InputError, InputFileError
from stiffopt.problem.cycle_files import load_cycle
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.recipe.stored_result import check_inputs, problem_file, read_changes, read_problem
from stiffopt.result.assessment import Violation
from stiffopt.result.cycle import leg_folder
from stiffopt.result.motion_table import read_motion_table
from stiffopt.result.store import RESULT_FILE, export_times, file_hash, motion_seal, read_document

# Tolerance of times on the grid of 2 ms [s]: rounding of the file.
_TIME_ROUNDING = 1e-9


class SampledRows:
    """Sampled motion with the interface of the certificate.

    `time` (K,) [s]. `rows` (K, n): position, velocity and acceleration. Jerk is the slope of the
    acceleration between samples, at most the largest jerk of the sampled motion. `link`: link
    positions, where planned apart from the motors'.
    """

    def __init__(
        self,
        time: np.ndarray,
        rows: Sequence[np.ndarray] | np.ndarray,
        link: CubicSpline | None = None,
    ) -> None:
        position, velocity, acceleration = rows
        jerk = np.diff(acceleration, axis=0) / np.diff(time)[:, None]
        self.time, self.duration = time, float(time[-1])
        self._orders = (position, velocity, acceleration, np.vstack([jerk, jerk[-1:]]))
        if link is not None:
            end = float(link.x[-1])
            self.link = lambda t, order=0: link(np.minimum(t, end), order)

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Derivative of this order (K, n); `t` are the sampling times."""
        return self._orders[order]


def solved_legs(
    path: Path, document: dict[str, Any], given: Path | None = None
) -> list[TrajectoryProblem]:
    """Return the problems of the legs of a cycle.json at `path`, each as long as it was solved.

    Raises `InputFileError`: the problem file is missing, or has another number of legs.
    """
    cycle = load_cycle(problem_file(path, document, given), read_changes(path, document)).cycle
    found = []
    for number, leg in enumerate(cycle.legs, start=1):
        stored = read_document(path.parent / leg_folder(number) / RESULT_FILE)
        solved = stored.get("leg")
        if not isinstance(solved, dict) or not isinstance(solved.get("duration"), list):
            raise InputFileError(path, "legs", f"leg {number} is of no cycle. Solve again.")
        lower, upper = (np.inf if each is None else float(each) for each in solved["duration"])
        found.append(replace(leg.problem, duration=(lower, upper)))
    return found


def solved_problem(
    path: Path,
    document: dict[str, Any],
    given: Path | None = None,
    known: TrajectoryProblem | None = None,
) -> TrajectoryProblem:
    """Return the solved problem of a result.json at `path`, with its changes and model.

    `known` is the problem where it was read already. Raises `InputFileError`: a file is missing, or
    robot, payload, limits or problem have changed.
    """
    file = problem_file(path, document, given)
    stated = known or read_problem(path, document, file).problem
    named = [document.get(key) for key in ("model", "effects")]
    if isinstance(named[0], str):
        model, effects = (path.parent / each if isinstance(each, str) else None for each in named)
        assert model is not None
        stated = extended_problem(stated, planner_model(stated.robot, read_model(model, effects)))
    check_seal(path, document, stated, str(file))
    check_inputs(path, document, file, stated)
    return stated


def check_seal(
    path: Path, document: dict[str, Any], stated: TrajectoryProblem, source: str
) -> None:
    """Raise `InputFileError` where robot, payload or limits are not those of the stored motion."""
    seal = sealed(path, document)
    for key, value in motion_seal(stated, path.parent).items():
        if key != "files" and seal[key] != value:
            raise InputFileError(
                path,
                f"seal.{key}",
                f"the {key} of {source} {'differ' if key == 'limits' else 'differs'} from the "
                "certified one. Solve again.",
            )


def sealed(path: Path, document: dict[str, Any]) -> dict[str, Any]:
    """Return the hashes of the motion in a result.json at `path`.

    Raises `InputFileError`: the result has no hashes, as those of earlier versions.
    """
    seal = document.get("seal")
    texts = isinstance(seal, dict) and all(
        isinstance(seal.get(key), str) for key in ("robot", "payload", "limits")
    )
    if not isinstance(seal, dict) or not texts or not isinstance(seal.get("files"), dict):
        raise InputFileError(
            path,
            "seal",
            "this result has no hashes of its motion, robot, payload and limits, as results of "
            "earlier versions. Solve again.",
        )
    return dict(seal)


def read_rows(
    file: Path, path: Path, document: dict[str, Any], problem: TrajectoryProblem
) -> tuple[np.ndarray, np.ndarray, CubicSpline | None]:
    """Read times (K,), position to acceleration (3, K, n) and links of a table.

    `path` is that of its result.json, `document` its content. Raises `InputFileError` where the
    table is not the certified one: another hash, missing rows, inconsistent times or columns.
    """
    table = read_motion_table(file, problem.joints, ("q", "qd", "qdd"), ["link"])
    if file_hash(file) != sealed(path, document)["files"].get(file.name):
        raise InputFileError(
            file, "", f"is not the motion that was certified: {path.name} has another hash of it. "
            "Solve again."
        )  # fmt: skip
    time, rows = table["t"], np.stack([table[name] for name in ("q", "qd", "qdd")])
    _check_times(file, time)
    _check_derivatives(file, time, rows, problem.active_limits.jerk)
    if "link" not in table:
        return time, rows, None
    # End velocities of the links are those of the motors: the wind-up is nearly constant there.
    ends = ((1, rows[1, 0]), (1, rows[1, -1]))
    moved = CubicSpline(time, table["link"], bc_type=ends)
    return time, rows, moved


def _check_times(file: Path, time: np.ndarray) -> None:
    """Raise `InputFileError` unless the times are the export grid."""
    wanted = export_times(float(time[-1])) if time[-1] > 0.0 else np.zeros(0)
    if len(wanted) == len(time) and np.all(np.abs(time - wanted) <= _TIME_ROUNDING):
        return
    if time[0] != 0.0 or not np.all(np.diff(time) > 0.0):
        raise InputFileError(file, "t", "the times must start at 0 and increase.")
    row = int(np.argmax(np.abs(time[: len(wanted)] - wanted[: len(time)]) > _TIME_ROUNDING)) + 1
    raise InputFileError(
        file, f"row {row}, t", "is not every 2 ms: rows are missing or the times were changed. "
        "Solve again."
    )  # fmt: skip


def _check_derivatives(file: Path, time: np.ndarray, rows: np.ndarray, jerk: np.ndarray) -> None:
    """Raise `InputFileError` where velocities or accelerations contradict the positions."""
    step = np.diff(time)[:, None]
    # Change of the acceleration between two rows: between them it may leave and return, as far as
    # the jerk limit allows, without one as far as it does anywhere.
    bend = np.abs(np.diff(rows[2], axis=0))
    excursion = np.where(np.isfinite(jerk), 0.5 * jerk * step, np.inf)
    bend = np.maximum(bend, np.minimum(excursion, 2.0 * np.max(np.abs(rows[2]), axis=0)))
    for order, quantity in ((0, "velocity"), (1, "acceleration")):
        own, rate = rows[order], rows[order + 1]
        mean = np.diff(own, axis=0) / step
        # The mean of a monotonic acceleration lies between its rows; that of the velocity is off
        # the mean of its rows by at most an eighth of the change of acceleration times the step.
        off = bend * step / 8.0 if order == 0 else bend / 2.0
        rounding = 1e-12 / step
        room = CERTIFICATE_TOLERANCE * np.max(np.abs(rate), axis=0) + off + rounding
        beyond = np.abs(mean - 0.5 * (rate[:-1] + rate[1:])) - room
        if np.any(beyond > 0.0):
            k, j = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
            raise InputFileError(
                file,
                f"row {k + 1}",
                f"the {quantity} of joint {j + 1} contradicts the motion to the next row at "
                f"{time[k]:.3f} s: the file was changed. Solve again.",
            )


def judge_plan(problem: TrajectoryProblem, motion: SampledRows, file: Path) -> None:
    """Raise `InputFileError` where the rows of a trajectory.csv exceed a limit or miss an end.

    Vias are not checked: they are passed between rows.
    """
    found = assess(problem, motion, times=motion.time).violations
    _require_within_limits([each for each in found if not each.limit.startswith("via_")], str(file))


def judge_samples(problem: TrajectoryProblem, motion: SampledRows, name: str) -> Violation:
    """Return the tightest limit of the drives at the samples; raise `InputError` beyond it."""
    found = drive_violations(problem, motion, motion.time)
    _require_within_limits(found, name)
    return found[0]


def _require_within_limits(found: Sequence[Violation], name: str) -> None:
    """Raise `InputError` where a limit is exceeded by more than the certificate's tolerance."""
    # `not <=` refuses nan as well.
    over = [each for each in found if not each.value <= CERTIFICATE_TOLERANCE]
    if over:
        raise InputError(
            f"{name}: the motion exceeds {over[0].describe()}, so it is not exported. Solve again "
            "until every limit holds."
        )
