"""Tables of the joint topic of MCAP files and rosbag2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.read import first_messages, read_columns
from stiffopt.recording.signals import Signals

# Number of messages searched for topics.
_MAX_PROBED_MESSAGES = 2000
_NAME_FIELDS = ("name", "names", "joint_names")
_VALUE_FIELDS = ("position", "velocity", "effort", "torque", "current", "positions", "velocities",
          "efforts", "accelerations", "q", "qd", "tau")  # fmt: skip
# Parts of controller messages with such lists, measured before commanded.
_MESSAGE_PARTS = ("", "actual", "feedback", "measured", "state")
STAMP_COLUMN = "stamp"


def read_message_table(path: Path, joints: Sequence[str]) -> dict[str, np.ndarray]:
    """Read the columns of the joint topic, under names such as "/js.position[elbow]".

    The stamps [s] are under `TIME`.

    Raises
    ------
    InputFileError
        No topic has a number for each joint; lists the topics found.
    """
    found: dict[str, list[str]] = {}
    for topic, _, message in first_messages(path, _MAX_PROBED_MESSAGES):
        # A gripper may publish on the topic of the arm.
        if not found.get(topic):
            found[topic] = _joint_fields(topic, message, joints)
    best = max(found, key=lambda topic: len(found[topic]), default="")
    if not found.get(best):
        raise InputFileError(
            path,
            "",
            f"no topic among {', '.join(sorted(found)[:20]) or 'none'} has lists of numbers for"
            f" the joints {', '.join(joints)}. Name its fields in [signals] of recordings.toml by"
            " hand.",
        )
    fields = found[best]
    signals = Signals(
        time=STAMP_COLUMN, position=tuple(fields), velocity=None, link_position=None, torque=()
    )
    return dict(read_columns(path, signals))


def _joint_fields(topic: str, message: Any, joints: Sequence[str]) -> list[str]:
    """Return the names of message fields with a number for each joint."""
    stated: Any = next(
        (n for key in _NAME_FIELDS if (n := _get_field(message, key)) is not None), ()
    )
    # A field called "name" need not list joints.
    listed = isinstance(stated, Sequence) and not isinstance(stated, str)
    names = list(stated) if listed and all(isinstance(n, str) for n in stated) else []
    named = set(joints) <= set(names)
    found: list[str] = []
    for part in _MESSAGE_PARTS:
        holder = _get_field(message, part) if part else message
        for key in _VALUE_FIELDS:
            values = _get_field(holder, key)
            if not isinstance(values, Sequence | np.ndarray) or isinstance(values, str):
                continue
            place = f"{topic}.{part}.{key}" if part else f"{topic}.{key}"
            if named and not part and len(values) == len(names):
                found += [f"{place}[{joint}]" for joint in joints]
            elif len(values) == len(joints) and not names:
                found += [f"{place}[{j}]" for j in range(len(joints))]
            elif named and len(values) == len(names):
                found += [f"{place}[{names.index(joint)}]" for joint in joints]
    return found


def _get_field(value: Any, key: str) -> Any:
    return value.get(key) if isinstance(value, Mapping) else getattr(value, key, None)
