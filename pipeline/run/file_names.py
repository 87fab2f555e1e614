"""Names of files and folders in a run's folder."""

from __future__ import annotations

from pathlib import Path

SUMMARY_FILE = "run.json"  # exists if, and only if, the run has ended
FAILURE_FILE = "failed.txt"  # why the run stopped
LOCK_FILE = ".lock"
LOG_FILE = "run.log"


def artifact_folder(number: int, artifact: str = "") -> Path:
    """Return the folder of an iteration or an artifact within a run."""
    return Path("iterations") / f"{number:02d}" / artifact


def artifact_tables(run: Path, artifact: str, table: str) -> list[Path]:
    """Return the files of a table in all iterations of a run, in their order."""
    return sorted(run.glob(f"iterations/*/{artifact}/{table}.parquet"))


def kept_folder(artifact: Path) -> Path:
    """Return the folder of intermediate results of a step."""
    return artifact.with_name(f".{artifact.name}.kept")
