"""Base against extended model on trials that neither has seen."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.stages.report.diagnosis.figures.colours import MODEL, NAMES
from stringcast.stages.report.diagnosis.record import DiagnosisRecord
from stringcast.stages.report.diagnosis.words import gain
from stringcast.stages.report.picture import LIGHT, MM, Picture, vector
from stringcast.stages.report.words import mm


def foretold(record: DiagnosisRecord) -> Picture | None:
    """Residual over the whole string and at its tip, trial by trial."""
    table = record.diagnosis.held_out
    if table.empty:
        return None
    figure = Figure(figsize=(5.4, 1.2 + 0.3 * len(table)))
    panels = figure.subplots(1, 2, sharey=True)
    for axes, column, words in zip(panels, ("rms", "tip_rms"), ("whole string", "tip"), strict=True):
        _pairs(axes, record, column)
        axes.set(title=words, xlabel="RMS [mm]", xlim=(0, None))
    if (
        len(record.models) > 1
        and "rms_known" in table
        and set(table["trial"]) <= set(record.document["trials"]["used"])
    ):
        known = table["rms_known"] * MM
        panels[0].plot(known, range(len(table)), "o", ms=10, mfc="none", color=MODEL["extended"], label="fitted to all")
    panels[0].set_yticks(range(len(table)), table["trial"])
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    mean = ", ".join(
        f"{mm(float(np.sqrt((table[f'rms_{m}'] ** 2).mean())), 1)} for the {NAMES[m]}" for m in record.models
    )
    return vector(figure, f"Residual on trials left out of the fit: {mean}.")


def _pairs(axes: Axes, record: DiagnosisRecord, column: str) -> None:
    table = record.diagnosis.held_out
    place = np.arange(len(table))
    ends = np.stack([table[f"{column}_{model}"] * MM for model in record.models])
    axes.hlines(place, ends.min(axis=0), ends.max(axis=0), color=LIGHT["axis"], lw=1.2)
    axes.plot(table["noise_floor"] * MM, place, "|", ms=14, mew=1.6, color=LIGHT["ink"], label="noise floor")
    for model, values in zip(record.models, ends, strict=True):
        axes.plot(values, place, "o", ms=6, color=MODEL[model], label=NAMES[model])


def likelier(record: DiagnosisRecord) -> Picture | None:
    """Gain of the log-likelihood trial by trial, and its mean with the standard error."""
    table = record.diagnosis.held_out
    if table.empty or len(record.models) == 1:
        return None
    figure = Figure(figsize=(5.4, 1.2 + 0.3 * len(table)))
    axes = figure.subplots()
    difference = table["log_likelihood_difference"]
    bars = axes.barh(table["trial"], difference, height=0.6, color=LIGHT["after"], alpha=0.6)
    axes.bar_label(bars, [gain(value) for value in difference], padding=4, fontsize=8, color=LIGHT["soft"])
    mean, error = difference.mean(), difference.sem()
    axes.axvline(mean, color=LIGHT["ink"], lw=1.4, label="mean")
    if np.isfinite(error):
        axes.axvspan(mean - error, mean + error, color=LIGHT["axis"], alpha=0.3, lw=0, label="its standard error")
    axes.axvline(0, color=LIGHT["axis"], lw=1)
    axes.set(xlabel="log-likelihood, extended less base")
    axes.margins(x=0.15)
    axes.invert_yaxis()
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return vector(figure, f"Gain of the log-likelihood on each trial left out; on average {gain(mean)}.")
