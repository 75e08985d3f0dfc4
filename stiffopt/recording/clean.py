"""From the raw columns of a run file to a run without what cannot be true."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from stiffopt.recording.bad_samples import stretches
from stiffopt.recording.channel import noise_level, resolution
from stiffopt.recording.channel_faults import JointChannels, check_joint, travel
from stiffopt.recording.clock import Clock, read_clock
from stiffopt.recording.run import Fault, RecordedRun, Role, counted
from stiffopt.recording.signals import KINDS, Signals

# Steps behind lost data, in those of the rows that follow; how many of these are looked at.
_LEAP, _AFTER = 3.0, 3
# A step of no more counts is none.
_COUNTS = 4.0


def clean(
    columns: Mapping[str, np.ndarray],
    signals: Signals,
    *,
    path: Path,
    name: str,
    file: str,
    role: Role,
    session_time: float | None = None,
    temperature: np.ndarray | None = None,
    prismatic: np.ndarray | None = None,
) -> RecordedRun:
    """Check the clock and every channel; name the faults and take them out.

    Parameters
    ----------
    columns : mapping of column name to array (R,)
    signals : Signals
    path : Path
        Of the file, for messages.
    name, file, role, session_time, temperature
        As in `RecordedRun`.
    prismatic : array (n,) of bool, optional

    Raises
    ------
    InputFileError
        A clock that cannot be used.
    """
    n = len(signals.position)
    clock = read_clock(columns[signals.time], path, signals.time)
    rows, stale = _without_copies(columns, signals, clock)
    time = clock.stamps[rows]
    faults = [*clock.faults, *stale]
    arrays = {
        kind: None if signals.of(kind) is None else np.full((len(rows), n), np.nan)
        for kind in KINDS
    }
    for j in range(n):
        channels = {
            kind: columns[column][rows].copy() for kind, k, column in signals.columns() if k == j
        }
        joint = JointChannels(
            joint=j,
            time=time,
            channels=channels,
            prismatic=bool(prismatic is not None and prismatic[j]),
        )
        faults += check_joint(joint)
        for kind, values in channels.items():
            array = arrays[kind]
            if array is not None:
                array[:, j] = values
    position, torque = arrays["position"], arrays["torque"]
    assert position is not None
    assert torque is not None
    return RecordedRun(
        name=name,
        file=file,
        role=role,
        session_time=session_time,
        temperature=temperature,
        stamps=clock.stamps,
        time=time,
        position=position,
        velocity=_any(arrays["velocity"]),
        link_position=_any(arrays["link_position"]),
        torque=torque,
        faults=tuple(faults),
    )


def _any(array: np.ndarray | None) -> np.ndarray | None:
    return array if array is not None and np.isfinite(array).any() else None


def _without_copies(
    columns: Mapping[str, np.ndarray], signals: Signals, clock: Clock
) -> tuple[np.ndarray, list[Fault]]:
    """Rows without those that repeat the motion of the row before under a new stamp.

    Only where the arm moves by more than four counts a sample; at rest, equal rows are nothing
    strange. Torque is not asked, so that the motion of a run does not depend on it.
    """
    rows = clock.rows
    same = np.ones(len(rows), dtype=bool)
    moving = np.zeros(len(rows), dtype=bool)
    for kind, _, column in signals.columns():
        values = columns[column][rows]
        if kind == "torque" or travel(values) == 0.0:
            continue
        same[1:] &= np.diff(values) == 0.0
        if kind == "position":
            count = max(resolution(values) or 1e-9 * travel(values), 3.0 * noise_level(values))
            around = np.abs(values[4:] - values[:-4]) / 4.0
            moving[2:-2] |= around > 4.0 * count
    positions = np.column_stack(
        [columns[c][rows] for k, _, c in signals.columns() if k == "position"]
    )
    every = np.column_stack([columns[column][rows] for _, _, column in signals.columns()])
    empty = _resuming(positions, np.all(every == 0.0, axis=1))
    copies = ((same & moving) | _resuming(positions, same)) & ~empty
    copies[0] = False
    faults = [
        Fault(
            signal="time",
            joint=None,
            kind="duplicate",
            detail=f"{what} {counted(int(marked.sum()), 'row')}, left out.",
            left_out=False,
            share=float(marked.mean()),
        )
        for what, marked in (
            ("the motion of the row before is repeated in", copies),
            ("all channels read 0, as where nothing was received, in", empty),
        )
        if marked.any()
    ]
    return rows[~copies & ~empty], faults


def _resuming(positions: np.ndarray, marked: np.ndarray) -> np.ndarray:
    """Rows of those stretches (K,) behind which the positions (K, n) go on elsewhere.

    An arm that rests goes on from where it rested: its first step is about as long as the next.
    One whose data were lost is, in one step, where it would have been.
    """
    found = np.zeros(len(marked), dtype=bool)
    steps = np.abs(np.diff(positions, axis=0))
    count = np.array([resolution(values) or 0.0 for values in positions.T])
    for begin, end in stretches(marked):
        if begin == 0 or end + _AFTER >= len(marked):
            continue
        usual = np.nanmax(steps[end : end + _AFTER], axis=0)
        if np.any(steps[end - 1] > _LEAP * usual + _COUNTS * count):
            found[begin:end] = True
    return found
