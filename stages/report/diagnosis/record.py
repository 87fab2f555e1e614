"""What the page of a diagnosis is made from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import Diagnosis
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.model import Model

TRIALS = 8  # drawn at most: those that the base model gets most wrong


@dataclass(frozen=True)
class DiagnosisRecord:
    """A diagnosis. model: as configured. library: effects by name. settings: by name. origin: seed, code, packages."""

    name: str
    diagnosis: Diagnosis
    model: Model
    library: Mapping[str, type[Effect]]
    settings: Mapping[str, Any]
    origin: Mapping[str, Any]

    @cached_property
    def document(self) -> dict[str, Any]:
        """diagnosis.json."""
        return dict(json.loads(self.diagnosis.finding["diagnosis"].iloc[0]))

    @cached_property
    def extension(self) -> dict[str, Any]:
        """The extended model as settings."""
        return yaml.safe_load(self.diagnosis.finding["extended"].iloc[0]) or {}

    @cached_property
    def models(self) -> tuple[str, ...]:
        """base and extended; base alone where nothing was added to it."""
        table = self.diagnosis.residuals
        same = np.array_equal(table[["base_x", "base_y"]], table[["extended_x", "extended_y"]])
        return ("base",) if same else ("base", "extended")

    @cached_property
    def trials(self) -> dict[str, pd.DataFrame]:
        """Residuals of the trials drawn, by name and in order."""
        table = self.diagnosis.residuals
        worst = list(rms(table, "base").sort_values(ascending=False).index[:TRIALS])
        return {str(name): rows for name, rows in table.groupby("trial") if name in worst}


def away(table: pd.DataFrame, model: str) -> np.ndarray:
    """(n,) distances of measured points from where a model has them [m]. table: RESIDUALS."""
    return np.hypot(table["x"] - table[f"{model}_x"], table["y"] - table[f"{model}_y"]).to_numpy()


def rms(table: pd.DataFrame, model: str) -> pd.Series:
    """Root mean square of the distances in each trial [m]. table: RESIDUALS."""
    return np.sqrt(pd.Series(away(table, model) ** 2).groupby(table["trial"].to_numpy()).mean())
