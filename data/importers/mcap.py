"""MCAP files of ROS 2 (https://mcap.dev), and others with messages in JSON; needs mcap
and mcap-ros2-support.

Every topic of joint states, poses, points or transforms is a recording; by ROS'
convention (REP 103) in metres, radians and seconds.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pandas as pd

from stringcast.data.file_checks import MAX_COLUMNS, MAX_TABLE_BYTES, require_plain_file
from stringcast.data.importers import SourceRecording
from stringcast.data.schema import DataError

MESSAGE_TYPES = (
    "JointState",
    "Pose",
    "PoseStamped",
    "PointStamped",
    "Point",
    "TransformStamped",
    "Transform",
)
MAX_MESSAGES = 2**20  # of the topics that are read: an hour at 300 a second
MAX_DEPTH = 6  # messages in one another
NANOSECOND_S = 1e-9  # [s] in a nanosecond


def reads(path: Path) -> bool:
    """Whether a file's name ends as MCAP's do."""
    return path.suffix.lower() == ".mcap"


def read(path: Path) -> list[SourceRecording]:
    """A recording for each topic that says where something is. Raises DataError."""
    if find_spec("mcap") is None or find_spec("mcap_ros2") is None:
        raise DataError(
            f"{path}: to read MCAP, two packages are needed: pip install mcap mcap-ros2-support"
        )
    from mcap.exceptions import McapError  # noqa: PLC0415

    rows: dict[str, list[dict[str, float]]] = {}
    try:
        with require_plain_file(path).open("rb") as file:
            for topic, row in _read_messages(file, path):
                rows.setdefault(topic, []).append(row)
    except (
        McapError,
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
    ) as error:
        raise DataError(
            f"{path}: cannot be read as MCAP ({error}). Try `mcap recover`, or record it again."
        ) from error
    return [
        SourceRecording(path, pd.DataFrame(table), path.stem) for table in rows.values()
    ]


def _read_messages(file: Any, path: Path) -> Iterator[tuple[str, dict[str, float]]]:
    """Topic and numbers of each message, in the order of time."""
    from mcap.reader import SeekingReader  # noqa: PLC0415
    from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415

    reader = SeekingReader(
        file, decoder_factories=[DecoderFactory()], record_size_limit=MAX_TABLE_BYTES
    )
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise ValueError("its index is missing")
    schemas = {
        number: schema.name.rpartition("/")[2]
        for number, schema in summary.schemas.items()
    }
    wanted = {
        channel.topic: number
        for number, channel in summary.channels.items()
        if schemas.get(channel.schema_id, "") in MESSAGE_TYPES
        or channel.message_encoding == "json"
    }
    if not wanted:
        there = ", ".join(
            f"{c.topic} ({schemas.get(c.schema_id, '')})"
            for c in summary.channels.values()
        )
        raise DataError(
            f"{path}: no topic says where something is; there are {there}. Record one of {', '.join(MESSAGE_TYPES)}."
        )
    count = sum(
        summary.statistics.channel_message_counts.get(number, 0)
        for number in wanted.values()
    )
    if count > MAX_MESSAGES or any(
        chunk.uncompressed_size > MAX_TABLE_BYTES for chunk in summary.chunk_indexes
    ):
        raise DataError(
            f"{path}: it has {count} messages, at most {MAX_MESSAGES} are read. Cut it: mcap filter."
        )
    if all(
        summary.channels[number].message_encoding == "json"
        for number in wanted.values()
    ):
        for _, channel, message in reader.iter_messages(topics=list(wanted)):
            yield (
                channel.topic,
                _message_row(channel.topic, json.loads(message.data), message.log_time),
            )
        return
    for found in reader.iter_decoded_messages(topics=list(wanted)):
        yield (
            found.channel.topic,
            _message_row(
                found.channel.topic, found.decoded_message, found.message.log_time
            ),
        )


def _message_row(topic: str, message: Any, logged: int) -> dict[str, float]:
    """Numbers of a message by the names of columns. logged: when it was, if it says no
    time itself [ns].
    """
    stamp = _field_value(_field_value(message, "header"), "stamp")
    seconds = _field_value(stamp, "sec"), _field_value(stamp, "nanosec")
    own = (
        seconds[0] + NANOSECOND_S * seconds[1]
        if all(isinstance(part, int) for part in seconds) and any(seconds)
        else None
    )
    row = {"time [s]": own if own is not None else logged * NANOSECOND_S}
    names = _field_value(message, "name")
    if isinstance(names, list | tuple):
        positions = list(_field_value(message, "position") or [])
        return row | {
            f"joint{n + 1} {name} [rad]": float(q)
            for n, (name, q) in enumerate(zip(names, positions))
        }  # noqa: B905
    found = dict(_message_numbers(message, topic.strip("/").replace("/", " "), 0))
    return row | {name: found[name] for name in list(found)[:MAX_COLUMNS]}


def _field_value(message: Any, name: str) -> Any:
    """A field of a message, or None."""
    return (
        message.get(name)
        if isinstance(message, Mapping)
        else getattr(message, name, None)
    )


def _message_numbers(
    message: Any, place: str, depth: int
) -> Iterator[tuple[str, float]]:
    """Numbers in a message, by place: `tool0 x [m]` of a position, `tool0 qx` of an
    orientation.
    """
    names = getattr(message, "__slots__", ())  # of a decoded message
    fields = (
        message
        if isinstance(message, Mapping)
        else {name: getattr(message, name) for name in names}
    )
    for name, value in fields.items():
        if (
            isinstance(value, bool)
            or name in ("header", "covariance")
            or depth > MAX_DEPTH
        ):
            continue
        if isinstance(value, int | float):
            turned = place.endswith(" orientation")
            yield (
                f"{place.removesuffix(' orientation')} {'q' if turned else ''}{name}{'' if turned else ' [m]'}",
                value,
            )
        elif not isinstance(value, str | bytes | list | tuple):
            short = {"rotation": "orientation"}.get(name, name)
            inner = (
                place
                if short in ("pose", "position", "point", "transform", "translation")
                else f"{place} {short}"
            )
            yield from _message_numbers(value, inner, depth + 1)
