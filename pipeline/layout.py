"""Names of files and folders in a run's folder."""

from __future__ import annotations

from pathlib import Path

ENDED = "run.json"  # there if, and only if, the run has ended
FAILED = "failed.txt"  # why it stopped
LOCK = ".lock"
LOG = "run.log"


def place_of(number: int, artifact: str = "") -> Path:
    """The folder of an iteration, or of its artifact of that name, relative to the run's."""
    return Path("iterations") / f"{number:02d}" / artifact
