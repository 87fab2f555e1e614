"""Points of the string in a recording."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from stringcast.data.importers.reader import RecordingReader, SourceColumn, list_columns
from stringcast.data.schema import DataError

UNNAMED_POINT = "point"  # if a column names the point of each row, or there is one only
MIN_LIKELIHOOD = 0.6  # lower ones are guesses (DeepLabCut's pcutoff)


def read_points(reader: RecordingReader) -> pd.DataFrame | None:
    """Read the points of the string, one row per sample and point.

    The index is that of the samples. Returns None for a recording without points.
    """
    axes_of: dict[str, dict[str, SourceColumn]] = {}
    for column in reader.columns_of("point"):
        axes = axes_of.setdefault(column.meaning.name, {})
        # prefer metres to pixels
        if column.meaning.axis in axes and column.meaning.unit == "px":
            continue
        axes[column.meaning.axis] = column
    tables = []
    for name, axes in axes_of.items():
        coordinates = sorted({"x", "y", "z"} & {*axes})
        if len(coordinates) >= 2:
            tables.append(_read_point(reader, name, axes))
        elif coordinates:
            _refuse_single_coordinate(reader, axes[coordinates[0]])
    return pd.concat(tables) if tables else None


def _refuse_single_coordinate(reader: RecordingReader, column: SourceColumn) -> None:
    """Raise DataError for a point with only one coordinate."""
    meaning = column.meaning
    other = "y" if meaning.axis == "x" else "x"
    point = meaning.name or "tip"
    raise DataError(
        reader.recording.file,
        f"column '{column.name}' is the only coordinate of the point '{point}'; "
        f"its {other} is missing",
        f"There are {list_columns(reader.recording)}. Add the column, or name "
        f"the columns of the points that count: --map {point}.x=<column> --map "
        f"{point}.y=<column>.",
        field=column.name,
    )


def _read_point(
    reader: RecordingReader, name: str, axes: Mapping[str, SourceColumn]
) -> pd.DataFrame:
    """Read one point of the string over time."""
    prefix = f"{name or UNNAMED_POINT}."
    xy = reader.read_xy(axes, prefix)
    right, _ = reader.axes_of(axes)
    if reader.length_unit(axes[right.name]) == "px":
        scale, origin = reader.hints.px_per_m, reader.hints.origin_px
        if scale is None or origin is None:
            raise DataError(
                reader.recording.file,
                "positions are in pixels",
                "Give the pixels of a metre and the pixel of the world's "
                "origin: --px-per-m 340 --origin-px 251.5,387.5.",
            )
        # rows of pixels count from the top
        x, y = (xy["x"] - origin[0]) / scale, (origin[1] - xy["y"]) / scale
        xy = {"x": x, "y": y}
    frame = pd.DataFrame({"point": name, **xy})
    if labels := reader.columns_of("label"):
        row_names = reader.read_names(labels[0], "point")
        frame["point"] = (name + " " + row_names).str.strip()
    if arcs := reader.columns_of("arc"):
        frame["s"] = reader.read_length(arcs[0], "s")
    if "sigma" in axes:
        frame["sigma"] = reader.read_length(axes["sigma"], f"{prefix}sigma")
    role = f"{prefix}valid"
    if "likelihood" in axes:
        column = axes["likelihood"]
        likelihood = reader.read_numbers(
            column, role, f"> {MIN_LIKELIHOOD}", 1.0, "name"
        )
        frame["valid"] = likelihood > MIN_LIKELIHOOD
    elif "valid" in axes:
        frame["valid"] = reader.read_numbers(axes["valid"], role, "", 1.0, "name") > 0
    return frame
