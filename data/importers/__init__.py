"""Files of other programs, read into plain tables of named columns.

Each file format has a module with `recognises` and `read`. `columns` interprets
the names of columns, and `gather` combines recordings into the tables of our format.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd


@dataclass(frozen=True)
class SourceRecording:
    """The content of a foreign file.

    file: where it was read. table: columns of numbers or texts, one row per sample;
    empty for a film. name: of the trial, where a file holds several recordings. film:
    the video file, if it is one. angle_question: why the user must state the unit of
    angles, where the format leaves it open. notes: what the reader decided, for people.
    """

    file: Path
    table: pd.DataFrame
    name: str = ""
    film: Path | None = None
    angle_question: str = ""
    notes: tuple[str, ...] = ()
