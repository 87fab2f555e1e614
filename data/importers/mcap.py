"""MCAP files (https://mcap.dev) with messages of ROS 2 or in JSON.

Every topic of joint states, poses, points or transforms is a recording, in metres,
radians and seconds (REP 103).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import pandas as pd

from stringcast.data.errors import ExpectedError
from stringcast.data.file_checks import MAX_COLUMNS, MAX_TABLE_BYTES, require_plain_file
from stringcast.data.importers import SourceRecording
from stringcast.data.lazy_module import LazyModule
from stringcast.data.schema import DataError

mcap_reader = LazyModule("mcap.reader")
mcap_decoder = LazyModule("mcap_ros2.decoder")

MESSAGE_TYPES = (
    "JointState",
    "Pose",
    "PoseStamped",
    "PointStamped",
    "Point",
    "TransformStamped",
    "Transform",
)
MAX_MESSAGES = 2**20  # of the topics read: an hour at 300 a second
MAX_DEPTH = 6  # levels of nested messages
NANOSECOND_S = 1e-9  # [s] in a nanosecond
# field names omitted from column names
TRANSPARENT = ("pose", "position", "point", "transform", "translation")


def recognises(path: Path) -> bool:
    """Return whether a file has the suffix of MCAP."""
    return path.suffix.lower() == ".mcap"


def read(path: Path) -> list[SourceRecording]:
    """Read one recording for each topic that contains positions.

    Raises DataError if the file is damaged.
    """
    rows: dict[str, list[dict[str, float]]] = {}
    try:
        with require_plain_file(path).open("rb") as file:
            for topic, row in _read_messages(file, path):
                rows.setdefault(topic, []).append(row)
    except ExpectedError:
        raise
    except Exception as error:  # a damaged file raises any kind
        reason = str(error) or type(error).__name__
        raise DataError(
            path,
            f"cannot be read as MCAP ({reason})",
            "Try `mcap recover`, or record it again.",
        ) from error
    return [
        SourceRecording(path, pd.DataFrame(table), path.stem) for table in rows.values()
    ]


def _read_messages(file: Any, path: Path) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield the topic and the numbers of each message, in the order of time."""
    decoders = [mcap_decoder.DecoderFactory()]
    reader = mcap_reader.SeekingReader(
        file, decoder_factories=decoders, record_size_limit=MAX_TABLE_BYTES
    )
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise ValueError("its index is missing")
    channels = _position_channels(summary, path)
    counts = summary.statistics.channel_message_counts
    count = sum(counts.get(channel.id, 0) for channel in channels)
    is_huge = any(
        chunk.uncompressed_size > MAX_TABLE_BYTES for chunk in summary.chunk_indexes
    )
    if count > MAX_MESSAGES or is_huge:
        raise DataError(
            path,
            f"it has {count} messages, at most {MAX_MESSAGES} are read",
            "Cut it: mcap filter.",
        )
    topics = [channel.topic for channel in channels]
    if all(channel.message_encoding == "json" for channel in channels):
        for _, channel, message in reader.iter_messages(topics=topics):
            content = json.loads(message.data)
            yield channel.topic, _message_row(channel.topic, content, message.log_time)
        return
    for decoded in reader.iter_decoded_messages(topics=topics):
        topic = decoded.channel.topic
        yield (
            topic,
            _message_row(topic, decoded.decoded_message, decoded.message.log_time),
        )


def _position_channels(summary: Any, path: Path) -> list[Any]:
    """List the channels whose messages may hold positions.

    Raises DataError with the available topics if there is none.
    """
    channels = []
    descriptions = []
    for channel in summary.channels.values():
        schema = summary.schemas.get(channel.schema_id)
        kind = schema.name.rpartition("/")[2] if schema else ""
        descriptions.append(f"{channel.topic} ({kind})")
        if kind in MESSAGE_TYPES or channel.message_encoding == "json":
            channels.append(channel)
    if not channels:
        raise DataError(
            path,
            f"no topic says where something is; there are {', '.join(descriptions)}",
            f"Record one of {', '.join(MESSAGE_TYPES)}.",
        )
    return channels


def _message_row(topic: str, message: Any, log_time: int) -> dict[str, float]:
    """Return the numbers of a message by column name.

    log_time: time of logging [ns], for messages without a time stamp.
    """
    stamp = _field_value(_field_value(message, "header"), "stamp")
    seconds, nanoseconds = _field_value(stamp, "sec"), _field_value(stamp, "nanosec")
    row = {"time [s]": log_time * NANOSECOND_S}
    has_time = isinstance(seconds, int) and isinstance(nanoseconds, int)
    if has_time and (seconds or nanoseconds):
        row = {"time [s]": seconds + NANOSECOND_S * nanoseconds}
    names = _field_value(message, "name")
    if isinstance(names, list | tuple):
        positions = _field_value(message, "position") or []
        # by name, as the order of joints may change within a bag
        for name, angle in zip(names, positions, strict=False):
            row[f"joint {name} [rad]"] = float(angle)
        return row
    place = topic.strip("/").replace("/", " ")
    row |= islice(_message_numbers(message, place, 0), MAX_COLUMNS)
    return row


def _field_value(message: Any, name: str) -> Any:
    """Return a field of a message, or None."""
    if isinstance(message, Mapping):
        return message.get(name)
    return getattr(message, name, None)


def _message_numbers(
    message: Any, place: str, depth: int
) -> Iterator[tuple[str, float]]:
    """Yield column names and numbers of a message.

    A position gives `tool0 x [m]`, an orientation `tool0 qx`.
    """
    if depth > MAX_DEPTH:
        return
    names = (
        message if isinstance(message, Mapping) else getattr(message, "__slots__", ())
    )
    for name in names:
        value = _field_value(message, name)
        if isinstance(value, bool) or name in ("header", "covariance"):
            continue
        if isinstance(value, int | float):
            if place.endswith(" orientation"):
                yield f"{place.removesuffix(' orientation')} q{name}", value
            else:
                yield f"{place} {name} [m]", value
        elif not isinstance(value, str | bytes | list | tuple):
            short = "orientation" if name == "rotation" else name
            inner = place if short in TRANSPARENT else f"{place} {short}"
            yield from _message_numbers(value, inner, depth + 1)
