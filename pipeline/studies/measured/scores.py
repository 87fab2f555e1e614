"""How near a set of effects comes to a string: in sample, and in trials that nothing
was fitted to.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stringcast.data import store
from stringcast.data.artifacts import PREDICTED
from stringcast.data.metadata import read_metadata
from stringcast.data.schema import Column, Table
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.result import RunResult
from stringcast.stages.inference.initial_modes import initial_state_parameters

SETS = Table(
    "sets",
    "a row for each string that others measured and each set of effects that was fitted to it",
    (
        Column("string", "", "its name", "text"),
        Column("laws", "", "name of the set", "text"),
        Column(
            "effects",
            "",
            "beside the paper's own, and the tip mass that was weighed; joined by ', '",
            "text",
        ),
        Column("trials", "1", "that were fitted", "int"),
        Column("fitted", "1", "parameters fitted, the same for all trials", "int"),
        Column(
            "begun",
            "1",
            "values fitted of the states in which these trials begin, in all",
            "int",
        ),
        Column(
            "tip",
            "m",
            "root mean square distance of the point nearest the tip, in sample",
        ),
        Column("rms", "m", "the same of all points"),
        Column("held_out", "1", "trials that nothing was fitted to", "int"),
        Column(
            "free",
            "1",
            "values of these trials alone: of their beginnings, or read where they rest; in all",
            "int",
        ),
        Column(
            "held_out_tip",
            "m",
            "root mean square distance of the point nearest the tip there; NaN without any",
        ),
        Column("held_out_rms", "m", "the same of all points"),
        Column(
            "authors_tip",
            "m",
            "of the tip in the model of those who measured it, in sample; NaN if not told",
        ),
        Column(
            "cpu",
            "s",
            "of one core, from the first import to the last row; NaN if it was interrupted",
        ),
        Column(
            "code",
            "",
            "commit that fitted it, with a + where sources were changed",
            "text",
        ),
    ),
)


def scored(here: Experiment, result: RunResult) -> dict[str, Any]:
    """The numbers of a row of SETS from a run, without time and names."""
    assert result.last_estimate is not None
    said = read_metadata(Path(here.config["trials"]))["trials"]
    fitted = [trial for trial in said.values() if "role" not in trial]
    fit, apart = result.last_estimate.fit.iloc[0], predicted(result.folder)
    scores = [
        i.artifacts["prediction"].score
        for i in result.iterations
        if "prediction" in i.artifacts
    ]
    tip = apart[apart["s"] == apart.groupby("trial")["s"].transform("max")]
    return {
        "trials": len(fitted),
        # a measured one stays where it is
        "fitted": len(here.model.parameters) - len(here.model.measured_ranges),
        "begun": len(initial_state_parameters(here.model.string))
        * sum(trial["initial"] == "moving" for trial in fitted),
        "tip": float(fit["tip_after"]),
        "rms": float(fit["rms_after"]),
        "held_out": len(scores),
        "free": int(sum(score["free"].iloc[0] for score in scores)),
        "held_out_tip": _rms(tip),
        "held_out_rms": _rms(apart),
    }


def predicted(run: Path) -> pd.DataFrame:
    """Table PREDICTED of all trials that a run has predicted, empty where it has none."""
    paths = sorted(run.glob("iterations/*/prediction/predicted.parquet"))
    tables = [store.read_table(PREDICTED, path) for path in paths]
    return pd.concat(tables, ignore_index=True) if tables else PREDICTED.empty()


def _rms(rows: pd.DataFrame) -> float | None:
    """Root mean square distance [m], None of none."""
    off = np.hypot(rows["predicted_x"] - rows["x"], rows["predicted_y"] - rows["y"])
    return float(np.sqrt(np.mean(off**2))) if len(rows) else None
