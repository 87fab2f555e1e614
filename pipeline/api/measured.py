"""Read measured trials from a folder or from tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import pandas as pd
import yaml

from stringcast.data import dataset
from stringcast.data.metadata import DATASET_FILE, FORMAT_VERSION
from stringcast.data.schema import DataError


@dataclass(frozen=True)
class Trials:
    """Measured trials, a dataset in the format of data/README.md.

    Parameters
    ----------
    data : Dataset
        The dataset.
    temporary_folder : TemporaryDirectory, optional
        The folder of a dataset made from tables.
    """

    data: dataset.Dataset
    temporary_folder: TemporaryDirectory[str] | None = None

    @property
    def folder(self) -> Path:
        """The folder that holds the dataset."""
        return self.data.folder

    @property
    def table(self) -> pd.DataFrame:
        """A row for each trial: frames, points, seconds, and why it is rejected.

        `rate` is the number of frames a second, by the median step.
        """
        rows = []
        for name, trial in self.data.trials.items():
            t = trial.valid_points["t"]
            steps = np.diff(np.unique(t))
            rows.append(
                {
                    "trial": name,
                    "frames": t.nunique(),
                    "points": len(t),
                    "seconds": float(t.max() - t.min()),
                    "rate": round(1 / np.median(steps), 1) if len(steps) else np.nan,
                    "rejected": "",
                }
            )
        for name, reason in self.data.rejection_reasons.items():
            rows.append({"trial": name, "rejected": reason})
        columns = ["trial", "frames", "points", "seconds", "rate", "rejected"]
        return pd.DataFrame(rows, columns=columns)

    def __len__(self) -> int:
        """Return the number of usable trials."""
        return len(self.data.trials)

    def __repr__(self) -> str:
        """Return the folder and the numbers of usable and rejected trials."""
        rejected = len(self.data.rejection_reasons)
        suffix = f", {rejected} rejected" if rejected else ""
        return f"Trials({len(self)} of {self.folder}{suffix})"

    def __str__(self) -> str:
        """Return a description: string, points, rates and durations."""
        return f"{self.summary}\n\n{self.table.to_string(index=False, na_rep='')}"

    @property
    def summary(self) -> str:
        """The string's length and the number of points and frames, in words."""
        table = self.table[self.table["rejected"] == ""]
        points = table["points"] / table["frames"]
        length = self.data.metadata.get("string", {}).get("length")
        string = f"a string of {1e3 * length:.0f} mm" if length else "a string"
        return (
            f"{len(self)} trials of {string}: {points.median():.0f} points a frame, "
            f"{table['rate'].median():.0f} frames a second, "
            f"{table['seconds'].min():.2f} to {table['seconds'].max():.2f} s"
        )

    def _repr_html_(self) -> str:
        table = self.table.to_html(index=False, na_rep="")
        return f"<p>{escape(self.summary)}</p>{table}"


def read(folder: str | Path) -> Trials:
    """Read the trials of a folder.

    Parameters
    ----------
    folder : str or Path
        A run, or a dataset in the format of data/README.md.

    Returns
    -------
    Trials

    Raises
    ------
    StringcastError
        If no trial can be used.
    """
    data = dataset.read_dataset(Path(folder))
    data.require_trial(str(folder))
    return Trials(data)


def sample() -> Trials:
    """Read the five trials of a virtual lab in the package.

    Returns
    -------
    Trials
        Trials with a hidden cause, which a diagnosis finds.
    """
    return read(Path(dataset.__file__).with_name("sample"))


def trials(
    points: pd.DataFrame,
    *,
    length: float,
    grasp: pd.DataFrame | None = None,
    arm: pd.DataFrame | None = None,
    links: Sequence[float] = (),
    base: Sequence[float] = (),
    sigma: float | None = None,
    initial: Literal["rest", "moving"] = "rest",
) -> Trials:
    """Make trials from tables.

    With a single trial, the column `trial` is optional.

    Parameters
    ----------
    points : DataFrame
        Measured points: t [s], arc length s from the grasp [m], x, y [m], and, if
        known, sigma [m].
    length : float
        Length of the string [m].
    grasp : DataFrame, optional
        Poses of the grasp: t [s], x, y [m], theta [rad]. Give either this or `arm`.
    arm : DataFrame, optional
        Joint angles: t [s], q1, q2, q3 [rad]. It needs `links` and `base`.
    links : sequence of float, optional
        Lengths of the arm's three links [m].
    base : sequence of float, optional
        Position (x, y) of joint 1 [m].
    sigma : float, optional
        Standard deviation of a coordinate [m]; estimated if not given.
    initial : {"rest", "moving"}
        State of the string at the start of each trial.

    Returns
    -------
    Trials

    Raises
    ------
    StringcastError
        If a table is missing or cannot be used.
    """
    if (grasp is None) == (arm is None):
        raise DataError(
            "trials()",
            "give either grasp= (poses of the grasp) or arm= (joint angles)",
        )
    if arm is not None and not (len(links) == 3 and len(base) == 2):
        raise DataError(
            "trials()",
            "joint angles alone do not determine the hand",
            "Give links=(.., .., ..), base=(x, y).",
        )
    folder = TemporaryDirectory(prefix="stringcast-")
    for name, table in {"points": points, "grasp": grasp, "arm": arm}.items():
        if table is not None:
            named = table if "trial" in table else table.assign(trial="t00")
            named.to_parquet(Path(folder.name) / f"{name}.parquet", index=False)
    metadata: dict[str, Any] = {
        "format": FORMAT_VERSION,
        "name": "trials",
        "string": {"length": float(length)},
        "initial": initial,
    }
    if arm is not None:
        metadata["arm"] = {"links": [*map(float, links)], "base": [*map(float, base)]}
    if sigma is not None:
        metadata["noise"] = {"point_sigma": float(sigma)}
    text = yaml.safe_dump(metadata)
    (Path(folder.name) / DATASET_FILE).write_text(text, encoding="utf-8")
    return Trials(read(folder.name).data, folder)
