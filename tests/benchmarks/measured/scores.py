"""Errors of a set of effects: in the fitted trials and in held-out ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stringcast.data import store
from stringcast.data.estimates import PREDICTED
from stringcast.data.metadata import read_metadata
from stringcast.data.schema import Column, Table
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.result import RunResult
from stringcast.stages.inference.initial_modes import initial_state_parameters

SETS = Table(
    "sets",
    "a row for each measured string and each set of effects fitted to it",
    (
        Column("string", "", "its name", "text"),
        Column("laws", "", "name of the set", "text"),
        Column(
            "effects",
            "",
            "beyond the paper's and the weighed tip mass; joined by ', '",
            "text",
        ),
        Column("trials", "1", "that were fitted", "int"),
        Column("fitted", "1", "parameters fitted, the same for all trials", "int"),
        Column(
            "initial",
            "1",
            "fitted coefficients of initial states, over all fitted trials",
            "int",
        ),
        Column(
            "tip",
            "m",
            "rms distance of the point nearest the tip, in the fitted trials",
        ),
        Column("rms", "m", "the same of all points"),
        Column("held_out", "1", "held-out trials", "int"),
        Column(
            "free",
            "1",
            "values of the held-out trials alone: initial states, or read at rest",
            "int",
        ),
        Column(
            "held_out_tip",
            "m",
            "rms distance of the point nearest the tip in held-out trials; NaN without any",
        ),
        Column("held_out_rms", "m", "the same of all points"),
        Column(
            "authors_tip",
            "m",
            "rms distance of the tip in the authors' model, in the fitted trials; NaN if unknown",
        ),
        Column(
            "cpu",
            "s",
            "processor time from the first import to the row; NaN if it was interrupted",
        ),
        Column(
            "code",
            "",
            "commit of the code, with a + where sources were changed",
            "text",
        ),
    ),
)


def score_fit(experiment: Experiment, result: RunResult) -> dict[str, Any]:
    """Return the numbers of a row of SETS from a run, without time and names."""
    assert result.last_estimate is not None
    model = experiment.model
    trials = read_metadata(Path(experiment.config["trials"]))["trials"].values()
    fitted = [trial for trial in trials if "role" not in trial]
    moving = sum(trial["initial"] == "moving" for trial in fitted)
    fit, predictions = result.last_estimate.fit.iloc[0], predicted_points(result.folder)
    scores = [
        cast.artifacts["prediction"].score
        for cast in result.iterations
        if "prediction" in cast.artifacts
    ]
    tip = predictions[
        predictions["s"] == predictions.groupby("trial")["s"].transform("max")
    ]
    return {
        "trials": len(fitted),
        # measured parameters are not fitted
        "fitted": len(model.parameters) - len(model.measured_ranges),
        "initial": len(initial_state_parameters(model.string)) * moving,
        "tip": float(fit["tip_after"]),
        "rms": float(fit["rms_after"]),
        "held_out": len(scores),
        "free": int(sum(score["free"].iloc[0] for score in scores)),
        "held_out_tip": rms_distance(tip),
        "held_out_rms": rms_distance(predictions),
    }


def predicted_points(run: Path) -> pd.DataFrame:
    """Return table PREDICTED of all trials that a run has predicted.

    It is empty if there are none.
    """
    paths = sorted(run.glob("iterations/*/prediction/predicted.parquet"))
    tables = [store.read_table(PREDICTED, path) for path in paths]
    return pd.concat(tables, ignore_index=True) if tables else PREDICTED.empty()


def rms_distance(rows: pd.DataFrame) -> float | None:
    """Return the rms distance of predicted and measured points [m], None if empty."""
    distances = np.hypot(
        rows["predicted_x"] - rows["x"], rows["predicted_y"] - rows["y"]
    )
    return float(np.sqrt(np.mean(distances**2))) if len(rows) else None
