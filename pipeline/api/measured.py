"""Measured trials, from a folder or from tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import pandas as pd
import yaml

from stringcast.data import dataset
from stringcast.data.metadata import DATASET_FILE, FORMAT_VERSION
from stringcast.data.schema import DataError


@dataclass(frozen=True)
class Trials:
    """A dataset in the format of data/README.md. data: as read. home: keeps a folder
    that was made for tables.
    """

    data: dataset.Dataset
    temporary_folder: TemporaryDirectory[str] | None = None

    @property
    def folder(self) -> Path:
        """The dataset's folder."""
        return self.data.folder

    @property
    def table(self) -> pd.DataFrame:
        """A row for each trial: frames, points, seconds seen; for one that cannot be
        used, why.
        """
        rows = [
            {
                "trial": name,
                "frames": seen.valid_points["t"].nunique(),
                "points": len(seen.valid_points),
            }
            | {
                "seconds": float(
                    seen.valid_points["t"].max() - seen.valid_points["t"].min()
                ),
                "rejected": "",
            }
            for name, seen in self.data.trials.items()
        ]
        left = [
            {"trial": name, "rejected": reason}
            for name, reason in self.data.rejection_reasons.items()
        ]
        return pd.DataFrame(
            [*rows, *left], columns=["trial", "frames", "points", "seconds", "rejected"]
        )

    def __len__(self) -> int:
        """How many can be used."""
        return len(self.data.trials)

    def __repr__(self) -> str:
        """Where, and how many."""
        return f"Trials({len(self)} of {self.folder}{f', {len(self.data.rejection_reasons)} rejected' * bool(self.data.rejection_reasons)})"

    def _repr_html_(self) -> str:
        return (
            f"<p>{escape(repr(self))}</p>{self.table.to_html(index=False, na_rep='')}"
        )


def read(folder: str | Path) -> Trials:
    """Trials of a folder: a run of ours, or anybody's in the format of data/README.md.

    Raises StringcastError where there is none that can be used.
    """
    found = Trials(dataset.read_dataset(Path(folder)))
    if not found:
        reasons = (
            "; ".join(
                f"{name}: {why}" for name, why in found.data.rejection_reasons.items()
            )
            or "it holds no trial"
        )
        raise DataError(
            f"{folder}: no trial can be used ({reasons}). Look at the files it names."
        )
    return found


def sample() -> Trials:
    """Five trials of a virtual lab that come with the package: what the simulation
    lacks in them is a riddle.
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
    """Trials from tables; each may lack the column `trial` where there is one trial
    only.

    points: t [s], s [m] arc length from the grasp, x, y [m], optional sigma [m].
    length: of the string [m]. One of grasp: t, x, y [m], theta [rad], and arm: t, q1,
    q2, q3 [rad], with links: their lengths, base: x, y of joint 1 [m]. sigma: noise of
    a coordinate [m]. initial: how the string begins. Raises StringcastError.
    """
    if (grasp is None) == (arm is None):
        raise DataError(
            "trials(): give either grasp= (poses of the grasp) or arm= (joint angles), and not both."
        )
    if arm is not None and not (len(links) == 3 and len(base) == 2):
        raise DataError(
            "trials(): joint angles alone do not say where the hand is. Give links=(.., .., ..), base=(x, y)."
        )
    home = TemporaryDirectory(prefix="stringcast-")
    for name, table in {"points": points, "grasp": grasp, "arm": arm}.items():
        if table is not None:
            named = table if "trial" in table else table.assign(trial="t00")
            named.to_parquet(Path(home.name) / f"{name}.parquet", index=False)
    known: dict[str, Any] = {
        "format": FORMAT_VERSION,
        "name": "trials",
        "string": {"length": float(length)},
        "initial": initial,
    }
    known |= (
        {"arm": {"links": list(map(float, links)), "base": list(map(float, base))}}
        if arm is not None
        else {}
    )
    known |= {"noise": {"point_sigma": float(sigma)}} if sigma is not None else {}
    (Path(home.name) / DATASET_FILE).write_text(yaml.safe_dump(known), encoding="utf-8")
    return Trials(read(home.name).data, home)
