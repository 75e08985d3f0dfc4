"""Report on a recording set: runs, channels, faults, missing signals, assumptions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from stiffopt.files import to_json_types
from stiffopt.recording.channel import noise_level, resolution
from stiffopt.recording.clock import MIN_GAP_STEPS
from stiffopt.recording.joint_facts import JointFacts, joint_facts
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import Fault, RecordedRun, Role
from stiffopt.recording.signals import Kind
from stiffopt.units import joint_unit


@dataclass(frozen=True, kw_only=True)
class ChannelCheck:
    """One channel of one run."""

    signal: Kind
    joint: int  # from 1
    column: str
    there: bool  # False if it was removed as faulty
    unit: str
    lowest: float
    highest: float
    # Share of the joint's range (position), or of its largest velocity or torque; None without such
    # a limit.
    used: float | None
    # Standard deviation, estimated from third differences, and as the set gives it.
    noise: float
    stated_noise: float | None
    # One count, found in the values, and as the set gives it.
    step: float | None
    stated_step: float | None


@dataclass(frozen=True, kw_only=True)
class RunCheck:
    """One run: its clock, channels and faults."""

    name: str
    file: str
    role: Role
    samples: int  # kept
    duration: float  # [s]
    rate: float  # [Hz]
    jitter: float  # standard deviation of the spacing without gaps [s]
    longest_gap: float  # longest spacing [s]
    usable: bool  # every joint has a position
    channels: tuple[ChannelCheck, ...]
    faults: tuple[Fault, ...]
    at_rest: bool = False  # samples are poses at rest; duration and rate then count poses


@dataclass(frozen=True, kw_only=True)
class RecordingReport:
    """Content of a recording set and its missing signals."""

    name: str
    title: str
    joints: tuple[str, ...]  # (n,)
    runs: tuple[RunCheck, ...]
    # (n,) equations that each joint's signals allow: "motor", "link" and "deflection" with a link
    # encoder, "torque" without.
    balances: tuple[tuple[str, ...], ...]
    facts: tuple[JointFacts, ...]  # (n,) excitation of each joint in the runs that a fit may use
    missing: tuple[str, ...]  # sentences
    assumptions: tuple[str, ...]  # assumptions in place of entries that the set does not give

    def as_dict(self) -> dict[str, Any]:
        """Return JSON data; numbers that are not finite become None."""
        found: dict[str, Any] = to_json_types(asdict(self))
        del found["facts"]
        return found

    @property
    def training_runs(self) -> int:
        """Number of runs that a fit may use: those of the role "train", else all."""
        return sum(run.role == "train" for run in self.runs) or len(self.runs)


def check_recordings(recordings: RecordingSet) -> RecordingReport:
    """Open every run of a set and report on its content.

    Raises `InputFileError`: a run that cannot be read.
    """
    runs = [recordings.open(entry) for entry in recordings.runs]
    training = [run for run in runs if run.role == "train"] or runs
    facts = joint_facts(recordings, training)
    return RecordingReport(
        name=recordings.name,
        title=recordings.title,
        joints=recordings.joints,
        runs=tuple(_check_run(recordings, run) for run in runs),
        balances=tuple(one.balances for one in facts),
        facts=facts,
        missing=missing_signals(recordings, runs),
        assumptions=recordings.assumptions,
    )


def _check_run(recordings: RecordingSet, run: RecordedRun) -> RunCheck:
    spacing = np.diff(run.time)
    ordinary = spacing[spacing <= MIN_GAP_STEPS * run.step]
    channels = []
    for kind, j, column in recordings.signals.columns():
        array: np.ndarray | None = getattr(run, kind)
        values = np.full(len(run.time), np.nan) if array is None else array[:, j]
        channels.append(_check_channel(recordings, kind, j, column, values))
    return RunCheck(
        name=run.name,
        file=run.file,
        role=run.role,
        samples=len(run.time),
        duration=run.duration,
        rate=1.0 / run.step,
        jitter=float(ordinary.std()),
        longest_gap=float(spacing.max()),
        usable=run.usable,
        channels=tuple(channels),
        faults=run.faults,
        at_rest=run.at_rest,
    )


def _check_channel(
    recordings: RecordingSet, kind: Kind, j: int, column: str, values: np.ndarray
) -> ChannelCheck:
    there = bool(np.isfinite(values).any())
    low, high = (float(np.nanmin(values)), float(np.nanmax(values))) if there else (np.nan, np.nan)
    noise = recordings.noise
    return ChannelCheck(
        signal=kind,
        joint=j + 1,
        column=column,
        there=there,
        unit=joint_unit(
            {"velocity": "rad/s", "torque": "N m"}.get(kind, "rad"), bool(recordings.prismatic[j])
        ),
        lowest=low,
        highest=high,
        used=_used_share(recordings, kind, j, low, high),
        noise=noise_level(values),
        stated_noise=_stated_value(noise, kind, j),
        step=resolution(values),
        stated_step=_stated_value(noise, f"{kind}_resolution", j),
    )


def _stated_value(noise: object, key: str, j: int) -> float | None:
    values = getattr(noise, key, None)  # not every signal has both
    return None if values is None else float(values[j])


def _used_share(
    recordings: RecordingSet, kind: Kind, j: int, low: float, high: float
) -> float | None:
    robot, row, largest = recordings.robot, recordings.order[j], max(abs(low), abs(high))
    if kind == "velocity":
        limit = float(robot.velocity_max[row])
    elif kind == "torque":
        limit = float(robot.torque_max[row])
    else:
        limit, largest = float(robot.position_upper[row] - robot.position_lower[row]), high - low
    if not math.isfinite(limit) or limit <= 0.0 or not math.isfinite(largest):
        return None
    return largest / limit


def missing_signals(recordings: RecordingSet, runs: Sequence[RecordedRun]) -> tuple[str, ...]:
    """Sentences on missing signals and roles, each with its consequence."""
    found = []
    for role, loss in (
        ("train", "nothing can be fitted"),
        ("test", "no fit can be judged"),
    ):
        if not any(run.role == role for run in runs):
            found.append(f"No run has the role {role}: {loss}.")
    if 0 < sum(run.role == "train" for run in runs) < 3:
        found.append(
            "Fewer than three training runs: explanations are compared on blocks of a run "
            "instead of on whole runs."
        )
    signals, nothing = recordings.signals, ("",) * recordings.n
    for kind, names, loss in (
        (
            "command" if signals.commanded else "torque",
            (signals.command if signals.commanded else None) or signals.torque,
            "their torque equation cannot be evaluated",
        ),
        (
            "link_position",
            signals.link_position or nothing,
            "elastic effects show only through the torque, hardly at all",
        ),
    ):
        lacking = [str(j + 1) for j, name in enumerate(names) if not name]
        if lacking:
            found.append(f"No {kind} of joints {', '.join(lacking)}: {loss}.")
    if recordings.signals.velocity is None:
        found.append("No velocity: it is the derivative of the position.")
    found += [
        f"{run.file} cannot be used: a joint has no position that can be trusted."
        for run in runs
        if not run.usable
    ]
    return tuple(found)
