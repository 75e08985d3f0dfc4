"""From the raw columns of a run file to a run without what cannot be true."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from stiffopt.recording.channel import noise_level, resolution
from stiffopt.recording.channel_faults import JointChannels, check_joint, travel
from stiffopt.recording.clock import Clock, read_clock
from stiffopt.recording.run import Fault, RecordedRun, Role, counted
from stiffopt.recording.signals import KINDS, Signals


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
    copies = same & moving
    copies[0] = False
    if not copies.any():
        return rows, []
    rows_said = counted(int(copies.sum()), "row")
    text = f"the motion of the row before is repeated in {rows_said}, left out."
    fault = Fault(
        signal="time",
        joint=None,
        kind="duplicate",
        detail=text,
        left_out=False,
        share=float(copies.mean()),
    )
    return rows[~copies], [fault]
