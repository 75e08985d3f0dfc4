"""Text of `ros2 topic echo` and `rostopic echo`: messages as YAML between lines of dashes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from stiffopt.recording.readers.columns import Table, columns_of_records
from stiffopt.recording.readers.joint_trajectory import (
    columns_of_trajectory,
    find_joint_trajectory,
)

_MESSAGE_SEPARATOR = "---"
_ARRAY_PATTERN = re.compile(r"(?:array\('\w', *)?\[(.*)\]\)?$")
_MAPPING_PATTERN = re.compile(r"\{([^{}\[\]]*)\}$")
_TRAJECTORY_FIELDS = ("joint_names", "points")
_FIELD_PATTERN = re.compile(r"^\s*(- )?[A-Za-z_]\w*:(\s|$)")


def is_topic_echo(text: str) -> bool:
    """Return True if text begins with fields of a message and has separators of messages."""
    head = [line for line in text[:4096].splitlines() if line.strip()]
    fields = [line for line in head[:6] if line != _MESSAGE_SEPARATOR]
    return (
        bool(fields)
        and _FIELD_PATTERN.match(fields[0]) is not None
        and f"\n{_MESSAGE_SEPARATOR}" in text
        and "," not in fields[0].partition(":")[0]
    )


def is_joint_trajectory(text: str) -> bool:
    """Return True for text with the fields of a joint trajectory in lines of their own."""
    return all(re.search(rf"^\s*{field}:", text, re.MULTILINE) for field in _TRAJECTORY_FIELDS)


def read_text_table(text: str, path: Path) -> Table:
    """Return the columns of the messages, such as "position[elbow]"."""
    if is_joint_trajectory(text):
        planned = find_joint_trajectory(next(_iterate_messages(text), None))
        if planned is not None:
            return columns_of_trajectory(planned, path)
    return columns_of_records(_iterate_messages(text), path)


def _iterate_messages(text: str) -> Iterator[Any]:
    lines: list[tuple[int, str]] = []
    complete = False
    for line in text.splitlines():
        if line.rstrip() == _MESSAGE_SEPARATOR:
            if lines:
                yield _parse_block(lines, 0, lines[0][0])[0]
            lines, complete = [], True
        elif line.strip() and not line.lstrip().startswith("#"):
            body = line.lstrip(" ")
            if lines and _is_open(lines[-1][1]):
                # A list over several lines.
                lines[-1] = lines[-1][0], f"{lines[-1][1]} {body.rstrip()}"
            else:
                lines.append((len(line) - len(body), body.rstrip()))
    if lines and not complete:
        yield _parse_block(lines, 0, lines[0][0])[0]
    # Whatever follows the last separator may have been cut off.


def _is_open(body: str) -> bool:
    """Return True for a line whose list or mapping goes on in the next one."""
    begun = max(body.rfind("["), body.rfind("{"))
    return begun > max(body.rfind("]"), body.rfind("}"))


def _parse_block(lines: Sequence[tuple[int, str]], at: int, indent: int) -> tuple[Any, int]:
    """Return the content of the lines of one indentation, and the place after them.

    Only what such tools print: fields, lists of scalars, lists in one line.
    """
    if lines[at][1].startswith("-"):
        entries: list[Any] = []
        while at < len(lines) and lines[at][0] == indent and lines[at][1].startswith("-"):
            body = lines[at][1][1:].strip()
            if _FIELD_PATTERN.match(body):
                inner = [(indent + 2, body), *_following_deeper(lines, at + 1, indent)]
                entries.append(_parse_block(inner, 0, indent + 2)[0])
                at += len(inner)
            else:
                entries.append(_parse_scalar(body))
                at += 1
        return entries, at
    found: dict[str, Any] = {}
    while at < len(lines) and lines[at][0] == indent and ":" in lines[at][1]:
        key, _, body = lines[at][1].partition(":")
        at += 1
        deeper = at < len(lines) and (
            lines[at][0] > indent or (lines[at][0] == indent and lines[at][1].startswith("- "))
        )
        if not body.strip() and deeper:
            found[key], at = _parse_block(lines, at, lines[at][0])
        else:
            found[key] = _parse_scalar(body.strip())
    if at < len(lines) and lines[at][0] >= indent:
        # Text over several lines, or no YAML at all.
        at += 1
    return found, at


def _following_deeper(
    lines: Sequence[tuple[int, str]], at: int, indent: int
) -> list[tuple[int, str]]:
    found = []
    while at < len(lines) and lines[at][0] > indent:
        found.append(lines[at])
        at += 1
    return found


def _parse_scalar(text: str) -> Any:
    listed = _ARRAY_PATTERN.match(text)
    if listed is not None:
        return [_parse_scalar(each.strip()) for each in listed[1].split(",") if each.strip()]
    mapped = _MAPPING_PATTERN.match(text)
    if mapped is not None:
        pairs = (each.partition(":") for each in mapped[1].split(",") if ":" in each)
        return {key.strip(): _parse_scalar(value.strip()) for key, _, value in pairs}
    bare = text.strip("'\"")
    try:
        return float(bare.lstrip(".")) if bare in (".nan", ".inf") else float(bare)
    except ValueError:
        return bare
