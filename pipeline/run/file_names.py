"""Names of files and folders in a run's folder."""

from __future__ import annotations

from pathlib import Path

SUMMARY_FILE = "run.json"  # there if, and only if, the run has ended
FAILURE_FILE = "failed.txt"  # why it stopped
LOCK_FILE = ".lock"
LOG_FILE = "run.log"


def artifact_folder(number: int, artifact: str = "") -> Path:
    """The folder of an iteration, or of its artifact of that name, relative to the
    run's.
    """
    return Path("iterations") / f"{number:02d}" / artifact
