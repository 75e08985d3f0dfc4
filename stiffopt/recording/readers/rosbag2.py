"""Runs of rosbag2: a folder with metadata.yaml and the storage, SQLite or MCAP."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag2 import ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_typestore

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.messages import Message, gather, wanted_topics
from stiffopt.recording.signals import Signals


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Columns of a rosbag2, given by its folder or by the storage file in it."""
    folder = path if path.is_dir() else path.parent
    if not (folder / "metadata.yaml").is_file():
        raise InputFileError(
            path, "", "a rosbag2 needs its metadata.yaml beside it. Give the folder of the bag, or "
            "make the file anew with: ros2 bag reindex"
        )  # fmt: skip
    # Bags written before Jazzy do not hold the definitions of their messages.
    store = get_typestore(Stores.LATEST)
    try:
        with AnyReader([folder], default_typestore=store) as reader:
            topics = sorted(reader.topics)
            wanted = wanted_topics(signals, topics, path)
            chosen = [one for one in reader.connections if one.topic in wanted]
            return gather(path, signals, topics, _messages(reader, chosen))
    except (AnyReaderError, ReaderError, SerdeError, TypesysError, KeyError) as error:
        reason = str(error) or type(error).__name__
        raise InputFileError(path, "", f"cannot be read as a rosbag2: {reason}.") from error


def _messages(reader: AnyReader, connections: list[Connection]) -> Iterator[Message]:
    for connection, log_time, raw in reader.messages(connections=connections):
        yield connection.topic, log_time, reader.deserialize(raw, connection.msgtype)
