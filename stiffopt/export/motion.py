"""Motion of a result folder, resampled for export."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.interpolate import BPoly, CubicSpline, make_interp_spline

from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.errors import InputError, InputFileError, format_relative
from stiffopt.export.motion_checks import (
    SampledRows,
    judge_plan,
    judge_samples,
    read_rows,
    sealed,
    solved_problem,
)
from stiffopt.folders import check_result
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result import store
from stiffopt.result.assessment import Violation
from stiffopt.result.compensation import COMMAND_FILE

Which = Literal["motor", "link"]


@dataclass(frozen=True, kw_only=True)
class MotionEvent:
    """Event of the gripper or tool changer."""

    time: float  # [s]
    kind: str  # "grip", "release" or "tool_change"
    mass: float  # all that the flange carries afterwards [kg]

    def __str__(self) -> str:
        return f"{self.kind.replace('_', ' ')} at {self.time:.3f} s, then {self.mass:g} kg"


@dataclass(frozen=True, kw_only=True)
class SampledMotion:
    """Sampled motion for a controller."""

    title: str  # title of the result
    which: Which  # "motor" or "link": motion of motors or links
    joint_names: tuple[str, ...]
    prismatic: np.ndarray  # (n,) True for prismatic joints
    velocity_max: np.ndarray  # (n,) [rad/s] limits of the robot
    time: np.ndarray  # (K,) [s] times from 0
    # (K, n) [rad], [rad/s], [rad/s^2]; metres for radians of prismatic joints.
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    events: tuple[MotionEvent, ...] = ()  # in order

    def events_until(self, sample: int) -> list[MotionEvent]:
        """Events after the sample before and up to this one."""
        before = -np.inf if sample == 0 else self.time[sample - 1]
        return [each for each in self.events if before < each.time <= self.time[sample]]


@dataclass(frozen=True, kw_only=True)
class StoredMotion:
    """Motion of a result folder, interpolated between the rows of its trajectory.csv."""

    title: str
    which: Which  # "motor" or "link"
    joint_names: tuple[str, ...]
    prismatic: np.ndarray  # (n,)
    curve: BPoly | CubicSpline  # position over time [s]
    # Motion of the links, which determines motor loads, if this is the motion of the motors.
    link: CubicSpline | None
    problem: TrajectoryProblem  # problem whose limits apply
    seal: dict[str, str]  # hashes of the motion's file, the robot, its payload and the limits
    events: tuple[MotionEvent, ...] = ()

    def sampled(
        self, rate: float, *, whole_steps: bool = False, at_events: bool = False
    ) -> SampledMotion:
        """Sample at a rate [Hz].

        `whole_steps` holds the end position to the next multiple of 1/rate; else the last step
        ends with the motion. `at_events` puts the events in place of the nearest samples.
        """
        end = float(self.curve.x[-1])
        times = store.export_times(end, rate)
        if whole_steps:
            times = np.arange(math.ceil(end * rate - 1e-6) + 1) / rate
        if at_events:
            for event in self.events:
                times = np.append(times[np.abs(times - event.time) > 0.5 / rate], event.time)
            times.sort()
        moving = times <= end
        inside = np.minimum(times, end)
        # The held end is at rest, whatever the derivatives of the curve at its end.
        velocity = self.curve.derivative(1)(inside)
        # Linear interpolation: acceleration and jerk stay within those of the motion, where a
        # polynomial would overshoot at jumps.
        breaks = self.curve.x
        acceleration = make_interp_spline(breaks, self.curve.derivative(2)(breaks), k=1)(inside)
        return SampledMotion(
            title=self.title,
            which=self.which,
            joint_names=self.joint_names,
            prismatic=self.prismatic,
            velocity_max=self.problem.robot.velocity_max,
            time=times,
            position=self.curve(inside),
            velocity=np.where(moving[:, None], velocity, 0.0),
            acceleration=np.where(moving[:, None], acceleration, 0.0),
            events=self.events,
        )

    def judge(self, motion: SampledMotion) -> Violation:
        """Return the tightest limit of the drives at the samples; `InputError` beyond it."""
        rows = (motion.position, motion.velocity, motion.acceleration)
        return judge_samples(
            self.problem, SampledRows(motion.time, rows, self.link), f"{self.title}, sampled"
        )

    def require_rest(self, owner: str) -> None:
        """Raise `InputError` unless the motion starts and ends at rest."""
        velocity = self.curve.derivative(1)(self.curve.x)
        # Share of a joint's largest velocity below which it counts as at rest.
        moves = np.abs(velocity[[0, -1]]) > 1e-3 * np.max(np.abs(velocity), axis=0)
        for k, side, action in (
            (0, "start", "starts with an approach to rest"),
            (1, "end", "stops there"),
        ):
            if np.any(moves[k]):
                j = int(np.argmax(moves[k]))
                raise InputError(
                    f"joint {j + 1} ({self.joint_names[j]}) moves at the {side}, by "
                    f"{velocity[-k, j]:.4g} rad/s; a program of {owner} {action}. Export it with "
                    "--to ros2 or csv, or plan without motion.boundary_velocity."
                )


class SplineMotion:
    """Curve as a `JointMotion`."""

    def __init__(self, curve: Any) -> None:
        self._curve, self.times = curve, np.asarray(curve.x)
        self.duration = float(self.times[-1])

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Evaluate the position or a derivative at times (K,)."""
        return np.asarray(self._curve.derivative(order)(t) if order else self._curve(t))


def read_motion(
    folder: Path,
    which: Which = "motor",
    problem: Path | None = None,
    stated: TrajectoryProblem | None = None,
) -> StoredMotion:
    """Read and assess the motion of a result folder.

    `folder`: folder of `stiffopt solve`. `which`: command of the drives (command.csv if present),
    or planned motion of the links. `problem`: problem file in place of that of the result.
    `stated`: the solved problem, where it was read already. Raises `InputError`: no result, a
    motion that is not the certified one or exceeds a limit, or no link columns.
    """
    path = folder / store.RESULT_FILE
    document = store.read_document(path)
    duration = _certified_duration(path, document)
    names, prismatic = store.read_joints(document, path)
    stated = solved_problem(path, document, problem, stated)
    file = folder / store.TRAJECTORY_FILE
    time, rows, link = read_rows(file, path, document, stated)
    if abs(time[-1] - duration) > 1e-9 * duration:
        raise InputFileError(
            file, "t", f"the motion lasts {time[-1]:.6g} s, but {path.name} says {duration:.6g} s: "
            "it was cut or scaled. Solve again."
        )  # fmt: skip
    judge_plan(stated, SampledRows(time, rows, link), file)
    listed, command = sealed(path, document)["files"], folder / COMMAND_FILE
    if COMMAND_FILE in listed or command.is_file():
        check_result(folder, store.RESULT_FILE, COMMAND_FILE)
        moved = read_rows(command, path, document, stated)
        judge_samples(stated, SampledRows(*moved), str(command))
        if which == "motor":
            file, (time, rows, link) = command, moved
        elif link is None:
            # Beside a motor command, the plan is the links' motion.
            link = CubicSpline(time, rows[0], bc_type="clamped")
    if which == "link" and link is None:
        raise InputFileError(
            file,
            "link1",
            "one motion is planned for motors and links; there is no separate link motion. "
            "Export that of the motors.",
        )
    curve = link if which == "link" else BPoly.from_derivatives(time, rows.transpose(1, 0, 2))
    seal = {key: sealed(path, document)[key] for key in ("robot", "payload", "limits")}
    return StoredMotion(
        title=str(document.get("title") or folder.resolve().name),
        which=which,
        joint_names=names,
        prismatic=prismatic,
        curve=curve,
        link=link if which == "motor" else None,
        problem=stated,
        seal={"motion": listed[file.name], **seal},
    )


def _certified_duration(path: Path, document: dict[str, Any]) -> float:
    """Read the duration [s] of a certified result."""
    certificate = document.get("certificate")
    if not isinstance(certificate, dict):
        raise InputFileError(path, "certificate", "the solve found no motion to export.")
    try:
        worst = float(certificate["worst_violation"]["value"])
        limit = str(certificate["worst_violation"]["limit"])
        duration = float(document["duration"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputFileError(path, "certificate", f"has no usable {error}.") from error
    if not worst <= CERTIFICATE_TOLERANCE:
        raise InputFileError(
            path,
            "certificate",
            f"the motion exceeds {limit.replace('_', ' ')} by {format_relative(worst)}, so it is "
            "not exported. Solve again until every limit holds.",
        )
    return duration


def check_rate(rate: float, most: float, owner: str) -> None:
    """Raise `InputError` unless 0 < rate <= most [Hz]."""
    if not (math.isfinite(rate) and 0.0 < rate <= most):
        raise InputError(f"--rate {rate:g} Hz: {owner} takes above 0 and up to {most:g} Hz.")
