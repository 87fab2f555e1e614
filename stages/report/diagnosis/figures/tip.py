"""The way of the string's tip, and how far from it the models are."""

from __future__ import annotations

import pandas as pd

from stringcast.stages.report.diagnosis.figures.colours import MODEL
from stringcast.stages.report.diagnosis.record import DiagnosisRecord, away
from stringcast.stages.report.picture import LIGHT, MM, Picture, framed, vector
from stringcast.stages.report.words import mm

NEAR = 0.05  # of the length measured: a point as near to the end stands for the tip


def tips(record: DiagnosisRecord) -> list[tuple[str, Picture]]:
    """For each trial what it shows, and the picture."""
    return [_tip(record, trial, last(table)) for trial, table in record.trials.items()]


def last(table: pd.DataFrame) -> pd.DataFrame:
    """The outermost point of each frame in which the tip was seen, in the order of time."""
    ends = table.loc[table.groupby("t")["s"].idxmax()]
    return ends[ends["s"] >= (1 - NEAR) * table["s"].max()].sort_values("t")


def _tip(record: DiagnosisRecord, trial: str, ends: pd.DataFrame) -> tuple[str, Picture]:
    """Above, the way in the plane; below, the distance from it over time."""
    figure = framed(3.4, 4.2, top=0.08, between=0.35)
    top, bottom = figure.subplots(2, 1, height_ratios=[5, 3])
    top.plot(ends["x"] * MM, ends["y"] * MM, ".", ms=3, color=LIGHT["measured"])
    for model in record.models:
        top.plot(ends[f"{model}_x"] * MM, ends[f"{model}_y"] * MM, lw=1.1, color=MODEL[model])
        bottom.plot(ends["t"] * MM, away(ends, model) * MM, lw=1.1, color=MODEL[model])
    top.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    bottom.set(xlabel="time [ms]", ylabel="off [mm]", ylim=(0, None))
    furthest = ", ".join(f"{model} {mm(float(away(ends, model).max()), 1)}" for model in record.models)
    words = f"{trial}: at most {furthest} off"
    return words, vector(figure, f"The tip's way in trial {words}, in the plane and over time.")
