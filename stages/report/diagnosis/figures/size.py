"""How wrong the models are in each trial, against the noise floor."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from stringcast.stages.report.diagnosis.figures.colours import MODEL, NAMES
from stringcast.stages.report.diagnosis.record import DiagnosisRecord, rms
from stringcast.stages.report.picture import LIGHT, MM, Picture, vector
from stringcast.stages.report.words import mm


def size(record: DiagnosisRecord) -> Picture | None:
    """Root mean square of the residual in each trial, with what noise alone and noise and simulation leave."""
    table = record.diagnosis.residuals
    if table.empty:
        return None
    names = list(rms(table, "base").index)
    place = np.arange(len(names))
    figure = Figure(figsize=(5.4, 1.2 + 0.3 * len(names)))
    axes = figure.subplots()
    expected = {c: np.sqrt(2 * (table[c] ** 2).groupby(table["trial"]).mean()) * MM for c in ("sigma", "doubt")}
    axes.barh(place, expected["doubt"], height=0.7, color=LIGHT["grid"], label="noise and the simulation's own error")
    axes.plot(expected["sigma"], place, "|", ms=14, mew=1.6, color=LIGHT["ink"], label="noise floor")
    for model in record.models:
        axes.plot(rms(table, model) * MM, place, "o", ms=6, color=MODEL[model], label=NAMES[model])
    axes.set(xlabel="residual, RMS [mm]", xlim=(0, None), yticks=place, yticklabels=names)
    axes.invert_yaxis()
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    whole = " and ".join(f"{mm(float(rms(table, m).max()), 1)} for the {NAMES[m]}" for m in record.models)
    return vector(figure, f"Residual in each trial against the noise floor: at most {whole}.")
