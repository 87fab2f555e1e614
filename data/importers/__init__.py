"""Readers of foreign files, into plain tables of named columns.

Each file format has a module with `recognises` and `read`. `columns` interprets
the names of columns, and `gather` combines recordings into the tables of our format.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd


@dataclass(frozen=True, eq=False)
class SourceRecording:
    """The content of a foreign file; compared by identity.

    file: the source. table: columns of numbers or texts, one row per sample; empty for
    a film. name: trial name, if a file holds several recordings. film: the video file,
    if any. angle_question: question to the user if the format leaves the unit of angles
    open. notes: decisions of the reader.
    """

    file: Path
    table: pd.DataFrame
    name: str = ""
    film: Path | None = None
    angle_question: str = ""
    notes: tuple[str, ...] = ()
