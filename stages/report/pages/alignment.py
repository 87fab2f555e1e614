"""The page of an alignment: parameters of camera and clock, and how well they fit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib import style
from matplotlib.figure import Figure as Drawing

from stringcast.data.alignment import Alignment
from stringcast.stages.common import MM_PER_M
from stringcast.stages.report.charts.axes import new_axes
from stringcast.stages.report.formatting import format_mm
from stringcast.stages.report.page import stage_page
from stringcast.stages.report.parts import (
    Card,
    Cell,
    Figure,
    Section,
    TableView,
    Text,
    Tiles,
    number_cells,
)
from stringcast.stages.report.records import StageRecord
from stringcast.stages.report.theme import MS_PER_S, STYLE_SHEET, Picture, svg_picture

MAX_DRAWN_DEVIANCE = 25.0
DEVIANCE_95 = 3.84  # at the ends of a 95 % interval
STATES = ("before", "after")  # alignment
MILLI_UNITS = {"s": "ms", "m": "mm", "rad": "mrad", "1": "‰"}


def alignment_page(facts: StageRecord) -> str:
    """Render the page of an alignment."""
    alignment: Alignment = facts.artifact
    with style.context(STYLE_SHEET):
        sections = [
            _tiles(alignment),
            _parameters_section(alignment),
            _fit_section(alignment),
        ]
    heading = "Camera and clock, measured against the arm"
    return stage_page(facts, "alignment", sections, heading)


def _tiles(alignment: Alignment) -> Tiles:
    row = alignment.aligned.iloc[0]
    change = f"{format_mm(row['rms_before'], 2)} → {format_mm(row['rms_after'], 2)}"
    noise = format_mm(row["noise"], 2)
    meaning = f"rms of reported minus filmed, before and after; noise alone: {noise}"
    frames = alignment.seen[["trial", "t"]].drop_duplicates()
    return Tiles(
        [
            (change, meaning),
            (str(len(frames)), "frames in which the arm was read"),
            (f"{row['speed']:.2f} m/s", "highest speed of the hand"),
        ]
    )


def _parameters_section(alignment: Alignment) -> Section:
    lead = Markup(
        "Intervals are 95 %, from leaving out blocks of time in turn. "
        "<code>model_from=&lt;this folder&gt;</code> applies the alignment in any "
        "other experiment."
    )
    columns = ("parameter", "meaning", "value", "from", "to", "part of the alignment")
    rows = []
    for row in alignment.measured.to_dict("records"):
        unit = MILLI_UNITS[row["unit"]]
        values = [
            f"{1e3 * row[column]:.3f} {unit}" for column in ("value", "low", "high")
        ]
        is_part = "yes" if row["found"] else "no: not significant"
        name = Cell(row["name"], "code")
        rows.append([name, row["meaning"], *number_cells(values), is_part])
    table = Card("", [TableView(columns, rows, named=True)])
    return Section("Parameters", [Text(lead), table])


def _fit_section(alignment: Alignment) -> Section:
    figures = [
        Figure(
            "Certainty of the clock offset",
            _likelihood_picture(alignment.likelihood),
            "Without a lag of the arm, and with a fitted one. Where both curves are "
            "low, offset and lag cannot be distinguished.",
        ),
        Figure(
            "Reported minus filmed over time",
            _residuals_picture(alignment.seen),
            "Before and after. The rest must be noise without a pattern.",
        ),
    ]
    return Section("Fit", figures)


# --- pictures
def _residuals_picture(seen: pd.DataFrame) -> Picture:
    """Draw reported minus filmed positions over time, for all trials on one clock."""
    figure = Drawing(figsize=(7.2, 3.4))
    panels = figure.subplots(2, 1, sharex=True)
    for axes, state in zip(panels, STATES, strict=True):
        residual = seen[state] * MM_PER_M
        style: dict[str, Any] = {"ms": 1.2, "color": state, "alpha": 0.5}
        axes.plot(seen["t"], residual, ".", rasterized=True, **style)
        axes.axhline(0.0, lw=0.6, color="axis")
        axes.set_ylabel(f"{state} [mm]")
    limit = 1.5 * float(np.quantile(np.abs(seen["after"]), 0.995)) * MM_PER_M
    axes.set(xlabel="time on the camera's clock [s]", ylim=(-limit, limit))
    return svg_picture(
        figure, "Reported minus filmed over time, before and after alignment."
    )


def _likelihood_picture(table: pd.DataFrame) -> Picture:
    """Draw the profile likelihood of the offset, with and without a lag of the arm."""
    figure, axes = new_axes(4.4, 3.2)
    curves = (("alone", "no lag", "before"), ("with_lag", "the arm may lag", "after"))
    for column, label, colour in curves:
        drawn = table[table[column] < 2 * MAX_DRAWN_DEVIANCE]
        offset = drawn["offset"] * MS_PER_S
        axes.plot(offset, drawn[column], ".-", color=colour, label=label)
    axes.axhline(DEVIANCE_95, ls="--", lw=0.8, color="axis", label="95 %")
    axes.set(
        xlabel="arm's clock minus camera's clock [ms]", ylabel="rise of the deviance"
    )
    axes.set_ylim(0, MAX_DRAWN_DEVIANCE)
    axes.legend(loc="best")
    inside = table.loc[table["with_lag"] <= DEVIANCE_95, "offset"] * MS_PER_S
    words = (
        f"With a lag allowed, offsets from {inside.min():.2f} to {inside.max():.2f} ms "
        "fit about equally well."
    )
    return svg_picture(figure, words)
