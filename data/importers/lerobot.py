"""Datasets of LeRobot (https://github.com/huggingface/lerobot, versions 2 and 3).

A dataset is a folder with `meta/info.json`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from stringcast.data.file_checks import check_parquet, read_json, require_inside
from stringcast.data.importers import SourceRecording
from stringcast.data.schema import DataError

INFO_FILE = Path("meta") / "info.json"
MAX_FEATURE_WIDTH = 64  # numbers of a feature: more than any state, fewer than an image
INDEX_COLUMNS = ("timestamp", "episode_index", "frame_index")
ACTION_PREFIX = "action"  # commands, not measured positions
ANGLE_QUESTION = (
    "a dataset of LeRobot does not say in which unit its angles are: degrees if it was "
    "recorded with use_degrees=true, else -100 to 100 of the calibrated range, which "
    "is the default. Give --deg for degrees (or --rad); scale others by the "
    "calibration file first, into columns such as joint1_deg"
)
NUMBER_TYPES = ("float32", "float64", "int64", "int32")


def recognises(path: Path) -> bool:
    """Return whether a folder is a LeRobot dataset."""
    return (path / INFO_FILE).is_file()


def read(path: Path) -> list[SourceRecording]:
    """Read all episodes as one recording, with a column for each number of a feature.

    Raises DataError if the dataset is incomplete or damaged.
    """
    features = read_json(require_inside(path, path / INFO_FILE)).get("features")
    if not isinstance(features, dict):
        raise DataError(
            path / INFO_FILE,
            "it says nothing of 'features'",
            "Restore it.",
        )
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise DataError(
            path,
            "there is no Parquet file in its folder data",
            "Download the whole dataset.",
        )
    frames = [_read_numbers(require_inside(path, file), features) for file in files]
    table = pd.concat(frames, ignore_index=True)
    return [SourceRecording(path, table, angle_question=f"{ANGLE_QUESTION}.")]


def _read_numbers(path: Path, features: Mapping[str, Any]) -> pd.DataFrame:
    """Read the numbers of one file."""
    try:
        plain, _ = check_parquet(path, [])
        with pq.ParquetFile(path) as file:
            wide = [name for name, feature in features.items() if _is_numeric(feature)]
            readable = {*plain, *set(wide).intersection(file.schema_arrow.names)}
            unique_names = dict.fromkeys((*INDEX_COLUMNS, *wide))
            names = [name for name in unique_names if name in readable]
            table = file.read(names)
        columns = {}
        for name in names:
            if name in INDEX_COLUMNS:
                columns[name] = table[name].to_numpy()
            elif not name.startswith(ACTION_PREFIX):
                values = np.array(table[name].to_pylist(), dtype=float)
                values = values.reshape(len(table), -1)
                labels = _feature_columns(name, features[name], values.shape[1])
                columns |= dict(zip(labels, values.T, strict=True))
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:
        raise DataError(
            path, f"cannot be read ({error})", "Download it again."
        ) from error
    return pd.DataFrame(columns)


def _is_numeric(feature: Any) -> bool:
    """Return whether a feature is a number or a short vector."""
    if not isinstance(feature, dict) or feature.get("dtype") not in NUMBER_TYPES:
        return False
    shape = feature.get("shape")
    return (
        isinstance(shape, list)
        and len(shape) == 1
        and 0 < shape[0] <= MAX_FEATURE_WIDTH
    )


def _feature_columns(
    feature: str, description: Mapping[str, Any], width: int
) -> list[str]:
    """Name a feature's columns as in the dataset, otherwise by number."""
    names = description.get("names")
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    if not isinstance(names, list) or len(names) != width:
        names = range(width)
    return [f"{feature} {name}" for name in names]
