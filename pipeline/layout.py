"""What lies where in a run's folder."""

from __future__ import annotations

from pathlib import Path

ENDED = "run.json"  # there if, and only if, the run has ended
FAILED = "failed.txt"  # why it stopped
LOCK = ".lock"
LOG = "run.log"
FOLDERS = {
    "generate": "motion",
    "excite": "motion",
    "execute": "trial",
    "extract": "points",
    "estimate": "estimate",
    "predict": "prediction",
    "align": "alignment",
    "diagnose": "diagnosis",
    "propose": "motion",
}


def place_of(number: int, step: str) -> Path:
    """The folder of a step's artifact, relative to the run's."""
    return Path("iterations") / f"{number:02d}" / FOLDERS[step]
