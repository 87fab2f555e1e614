"""LeRobot's datasets (https://github.com/huggingface/lerobot, versions 2 and 3): a
folder with `meta/info.json`.
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
MAX_FEATURE_WIDTH = 64  # numbers of a feature: of a state, and not of an image
INDEX_COLUMNS = ("timestamp", "episode_index", "frame_index")
ACTION_PREFIX = "action"  # what the arm was told, and not where it was


def reads(path: Path) -> bool:
    """Whether a folder is such a dataset."""
    return (path / INFO_FILE).is_file()


def read(path: Path) -> list[SourceRecording]:
    """All episodes, with a column for each number of a feature: a recording a file.
    Raises DataError.
    """
    about = read_json(require_inside(path, path / INFO_FILE))
    features = about.get("features")
    if not isinstance(features, dict):
        raise DataError(
            f"{path / INFO_FILE}: it says nothing of 'features'. Restore it."
        )
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise DataError(
            f"{path}: there is no Parquet file in its folder data. Download the whole dataset."
        )
    frames = [_read_numbers(require_inside(path, file), features) for file in files]
    return [SourceRecording(path, pd.concat(frames, ignore_index=True))]


def _read_numbers(path: Path, features: Mapping[str, Any]) -> pd.DataFrame:
    """One file's numbers."""
    try:
        plain, _ = check_parquet(path, [])
        with pq.ParquetFile(path) as file:
            there = file.schema_arrow.names
            wide = {
                name: width
                for name, about in features.items()
                if name in there and (width := _feature_width(about)) > 0
            }
            table = file.read(
                [
                    name
                    for name in dict.fromkeys((*INDEX_COLUMNS, *wide))
                    if name in plain or name in wide
                ]
            )
        columns = {
            name: table[name].to_numpy()
            for name in INDEX_COLUMNS
            if name in table.column_names
        }
        for name in wide:
            if name not in INDEX_COLUMNS and not name.startswith(ACTION_PREFIX):
                values = np.array(table[name].to_pylist(), dtype=float).reshape(
                    len(table), -1
                )
                columns |= dict(
                    zip(
                        _feature_columns(name, features[name], values.shape[1]),
                        values.T,
                        strict=True,
                    )
                )
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:
        raise DataError(
            f"{path}: cannot be read ({error}). Download it again."
        ) from error
    return pd.DataFrame(columns)


def _feature_width(about: Any) -> int:
    """How many numbers a feature has; 0 where it has none, or is a picture."""
    if not isinstance(about, dict) or about.get("dtype") not in (
        "float32",
        "float64",
        "int64",
        "int32",
    ):
        return 0
    shape = about.get("shape")
    return (
        shape[0]
        if isinstance(shape, list)
        and len(shape) == 1
        and 0 < shape[0] <= MAX_FEATURE_WIDTH
        else 0
    )


def _feature_columns(feature: str, about: Mapping[str, Any], width: int) -> list[str]:
    """The names of a feature's columns, from the dataset, else by number."""
    names = about.get("names")
    names = next(iter(names.values()), None) if isinstance(names, dict) else names
    known = isinstance(names, list) and len(names) == width
    return [f"{feature} {names[n] if known and names else n}" for n in range(width)]
