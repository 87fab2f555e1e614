"""What each effect promised before it was fitted."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stringcast.stages.report.diagnosis.record import DiagnosisRecord
from stringcast.stages.report.diagnosis.words import gain, plain
from stringcast.stages.report.picture import LIGHT, Picture, vector

BARS = 14  # effects drawn at most, the most promising


def screenings(record: DiagnosisRecord) -> list[tuple[str, Picture]]:
    """What was at work, and the promises then: for nothing, and for each part of what was chosen."""
    chosen = set(record.extension.get("effects", ()))
    tables = record.diagnosis.screening.groupby("context", sort=False)
    return [
        (plain(context), _bars(record, rows))
        for context, rows in tables
        if set(_split(context)) < chosen or not context
    ]


def _split(context: str) -> list[str]:
    return [name for name in context.split(" + ") if name]


def _bars(record: DiagnosisRecord, rows: pd.DataFrame) -> Picture:
    best = rows.sort_values("predicted_gain", ascending=False, kind="stable").head(BARS)
    named = best["effect"].isin(record.diagnosis.causes["effect"]).to_numpy()
    names, values = [plain(name) for name in best["effect"]], best["predicted_gain"].to_numpy()
    figure = Figure(figsize=(5.4, 0.7 + 0.23 * len(best)))
    axes = figure.subplots()
    bars = axes.barh(names, values, height=0.7, color=np.where(named, LIGHT["after"], LIGHT["axis"]).tolist())
    axes.bar_label(bars, [gain(value) for value in values], padding=4, fontsize=8, color=LIGHT["soft"])
    axes.set(xlabel="gain of the log-likelihood promised", xlim=(0, 1.15 * max(values.max(), 1.0)))
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
    promised = ", ".join(f"{name} {gain(value)}" for name, value in zip(names[:3], values[:3], strict=False))
    return vector(figure, f"What effects promised to explain, the most promising first: {promised}.")
