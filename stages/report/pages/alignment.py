"""The page of an alignment: what was measured, how well, and what looks alike."""

from __future__ import annotations

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib import style
from matplotlib.figure import Figure as Drawing

from stringcast.data.alignment import Alignment
from stringcast.stages.report.formatting import mm
from stringcast.stages.report.page import (
    Card,
    Cell,
    Figure,
    Grid,
    Page,
    Section,
    Table,
    Text,
    Tile,
    Tiles,
    number,
)
from stringcast.stages.report.records import StageRecord
from stringcast.stages.report.theme import (
    LIGHT_COLOURS,
    MM_PER_M,
    STYLE_SHEET,
    Picture,
    vector,
)

WORST = 25.0  # rise of the deviance up to which it is drawn
END = 3.84  # of a 95 % interval
SHARES = ("before", "after")
# units that people think of
THOUSANDTHS = {"s": "ms", "m": "mm", "rad": "mrad", "1": "‰"}


def alignment_page(facts: StageRecord) -> str:
    """The page as text; the same facts give the same page."""
    made: Alignment = facts.artifact
    with style.context(STYLE_SHEET):
        sections = [tiles(made), measured(made), fit(made)]
    return str(
        Page(
            title=f"{facts.name}: camera and clock against the arm",
            kicker=f"stringcast alignment · {facts.name}",
            heading="Camera and clock, measured against the arm",
            lead=facts.sentence,
            sections=sections,
            origin=facts.provenance,
            settings=facts.settings,
        )
    )


def tiles(made: Alignment) -> Tiles:
    """Tiles: the residual, the number of frames, the speed."""
    how = made.aligned.iloc[0]
    near = (
        "root mean square of reported less seen, before and after; noise alone would leave "
        + mm(how["noise"], 2)
    )
    return Tiles(
        [
            Tile(f"{mm(how['rms_before'], 2)} → {mm(how['rms_after'], 2)}", near),
            Tile(
                str(len(made.seen[["trial", "t"]].drop_duplicates())),
                "frames in which the arm was read",
            ),
            Tile(f"{how['speed']:.2f} m/s", "fastest that the hand moved"),
        ]
    )


def measured(made: Alignment) -> Section:
    """Each parameter with its interval."""
    lead = Markup(
        "Intervals are of 95 %, by leaving out blocks of time in turn. <code>extended=&lt;this folder&gt;</code> "
        "makes any other experiment take what is part of the alignment as measured."
    )
    columns = ("parameter", "meaning", "value", "from", "to", "part of the alignment")
    rows = []
    for row in made.measured.to_dict("records"):
        values = [
            number(f"{1e3 * row[of]:.3f} {THOUSANDTHS[row['unit']]}")
            for of in ("value", "low", "high")
        ]
        found = "yes" if row["found"] else "looked for, not seen"
        rows.append([Cell(row["name"], "code"), row["meaning"], *values, found])
    return Section(
        "What was measured", [Text(lead), Card("", [Table(columns, rows, named=True)])]
    )


def fit(made: Alignment) -> Section:
    """Seen and reported, and how sure the clocks are."""
    alike = "Without a lag of the arm, and with one that is fitted along. Where both are low, an offset and a lag "
    alike += "cannot be told apart."
    outer = "Middle of the last link where it is furthest out. What is reported shall lie on what is seen."
    grid = [Figure("Seen and reported", places(made.seen), outer)]
    grid += [Figure("How sure the clocks are", likelihood(made.likelihood), alike)]
    left = "Before and after. What is left shall be noise, without a pattern."
    return Section(
        "How well it fits",
        [
            Grid(grid),
            Figure("Reported less seen over time", residuals(made.seen), left),
        ],
    )


# --- pictures
def places(seen: pd.DataFrame) -> Picture:
    """The outermost piece that was sighted, frame by frame: where it was seen, and
    reported before and after.
    """
    outer = (
        seen[seen["link"] == seen["link"].max()]
        .sort_values("share")
        .groupby(["trial", "t"])
        .tail(2)
    )
    figure = Drawing(figsize=(4.4, 4.0))
    axes = figure.subplots()
    for way in SHARES:
        x, y = (outer[c] + outer[way] * outer[f"along_{c}"] for c in "xy")
        axes.plot(
            x * MM_PER_M,
            y * MM_PER_M,
            ".",
            ms=2.5,
            color=LIGHT_COLOURS[way],
            label=f"reported, {way}",
        )
    axes.plot(
        outer["x"] * MM_PER_M,
        outer["y"] * MM_PER_M,
        ".",
        ms=1.2,
        color=LIGHT_COLOURS["measured"],
        label="seen",
    )
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    axes.legend(loc="best", markerscale=3)
    rms = [float(np.sqrt(np.mean(outer[way] ** 2))) * MM_PER_M for way in SHARES]
    return vector(
        figure,
        f"The hand as seen and as reported: {rms[0]:.2f} mm apart before, {rms[1]:.2f} mm after.",
    )


def residuals(seen: pd.DataFrame) -> Picture:
    """Reported less seen over time, all trials on one clock."""
    figure = Drawing(figsize=(7.2, 3.4))
    panels = figure.subplots(2, 1, sharex=True)
    for axes, way in zip(panels, SHARES, strict=True):
        axes.plot(
            seen["t"],
            seen[way] * MM_PER_M,
            ".",
            ms=1.2,
            color=LIGHT_COLOURS[way],
            alpha=0.5,
            rasterized=True,
        )
        axes.axhline(0.0, lw=0.6, color=LIGHT_COLOURS["axis"])
        axes.set_ylabel(f"{way} [mm]")
    most = float(np.quantile(np.abs(seen["after"]), 0.995)) * MM_PER_M
    panels[1].set(
        xlabel="time by the camera's clock [s]", ylim=(-1.5 * most, 1.5 * most)
    )
    return vector(
        figure,
        "Reported less seen over time, as if camera and arm were aligned, and aligned.",
    )


def likelihood(table: pd.DataFrame) -> Picture:
    """The profile likelihood of the offset, with and without a lag of the arm."""
    figure = Drawing(figsize=(4.4, 3.2))
    axes = figure.subplots()
    for name, words, colour in (
        ("alone", "no lag", "before"),
        ("with_lag", "the arm may lag", "after"),
    ):
        drawn = table[table[name] < 2 * WORST]
        axes.plot(
            drawn["offset"] * MM_PER_M,
            drawn[name],
            ".-",
            color=LIGHT_COLOURS[colour],
            label=words,
        )
    axes.axhline(END, ls="--", lw=0.8, color=LIGHT_COLOURS["axis"], label="95 %")
    axes.set(
        xlabel="arm's clock less the camera's [ms]",
        ylabel="rise of the deviance",
        ylim=(0, WORST),
    )
    axes.legend(loc="best")
    inside = table[table["with_lag"] <= END]["offset"] * MM_PER_M
    said = f"With a lag allowed, offsets from {inside.min():.2f} to {inside.max():.2f} ms fit about as well."
    return vector(figure, said)
