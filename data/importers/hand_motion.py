"""Motion of the hand in a recording: joint angles, or poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import pandas as pd

from stringcast.data.importers.columns import (
    ANGLE_UNITS,
    LENGTH_UNITS,
    QUATERNION_AXES,
    split_words,
)
from stringcast.data.importers.reader import (
    COUNTS_PER_TURN,
    MAX_ANGLE_RAD,
    RecordingReader,
    SourceColumn,
)
from stringcast.data.lost_samples import zero_row_mask
from stringcast.data.schema import DataError


def read_motion(reader: RecordingReader) -> pd.DataFrame | None:
    """Read joint angles q1, q2 ... [rad] or poses x, y [m], theta [rad] of the hand.

    Returns None if the recording has neither.
    """
    joints = reader.columns_of("joint")
    return _read_joints(reader, joints) if joints else _read_poses(reader)


def find_zero_rows(reader: RecordingReader) -> np.ndarray:
    """Find zero rows among others in the hand's log, (K,) bool."""
    columns = reader.columns_of("joint") or _hand_columns(reader)
    units = ANGLE_UNITS | LENGTH_UNITS
    values = np.empty((len(reader.table), len(columns)))
    for number, column in enumerate(columns):
        factor = units.get(column.meaning.unit, 1.0)
        values[:, number] = reader.numbers(column.name) * factor
    return zero_row_mask(values)


def _read_joints(
    reader: RecordingReader, columns: Sequence[SourceColumn]
) -> pd.DataFrame:
    """Read joint angles relative to the previous link, base first [rad]."""
    joints = sorted(columns, key=lambda column: int(column.meaning.name))
    _refuse_alike_joints(reader, joints)
    _refuse_joint_of_other_unit(reader, joints)
    unitless = [c for c in joints if not c.meaning.unit]  # all share one unit
    angles = {}
    for number, column in enumerate(joints, 1):
        role = f"q{number}"
        angles[role] = reader.read_angle(column, role, unitless)
    table = pd.DataFrame(angles)
    if reader.hints.absolute:
        table = table.diff(axis=1).fillna({"q1": table["q1"]})
    return table


def _read_poses(reader: RecordingReader) -> pd.DataFrame | None:
    """Read poses of the hand; None for positions without direction.

    theta, the direction of the string, is a column, or the x-axis rotated by a
    quaternion.
    """
    hand = {column.meaning.axis: column for column in _hand_columns(reader)}
    if len({"x", "y", "z"} & {*hand}) < 2 or not has_direction({*hand}):
        return None
    right, up = reader.plane_axes
    pose = reader.read_xy(hand, "")
    if "angle" in hand:
        pose["theta"] = reader.read_angle(hand["angle"], "theta")
    else:
        direction = _turned_x(reader, hand)
        rise = up.sign * direction[up.name]
        run = right.sign * direction[right.name]
        pose["theta"] = np.unwrap(np.arctan2(rise, run))
    return pd.DataFrame(pose)


def has_direction(axes: set[str]) -> bool:
    """Return whether these axes give the direction of the hand."""
    return "angle" in axes or axes >= {*QUATERNION_AXES}


def _refuse_alike_joints(
    reader: RecordingReader, joints: Sequence[SourceColumn]
) -> None:
    """Refuse two columns of the same joint."""
    for one, other in pairwise(joints):
        if one.meaning.name == other.meaning.name:
            raise DataError(
                reader.recording.file,
                f"the columns '{one.name}' and '{other.name}' both seem to be "
                f"joint {one.meaning.name}",
                f"Name the joints, base first: --map 'q1={one.name}' --map "
                "q2=<column>.",
            )


def _refuse_joint_of_other_unit(
    reader: RecordingReader, joints: Sequence[SourceColumn]
) -> None:
    """Refuse an implausibly large angle of one joint only."""
    largest = {}
    for column in joints:
        raw = reader.numbers(column.name)
        factor = ANGLE_UNITS.get(column.meaning.unit, ANGLE_UNITS["deg"])
        largest[column.name] = float(raw.abs().quantile(0.9)) * factor
    too_far = [name for name in largest if largest[name] > MAX_ANGLE_RAD]
    if len(too_far) in (0, len(joints)):
        return
    name = too_far[0]
    turned = np.degrees(largest[name])
    raise DataError(
        reader.recording.file,
        f"column '{name}' reaches {turned:.0f} degrees, which no joint does, and "
        "the other joints do not",
        f"If it holds the counts of an encoder, {COUNTS_PER_TURN} a turn, "
        f"multiply it by {360 / COUNTS_PER_TURN:.6g}; if it is no joint, name "
        "those that are: --map q1=<column>.",
        field=name,
    )


def _hand_columns(reader: RecordingReader) -> list[SourceColumn]:
    """Return the columns of the hand.

    Raises DataError if several bodies are possible, or none has the stated name.
    """
    columns = reader.columns_of("hand")
    axes_of: dict[str, set[str]] = {}
    for column in columns:
        axes_of.setdefault(column.meaning.name, set()).add(column.meaning.axis)
    bodies = [name for name, axes in axes_of.items() if len(axes & {*"xyz"}) > 1]
    stated_hand = reader.hints.hand
    if stated_hand:
        words = {*split_words(stated_hand)}
        candidates = [name for name in bodies if words <= {*name.split()}]
        if bodies and len(candidates) != 1:
            raise DataError(
                f"--hand {stated_hand}",
                f"{reader.recording.file} has the bodies {', '.join(bodies)}",
                "Name one of them.",
            )
    elif len(bodies) < 2:
        return columns
    else:
        candidates = [name for name in bodies if has_direction(axes_of[name])]
        if len(candidates) != 1:
            names = [name.removeprefix("hand ") for name in bodies]
            raise DataError(
                reader.recording.file,
                f"several bodies could be the hand: {', '.join(names)}",
                f"Name the one that holds the string: --hand '{names[0]}'.",
            )
    return [column for column in columns if column.meaning.name in candidates]


def _turned_x(
    reader: RecordingReader, hand: Mapping[str, SourceColumn]
) -> dict[str, np.ndarray]:
    """Rotate the x-axis by the hand's quaternion; components (K,) by name."""
    x, y, z, w = (
        reader.read_numbers(hand[name], name, "1", 1.0, "name")
        for name in QUATERNION_AXES
    )
    return {
        "x": 1 - 2 * (y**2 + z**2),
        "y": 2 * (x * y + w * z),
        "z": 2 * (x * z - w * y),
    }
