"""Families of strings that others measured, and each string of them as a dataset in our
format.

A family's folder holds many strings side by side. What its tables do not say the
settings do: which trials are of one string, which begin moving, a marker's noise, the
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
from stringcast.data.dataset import GRASP, POINTS, with_trial
from stringcast.data.schema import DataError

WEIGHED = "cables.json"  # what was weighed of each string, where it was


@dataclass(frozen=True)
class Family:
    """Strings that were measured in one way, and how they are modelled.

    folder: of their tables, in that of all families. trials: pattern of their trials'
    names, whose group `string` is the name of the string; moving, held_out: patterns of
    those that begin moving, and to which nothing is fitted. every: of so many frames
    one is used. beyond: arc length from the grasp [m] up to which no point is used.
    about: what else dataset.yaml says. settings: of every run. sets: what each set has
    for itself, by its name: effects, and what is known of them. authors: root mean
    square of the tip in the model of those who measured a string, in sample [m].
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

    def strings(self, folder: Path) -> dict[str, list[str]]:
        """Names of the trials of each string, by the string's name. folder: of all
        families.
        """
        path = folder / self.folder / "points.parquet"
        if not path.is_file():
            raise DataError(
                f"{path}: there is no such file. Name the folder that holds {self.folder}, as trials=..."
            )
        found: dict[str, list[str]] = {}
        for trial in sorted(pd.read_parquet(path, columns=["trial"])["trial"].unique()):
            if match := re.fullmatch(self.trials, trial):
                found.setdefault(match["string"], []).append(trial)
        return found

    def write(
        self,
        folder: Path,
        string: str,
        trials: list[str],
        to: Path,
        origin: Mapping[str, Any],
    ) -> None:
        """The dataset of one string; dataset.yaml comes last. folder: of all families."""
        for table in (GRASP, POINTS):
            rows = pd.read_parquet(folder / self.folder / f"{table.name}.parquet")
            rows = rows[rows["trial"].isin(trials)].reset_index(drop=True)
            if table is POINTS:
                frame = rows.groupby("trial")["t"].rank("dense").astype(int) - 1
                rows = rows[(frame % self.every == 0) & (rows["s"] > self.beyond)]
                # a tracker only repeated itself
                rows = rows.assign(valid=~rows["held"]) if "held" in rows else rows
            store.write_table(
                with_trial(table), rows, to / f"{table.name}.parquet", origin
            )
        known = {"length": round(float(rows["s"].max()), 4)}
        path = folder / self.folder / WEIGHED
        stated = (
            json.loads(path.read_text(encoding="utf-8")).get(string)
            if path.is_file()
            else None
        )
        # [kg]
        known |= (
            {}
            if stated is None
            else {"mass": stated["m_cable_kg"], "tip_mass": stated["m_tip_kg"]}
        )
        about = {"format": 1, "name": string, "string": known, **self.about}
        about["trials"] = {
            trial: {"initial": "moving" if re.fullmatch(self.moving, trial) else "rest"}
            | ({"role": "held_out"} if re.fullmatch(self.held_out, trial) else {})
            for trial in trials
        }
        store.write_text(to / "dataset.yaml", yaml.safe_dump(about, sort_keys=False))
