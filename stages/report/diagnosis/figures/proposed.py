"""The string on the motion proposed, under one theory and the others."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.stages.report.diagnosis.record import DiagnosisRecord
from stringcast.stages.report.diagnosis.words import plain
from stringcast.stages.report.picture import LIGHT, MM, Picture, vector
from stringcast.stages.report.words import mm, ms

COLOURS = ("after", "before", "measured", "target")  # the likeliest theory first
STYLES = ("-", "--", "-.", ":")


def proposed(record: DiagnosisRecord) -> Picture | None:
    """Where the theories are farthest apart, and how far they are over time; None where no motion is proposed."""
    table = record.diagnosis.foretold
    if table.empty:
        return None
    theories = {str(name): rows.reset_index(drop=True) for name, rows in table.groupby("theory", sort=False)}
    apart = {name: _apart(rows, theories) for name, rows in list(theories.items())[1:]}
    closest = min(apart, key=lambda name: float(apart[name].max()))
    t = float(apart[closest].idxmax())
    figure = Figure(figsize=(7.2, 3.2))
    left, right = figure.subplots(1, 2)
    _strings(left, theories, t)
    _distances(right, record, apart)
    right.axvline(t * MM, color=LIGHT["axis"], lw=1)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=4)
    most = ", ".join(f"{plain(name)} {mm(float(way.max()), 1)}" for name, way in apart.items())
    return vector(figure, f"The proposed motion at {ms(t)}; away from {plain(next(iter(theories)))} at most: {most}.")


def _apart(rows: pd.DataFrame, theories: dict[str, pd.DataFrame]) -> pd.Series:
    """Largest distance from the likeliest theory anywhere on the string [m], by time."""
    first = next(iter(theories.values()))
    return pd.Series(np.hypot(rows["x"] - first["x"], rows["y"] - first["y"])).groupby(first["t"].to_numpy()).max()


def _strings(axes: Axes, theories: dict[str, pd.DataFrame], t: float) -> None:
    """Each theory's string at a moment."""
    for (name, rows), colour, style in zip(theories.items(), COLOURS, STYLES, strict=False):
        now = rows[rows["t"] == t].sort_values("s")
        axes.plot(now["x"] * MM, now["y"] * MM, style, marker=".", ms=4, color=LIGHT[colour], label=plain(name))
    axes.set(xlabel="x [mm]", ylabel="y [mm]", title=f"at {ms(t)}", aspect="equal", adjustable="datalim")


def _distances(axes: Axes, record: DiagnosisRecord, apart: dict[str, pd.Series]) -> None:
    """How far each theory is from the likeliest, over time, against the noise floor."""
    for (_, way), colour, style in zip(apart.items(), COLOURS[1:], STYLES[1:], strict=False):
        axes.plot(way.index * MM, way * MM, style, lw=1.2, color=LIGHT[colour])
    floor = float(record.diagnosis.residuals["sigma"].median() * MM)
    axes.axhspan(0, floor, color=LIGHT["grid"], lw=0)
    axes.annotate("noise floor", (1, floor), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8)
    axes.set(xlabel="time [ms]", ylabel="apart, at most [mm]", ylim=(0, None))
