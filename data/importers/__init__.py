"""Files of other programs, read into plain tables of named columns; `columns` says what
a column means by its name, and `gathered` makes of them the tables of our own format. A
file format is a file here, with `reads` and `read`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd


@dataclass(frozen=True)
class SourceRecording:
    """file: where it was read. table: its columns, of numbers or texts, a row for each
    sample; empty for a film. name: of the trial, where the file holds several
    recordings. fps: frames a second, where the file says so [1/s]. film: the video
    file, if it is one.
    """

    file: Path
    table: pd.DataFrame
    name: str = ""
    fps: float | None = None
    film: Path | None = None
