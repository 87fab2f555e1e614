"""LeRobot's datasets (https://github.com/huggingface/lerobot, versions 2 and 3): a folder with `meta/info.json`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from stringcast.data.foreign import json_block, own, parquet
from stringcast.data.importers import Recording
from stringcast.data.schema import DataError

INFO = Path("meta") / "info.json"
WIDEST = 64  # numbers of a feature: of a state, and not of an image
KEPT = ("timestamp", "episode_index", "frame_index")
COMMAND = "action"  # what the arm was told, and not where it was


def reads(path: Path) -> bool:
    """Whether a folder is such a dataset."""
    return (path / INFO).is_file()


def read(path: Path) -> list[Recording]:
    """All episodes, with a column for each number of a feature: a recording a file. Raises DataError."""
    about = json_block(own(path, path / INFO))
    features = about.get("features")
    if not isinstance(features, dict):
        raise DataError(f"{path / INFO}: it says nothing of 'features'. Restore it.")
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise DataError(f"{path}: there is no Parquet file in its folder data. Download the whole dataset.")
    frames = [_frame(own(path, file), features) for file in files]
    return [Recording(path, pd.concat(frames, ignore_index=True))]


def _frame(path: Path, features: Mapping[str, Any]) -> pd.DataFrame:
    """One file's numbers."""
    try:
        plain, _ = parquet(path, [])
        with pq.ParquetFile(path) as file:
            there = file.schema_arrow.names
            wide = {name: width for name, about in features.items() if name in there and (width := _width(about)) > 0}
            table = file.read([name for name in dict.fromkeys((*KEPT, *wide)) if name in plain or name in wide])
        columns = {name: table[name].to_numpy() for name in KEPT if name in table.column_names}
        for name in wide:
            if name not in KEPT and not name.startswith(COMMAND):
                values = np.array(table[name].to_pylist(), dtype=float).reshape(len(table), -1)
                columns |= dict(zip(_names(name, features[name], values.shape[1]), values.T, strict=True))
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:
        raise DataError(f"{path}: cannot be read ({error}). Download it again.") from error
    return pd.DataFrame(columns)


def _width(about: Any) -> int:
    """How many numbers a feature has; 0 where it has none, or is a picture."""
    if not isinstance(about, dict) or about.get("dtype") not in ("float32", "float64", "int64", "int32"):
        return 0
    shape = about.get("shape")
    return shape[0] if isinstance(shape, list) and len(shape) == 1 and 0 < shape[0] <= WIDEST else 0


def _names(feature: str, about: Mapping[str, Any], width: int) -> list[str]:
    """The names of a feature's columns, from the dataset, else by number."""
    names = about.get("names")
    names = next(iter(names.values()), None) if isinstance(names, dict) else names
    known = isinstance(names, list) and len(names) == width
    return [f"{feature} {names[n] if known and names else n}" for n in range(width)]
