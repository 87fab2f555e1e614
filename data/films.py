"""The frames of a dataset: images that `frames` lists, or one video for each trial."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.foreign import own
from stringcast.data.images import ImageFiles, Images, Video

VIDEOS = (".mp4", ".mov", ".avi", ".mkv")
Shots = tuple[np.ndarray, Images]


def listed(folder: Path, frames: pd.DataFrame) -> dict[str, Shots]:
    """Times (F,) [s] and images by trial. frames: columns trial, t, file, in the order of time."""
    return {
        str(name): (rows["t"].to_numpy(), ImageFiles(folder, tuple(rows["file"])))
        for name, rows in frames.groupby("trial")
    }


def filmed(folder: Path, fps: float) -> dict[str, Shots]:
    """Times (F,) [s] and images by trial, from `videos/<trial>.mp4`. fps: as filmed [1/s], not as played."""
    shots: dict[str, Shots] = {}
    for path in videos(folder):
        video = Video(path)
        shots[path.stem] = (np.arange(len(video)) / fps, video)
    return shots


def videos(folder: Path) -> list[Path]:
    """Video files of a dataset, in the order of their names."""
    found = sorted(p for p in (folder / "videos").glob("*") if p.suffix.lower() in VIDEOS)
    return [own(folder, path) for path in found]
