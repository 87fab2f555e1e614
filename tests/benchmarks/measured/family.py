"""Families of strings that others measured, each string as a dataset in our format.

A family's folder holds several strings side by side. The settings say what its tables
do not: which trials belong to a string, which begin moving, the noise of a marker, the
camera. The outermost marker is the tip.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import yaml
from pydantic import Field

from stringcast.data import store
from stringcast.data.artifacts import GRASP, POINTS
from stringcast.data.schema import DataError
from stringcast.data.table_files import with_trial

# masses of each string and its tip, where they were weighed
MASSES_FILE = "cables.json"


@dataclass(frozen=True)
class Family:
    """Strings that were measured in one way, and how they are modelled.

    Attributes
    ----------
    folder
        Folder of their tables, in that of all families.
    trials
        Pattern of the names of their trials; its group `string` is the string's name.
    moving, held_out
        Patterns of trials that begin moving, and of trials to which nothing is fitted.
    every
        One of so many frames is used.
    beyond
        Arc length from the grasp [m] up to which no point is used.
    about
        What else dataset.yaml says.
    settings
        Settings of every run.
    sets
        Effects of each set, by its name, and their known values.
    authors
        Rms distance [m] of the tip in the authors' own model, in the fitted trial, by
        string.
    """

    folder: str
    trials: str
    moving: str
    held_out: str
    every: Annotated[int, Field(ge=1)]
    beyond: Annotated[float, Field(ge=0)]
    about: dict[str, Any]
    settings: dict[str, Any]
    sets: dict[str, dict[str, Any]]
    authors: dict[str, float]

    def trials_by_string(self, source: Path) -> dict[str, list[str]]:
        """Return names of trials by string. source: folder of all families."""
        path = source / self.folder / "points.parquet"
        if not path.is_file():
            raise DataError(
                path,
                "there is no such file",
                f"Name the folder that holds {self.folder}.",
            )
        trials: dict[str, list[str]] = {}
        for trial in sorted(pd.read_parquet(path, columns=["trial"])["trial"].unique()):
            if match := re.fullmatch(self.trials, trial):
                trials.setdefault(match["string"], []).append(trial)
        return trials

    def write(
        self,
        source: Path,
        string: str,
        trials: list[str],
        folder: Path,
        origin: Mapping[str, Any],
    ) -> None:
        """Write the dataset of one string; dataset.yaml comes last.

        `source` is the folder of all families.
        """
        for table in (GRASP, POINTS):
            rows = pd.read_parquet(source / self.folder / f"{table.name}.parquet")
            rows = rows[rows["trial"].isin(trials)].reset_index(drop=True)
            if table is POINTS:
                frame = rows.groupby("trial")["t"].rank("dense").astype(int) - 1
                rows = rows[(frame % self.every == 0) & (rows["s"] > self.beyond)]
                if "held" in rows:
                    # the tracker repeated its last value
                    rows = rows.assign(valid=~rows["held"])
            store.write_table(
                with_trial(table), rows, folder / f"{table.name}.parquet", origin
            )
        about = {
            "format": 1,
            "name": string,
            "string": {
                "length": round(float(rows["s"].max()), 4),
                **self._masses(source, string),
            },
            **self.about,
            "trials": {trial: self._trial_metadata(trial) for trial in trials},
        }
        store.write_text(
            folder / "dataset.yaml", yaml.safe_dump(about, sort_keys=False)
        )

    def _masses(self, source: Path, string: str) -> dict[str, float]:
        """Return masses [kg] of a string and its tip, if they were weighed."""
        path = source / self.folder / MASSES_FILE
        weighed = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        if string not in weighed:
            return {}
        return {
            "mass": weighed[string]["m_cable_kg"],
            "tip_mass": weighed[string]["m_tip_kg"],
        }

    def _trial_metadata(self, trial: str) -> dict[str, str]:
        metadata = {"initial": "moving" if re.fullmatch(self.moving, trial) else "rest"}
        if re.fullmatch(self.held_out, trial):
            metadata["role"] = "held_out"
        return metadata
