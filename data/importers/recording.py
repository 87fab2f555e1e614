"""The result of every reader: a table of columns under their original names, or a film."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd


@dataclass(frozen=True)
class Recording:
    """file: where it was read. table: its columns, of numbers or texts, a row for each sample; empty for a film. name:
    of the trial, where the file holds several recordings. fps: frames a second, where the file says so [1/s]. film:
    the video file, if it is one."""

    file: Path
    table: pd.DataFrame
    name: str = ""
    fps: float | None = None
    film: Path | None = None
