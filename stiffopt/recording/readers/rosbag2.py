"""Runs of rosbag2: a folder with metadata.yaml and the storage, SQLite or MCAP."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.checks import check_bytes
from stiffopt.recording.readers.messages import Message, gather_columns, wanted_topics
from stiffopt.recording.signals import Signals


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Read columns of a rosbag2, given by its folder or its storage file."""
    with _open_bag(path) as reader:
        topics = sorted(reader.topics)
        wanted = wanted_topics(signals, topics, path)
        chosen = [one for one in reader.connections if one.topic in wanted]
        return gather_columns(path, signals, topics, _iterate_messages(reader, chosen))


def peek(path: Path) -> Iterator[Message]:
    """Iterate over messages of known definitions of all topics, in the order of the log."""
    with _open_bag(path) as reader:
        known = [c for c in reader.connections if c.msgtype in reader.typestore.types]
        yield from _iterate_messages(reader, known)


@contextmanager
def _open_bag(path: Path) -> Iterator[AnyReader]:
    folder = path if path.is_dir() else path.parent
    description = folder / "metadata.yaml"
    if not description.is_file():
        raise InputFileError(
            path, "", "a rosbag2 needs its metadata.yaml beside it. Give the folder of the bag, or "
            "make the file again with: ros2 bag reindex"
        )  # fmt: skip
    # YAML is slow to read [bytes].
    if description.stat().st_size > 2**20:
        raise InputFileError(description, "", "is too large to describe a bag.")
    # Bags written before Jazzy do not hold the definitions of their messages.
    store = get_typestore(Stores.LATEST)
    for file in folder.iterdir():
        check_bytes(file, file.stat().st_size if file.is_file() else 0)
    with AnyReader([folder], default_typestore=store) as reader:
        yield reader


def _iterate_messages(reader: AnyReader, connections: list[Connection]) -> Iterator[Message]:
    for connection, log_time, raw in reader.messages(connections=connections):
        yield connection.topic, log_time, reader.deserialize(raw, connection.msgtype)
