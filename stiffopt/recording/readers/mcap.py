"""Run files of MCAP: ROS 2 messages (CDR) and JSON messages."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.decoder import DecoderFactory
from mcap.reader import McapReader, SeekingReader
from mcap.records import Channel, Schema
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.checks import MAX_BYTES, check_bytes
from stiffopt.recording.readers.messages import Message, gather_columns, wanted_topics
from stiffopt.recording.signals import Signals


class _JsonDecoderFactory(DecoderFactory):
    """Decoder of JSON messages."""

    def decoder_for(
        self, message_encoding: str, schema: Schema | None
    ) -> Callable[[bytes], Any] | None:
        return json.loads if message_encoding == "json" else None


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Read columns of an MCAP file."""
    with path.open("rb") as stream:
        reader = _open_reader(stream)
        channels = _list_channels(path, reader)
        topics = [channel.topic for channel in channels]
        wanted = wanted_topics(signals, topics, path)
        _check_encodings(path, [channel for channel in channels if channel.topic in wanted])
        return gather_columns(path, signals, topics, _iterate_messages(reader, wanted))


def _open_reader(stream: IO[bytes]) -> McapReader:
    factories = [Ros2DecoderFactory(), _JsonDecoderFactory()]
    return SeekingReader(stream, decoder_factories=factories, record_size_limit=MAX_BYTES)


def _list_channels(path: Path, reader: McapReader) -> list[Channel]:
    summary = reader.get_summary()
    if summary is not None:
        check_bytes(path, sum(chunk.uncompressed_size for chunk in summary.chunk_indexes))
        if summary.channels:
            return list(summary.channels.values())
    # A truncated file has no summary.
    found = {channel.id: channel for _, channel, _ in reader.iter_messages()}
    return list(found.values())


def _check_encodings(path: Path, channels: list[Channel]) -> None:
    for channel in channels:
        if channel.message_encoding not in ("cdr", "json"):
            raise InputFileError(
                path,
                channel.topic,
                f"its messages are encoded as {channel.message_encoding!r}; allowed are cdr "
                "(ROS 2) and json. Convert the file, to CSV or Parquet for example.",
            )


def _iterate_messages(reader: McapReader, topics: set[str]) -> Iterator[Message]:
    for _, channel, message, decoded in reader.iter_decoded_messages(topics=topics):
        yield channel.topic, message.log_time, decoded


def peek(path: Path) -> Iterator[Message]:
    """Iterate over the decodable messages of all topics in the order of the log."""
    with path.open("rb") as stream:
        reader = _open_reader(stream)
        known = [
            c.topic for c in _list_channels(path, reader) if c.message_encoding in ("cdr", "json")
        ]
        yield from _iterate_messages(reader, set(known))
