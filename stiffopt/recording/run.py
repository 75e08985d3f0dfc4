"""Recorded run, the faults found in it, and torques from its commanded positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiffopt.actuator.law import ActuatorLaw, mean_command
from stiffopt.recording.signals import Kind

Role = Literal["train", "test", "extrapolate"]
Interval = tuple[float, float]  # begin and end, times of a run [s]
FaultKind = Literal[
    "constant",
    "saturated",
    "gap",
    "jitter",
    "duplicate",
    "dropped",
    "outlier",
    "quantised",
    "not finite",
    "contradicts position",
    "wrapped",
]


def counted(number: int, noun: str) -> str:
    """Format a number with a noun: "1 sample", "3 samples"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Fault of one signal of a run."""

    signal: Kind | Literal["time"]  # "time" or the kind of channel
    joint: int | None  # from 1; None for all joints
    kind: FaultKind
    detail: str  # one sentence with the numbers
    left_out: bool  # the whole channel was replaced by NaN
    share: float  # share of the samples that have the fault, 0 to 1
    # Motion by a second sensor over that of the position, where both correlate but differ; NaN
    # where the run is too short.
    ratio: float | None = None

    @property
    def channel(self) -> str:
        """Short name such as "torque of joint 3"."""
        return self.signal if self.joint is None else f"{self.signal} of joint {self.joint}"

    def __str__(self) -> str:
        return f"{self.channel}: {self.detail}"


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRun:
    """Recording of one motion after removal of faulty samples.

    A column of NaN is a signal that this joint lacks, or one removed as faulty; a single NaN is a
    removed sample; see `faults`. A prismatic joint has metres for radians and newtons for newton
    metres.
    """

    name: str  # file name without ending
    file: str  # path of the file in the set
    # "train", "test" (never used to fit) or "extrapolate" (a test outside the training range).
    role: Role
    session_time: float | None  # time since the robot was switched on [s]
    number: int  # place in the set, from 0
    # (n,) temperature of the housings at the start of the run [degC].
    temperature: np.ndarray | None
    stamps: np.ndarray  # (R,) instant of every row of the file [s]; predictions use these
    time: np.ndarray  # (K,) stamps of the usable samples, strictly increasing [s]
    position: np.ndarray  # (K, n) motor encoder through the ratio [rad]
    # (K, n) [rad/s], [rad]; None if no joint has that signal.
    velocity: np.ndarray | None
    link_position: np.ndarray | None
    torque: np.ndarray  # (K, n) drive torque at the output side [N m]
    faults: tuple[Fault, ...]
    at_rest: bool = False  # each sample is a pose at rest, and time its number
    # (R,) stamps of the file [s]; None where they are the instants.
    recorded_stamps: np.ndarray | None = None
    # (K, n) commanded position, held until the next [rad]; None if no joint has one.
    command: np.ndarray | None = None
    # Intervals in which the arm carries a part that it does not carry at other times.
    carried: tuple[Interval, ...] = ()

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.position.shape[1])

    @property
    def step(self) -> float:
        """Usual spacing of the samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def usable(self) -> bool:
        """Return whether every joint has a position, which every prediction needs."""
        return bool(np.isfinite(self.position).any(axis=0).all())


def derive_torque(
    run: RecordedRun, law: ActuatorLaw | None, weight: Callable[[np.ndarray], np.ndarray]
) -> RecordedRun:
    """Return a run with the torques of an actuator's law in place of missing ones.

    Unknown gains (and a joint without commands) leave a torque missing. While the delay is not
    known, none is assumed. `weight`: positions (K, n) to the torques that hold them. An integral
    part begins at an unknown value, so that mean torques of a run are those of the weight.
    """
    if law is None or run.command is None:
        return run
    delay = law.delay if np.isfinite(law.delay) else 0.0
    error = delayed_command(run, delay) - run.position
    if law.integral.any():
        whole = law.integral * np.nancumsum(error, axis=0) * run.step
        mean = np.nanmean(weight(run.position), axis=0) / law.stiffness
        begun = mean - np.nanmean(error + whole, axis=0)
        error = error + np.where(law.integral > 0.0, whole + begun, 0.0)
    return replace(run, torque=np.asarray(law.torque(error, encoder_velocity(run))))


def delayed_command(run: RecordedRun, delay: float) -> np.ndarray:
    """Return the commands (K, n) that act at each sample, as means over one step [rad]."""
    assert run.command is not None
    half = 0.5 * run.step
    command = np.empty_like(run.command)
    for j, own in enumerate(run.command.T):
        known = np.isfinite(own)
        if not known.any():
            command[:, j] = np.nan
            continue
        times, held = run.time[known], own[known, None]
        begin, end = run.time - delay - half, run.time - delay + half
        command[:, j] = mean_command(times, held, begin, end)[0][:, 0]
    return command


def encoder_velocity(run: RecordedRun) -> np.ndarray:
    """Return the slope (K, n) of the encoders, one-sided at the ends [rad/s]."""
    # Half the window over which the slope of the encoder is the velocity that damps [s].
    width = max(1, round(0.01 / run.step))
    rows = np.arange(len(run.time))
    before, after = np.maximum(rows - width, 0), np.minimum(rows + width, len(rows) - 1)
    span = (run.time[after] - run.time[before])[:, None]
    return np.asarray((run.position[after] - run.position[before]) / span)


def command_interval(run: RecordedRun, joints: np.ndarray | slice = slice(None)) -> float:
    """Return the median time between changes of the commands of some joints [s]; nan without."""
    assert run.command is not None
    command = run.command[:, joints]
    known = np.isfinite(command).all(axis=1)  # a log may hold commands in the rows of new ones
    moved = np.diff(command[known], axis=0) != 0.0
    times = run.time[known][1:][moved.any(axis=1)]
    return float(np.median(np.diff(times))) if len(times) > 2 else float("nan")
