"""The string in the frame that the base model gets most wrong."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stringcast.stages.report.diagnosis.figures.colours import MODEL
from stringcast.stages.report.diagnosis.record import DiagnosisRecord, away
from stringcast.stages.report.picture import LIGHT, MM, Picture, framed, vector
from stringcast.stages.report.words import mm, ms

FAR = 0.75  # quantile along the string that says how wrong a frame is: a few outliers do not


def overlays(record: DiagnosisRecord) -> list[tuple[str, Picture]]:
    """For each trial what it shows, and the picture."""
    return [_overlay(record, trial, worst(table)) for trial, table in record.trials.items()]


def worst(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of the frame of a trial in which the base model is furthest off, against what may be doubted."""
    doubts = pd.Series(away(table, "base") / table["doubt"].to_numpy(), index=table.index)
    moment = doubts.groupby(table["t"]).quantile(FAR).idxmax()
    return table[table["t"] == moment].sort_values("s")


def _overlay(record: DiagnosisRecord, trial: str, frame: pd.DataFrame) -> tuple[str, Picture]:
    figure = framed(3.4, 3.2, top=0.08)
    axes = figure.subplots()
    for model in record.models:
        axes.plot(frame[f"{model}_x"] * MM, frame[f"{model}_y"] * MM, color=MODEL[model], marker=".", ms=3)
    axes.plot(frame["x"] * MM, frame["y"] * MM, "o", ms=4, mfc="none", color=LIGHT["measured"])
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    axes.margins(0.1)
    moment = ms(float(frame["t"].iloc[0]))
    off = ", ".join(f"{m} {mm(float(np.sqrt(np.mean(away(frame, m) ** 2))), 1)}" for m in record.models)
    return f"{trial} at {moment}: {off} off", vector(
        figure, f"Trial {trial} at {moment}, string measured and simulated; off by {off}."
    )
