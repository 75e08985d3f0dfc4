"""Position errors that are recorded as torques: another column of the files less the position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stiffopt.actuator.position_servo import PositionServo
from stiffopt.errors import InputError
from stiffopt.recording.readers.read import is_messages, read_tables
from stiffopt.recording.recorded_arm import path_inside_set
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.state_pair import StatePair

# Residual of an error against command less position, over its size: rounding of a log.
_MAX_RESIDUAL = 1e-3


def take_errors_as_commands(recordings: RecordingSet) -> tuple[RecordingSet, tuple[str, ...]]:
    """Return a set whose torques are position errors as one with commands, and a note of it.

    A servo's error times a factor is torque only without delay and damping. Where every torque
    column is a multiple of another column less the position, that one is the command; the stated
    scale of the torque is then the gain. Other sets are returned unchanged, without a note.
    """
    signals = recordings.signals
    entries = recordings.with_role("train")
    if isinstance(recordings, StatePair) or signals.command is not None or not entries:
        return recordings, ()
    path = path_inside_set(recordings.path, "runs", entries[0].file)
    if not all(signals.torque) or not path.is_file() or is_messages(path):
        return recordings, ()
    try:
        tables = list(read_tables(path).values())
    except InputError:
        return recordings, ()  # whoever opens the run says why
    if len(tables) != 1:
        return recordings, ()
    found = [
        _find_command(tables[0], torque, position)
        for torque, position in zip(signals.torque, signals.position, strict=True)
    ]
    if not all(each is not None for each in found):
        return recordings, ()
    commands, factors = zip(*(each for each in found if each is not None), strict=True)
    scale = {kind: value for kind, value in signals.scale.items() if kind != "torque"}
    if "position" in scale:
        scale["command"] = scale["position"]
    n, kp = recordings.n, None
    if "torque" in signals.scale:
        gain = signals.scale_of("torque", n) * factors / signals.scale_of("position", n)
        kp = tuple(float(each) for each in gain) if (gain > 0.0).all() else None
    law = PositionServo(kind="position_servo", kp=kp).law(
        recordings.robot.torque_max[recordings.order]
    )
    own = replace(signals, torque=("",) * n, command=commands, scale=scale)
    pairs = ", ".join(
        f"{torque} is {command} less {position}"
        for torque, command, position in zip(
            signals.torque, commands, signals.position, strict=True
        )
    )
    note = (
        f"What is stated as torque is a position error ({pairs}): commands and positions are"
        " diagnosed in its place" + (", with the stated scale as gain." if kp else ".")
    )
    return replace(recordings, signals=own, actuator=law), (note,)


def _find_command(
    table: Mapping[str, np.ndarray], torque: str, position: str
) -> tuple[str, float] | None:
    """Return the column that a position error is against, and the error per difference."""
    if torque not in table or position not in table:
        return None
    error, place = table[torque], table[position]
    for name, values in table.items():
        if name in (torque, position) or values.dtype.kind != "f":
            continue
        known = np.isfinite(values) & np.isfinite(error) & np.isfinite(place)
        away = (values - place)[known]
        own = error[known]
        if not away.any() or not np.std(own) > 0.0:
            continue
        factor = float(own @ away) / float(away @ away)
        if float(np.std(own - factor * away)) <= _MAX_RESIDUAL * float(np.std(own)):
            return name, factor
    return None
