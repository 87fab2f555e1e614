"""Films of a trial of a diagnosis: the string, measured and simulated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from stringcast.stages.report.records import DiagnosisRecord, model_distances
from stringcast.stages.report.theme import MS_PER_S

FRAME_QUANTILE = 0.75  # of the misfit along the string; ignores outliers
FILM_SIZE_PX = 420  # of the longer side
FILM_EDGE_PX = 24  # free around the strings
SCALE_ROOM_PX = 24  # below the strings, for the scale
MAX_COORDINATES = 60_000  # in all films of a page: 0.3 MB
# distance from the tip within which a point counts as the tip, as a share of the length
TIP_LENGTH_TOLERANCE = 0.05


@dataclass(frozen=True)
class FilmCanvas:
    """The canvas of a film, with its region from `low` to `high` [m]."""

    low: np.ndarray
    high: np.ndarray

    @property
    def px_per_m(self) -> float:
        """Scale at which the longer side fills the film."""
        extent = max(float((self.high - self.low).max()), 1e-3)
        return (FILM_SIZE_PX - 2 * FILM_EDGE_PX) / extent

    @property
    def size_px(self) -> np.ndarray:
        """Width and height of the film."""
        return (self.high - self.low) * self.px_per_m + 2 * FILM_EDGE_PX

    def pixels(self, points: pd.DataFrame) -> np.ndarray:
        """Map points (K, 2) [m] to pixels from the upper left corner."""
        x, y = ((points.to_numpy() - self.low) * self.px_per_m + FILM_EDGE_PX).T
        return np.round(np.column_stack([x, self.size_px[1] - y]), 1)


def worst_frame(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the frame with the largest misfit of the base model.

    The misfit is relative to the uncertainty of noise and numerical error.
    """
    ratios = model_distances(table, "base") / table["total_sigma"]
    t = ratios.groupby(table["t"]).quantile(FRAME_QUANTILE).idxmax()
    return table[table["t"] == t].sort_values("s")


def tip_points(table: pd.DataFrame) -> pd.DataFrame:
    """Return the outermost point of each frame in which the tip is visible."""
    ends = table.loc[table.groupby("t")["s"].idxmax()]
    shortest = (1 - TIP_LENGTH_TOLERANCE) * table["s"].max()
    return ends[ends["s"] >= shortest].sort_values("t")


def string_film_data(record: DiagnosisRecord, table: pd.DataFrame) -> dict[str, Any]:
    """Return measured and simulated strings of a trial, and the paths of their tips.

    The film starts at the largest misfit of the base model. The data can be written as
    JSON; coordinates are pixels of the film, times are in ms.
    """
    columns = {"measured": ["x", "y"]}
    for model in record.models:
        columns[model] = [f"{model}_x", f"{model}_y"]
    points = np.concatenate([table[pair].to_numpy() for pair in columns.values()])
    canvas = FilmCanvas(points.min(axis=0), points.max(axis=0))

    # every n-th frame, so that all films of the page stay small
    coordinates = points.size * len(record.drawn_trials)
    stride = -(-coordinates // MAX_COORDINATES)
    rows = table.sort_values(["t", "s"])
    frame_times, first_rows = np.unique(rows["t"].to_numpy(), return_index=True)
    start = float(worst_frame(table)["t"].iloc[0])
    is_shown = frame_times == start
    is_shown[::stride] = True
    shown = np.flatnonzero(is_shown)
    times = frame_times[shown].tolist()

    tips = tip_points(table)
    strings, paths = {}, {}
    for name, pair in columns.items():
        frames = np.split(canvas.pixels(rows[pair]), first_rows[1:])
        strings[name] = [frames[number].tolist() for number in shown]
        paths[name] = canvas.pixels(tips[pair]).tolist()
    width, height = canvas.size_px
    return {
        "width": round(width),
        "height": round(height) + SCALE_ROOM_PX,
        "metre": canvas.px_per_m,
        "t": [round(t * MS_PER_S, 1) for t in times],
        "start": times.index(start),
        "boxes": [],
        "stills": [],
        "strings": strings,
        "paths": paths,
    }
