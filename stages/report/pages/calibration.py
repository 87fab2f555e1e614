"""The page of a calibration: what was measured of a camera, and by what."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from stringcast.data.calibration import Calibration
from stringcast.stages.common import rms
from stringcast.stages.report.formatting import unit
from stringcast.stages.report.page import (
    Card,
    Cell,
    Figure,
    Grid,
    Page,
    Section,
    Small,
    Table,
    Text,
    Tile,
    Tiles,
    bold,
    joined,
    number,
)
from stringcast.stages.report.records import StageRecord
from stringcast.stages.report.theme import (
    LIGHT_COLOURS,
    ON_FRAMES,
    STYLE_SHEET,
    Picture,
    raster,
    vector,
)


def calibration_page(facts: StageRecord) -> str:
    """The page as text; the same record gives the same page."""
    made: Calibration = facts.artifact
    outcome = made.outcome.iloc[0]
    tilted = made.corners[~made.corners["plane"]]
    times = magnified(tilted, outcome["width"])
    with style.context(STYLE_SHEET):
        sections = [tiles(outcome), camera(made, tilted, times), views(made, times)]

    used = int((made.views["reason"] == "").sum()) - 1  # one is that in the plane
    pictures = (
        f"{used} of {len(made.views) - 1} pictures of the tilted board were used, "
    )
    pictures += f"{outcome['width']} × {outcome['height']} px."
    kept = "<code>camera.yaml</code> beside this page holds the camera; other experiments take it by "
    kept += "<code>calibrated=</code> and this folder."
    where = Markup(
        kept if outcome["valid"] else "No <code>camera.yaml</code> was written."
    )
    return str(
        Page(
            title=f"{facts.name}: {facts.sentence}",
            kicker=f"stringcast calibration · {facts.name}",
            heading=facts.sentence,
            lead=joined([pictures, where]),
            sections=sections,
            origin=facts.provenance,
            settings=facts.settings,
            tone="good" if outcome["valid"] else "bad",
            marked=True,
        )
    )


def tiles(outcome: Any) -> Tiles:
    """Tiles: reprojection errors, and the share of the picture that corners cover."""
    seen = "from corners as seen to corners as the camera has them, root mean square"
    return Tiles(
        [
            Tile(f"{outcome['rms']:.2f} px", seen),
            Tile(
                f"{outcome['held_out_rms']:.2f} px",
                "the same for views that the lens was not fitted to",
            ),
            Tile(f"{outcome['plane_rms']:.2f} px", "the same in the plane of motion"),
            Tile(
                f"{100 * outcome['coverage']:.0f} %",
                "of the picture had a corner in it",
            ),
            Tile(
                f"{np.degrees(outcome['spread']):.0f}°",
                "is the largest angle between two views of the board",
            ),
        ]
    )


def camera(made: Calibration, tilted: pd.DataFrame, times: float) -> Section:
    """The camera's parameters, and the errors over the picture and view by view."""
    outcome = made.outcome.iloc[0]
    columns = ("parameter", "value ± one standard deviation", "unit", "what it is")
    rows = []
    for row in made.measured.to_dict("records"):
        # as many decimals as its uncertainty allows
        decimals = (
            max(int(np.ceil(1 - np.log10(row["sigma"]))), 0) if row["sigma"] > 0 else 6
        )
        value = number(f"{row['value']:.{decimals}f} ± {row['sigma']:.{decimals}f}")
        rows.append(
            (
                Cell(f"camera.{row['name']}", "code"),
                value,
                unit(row["unit"]),
                row["meaning"],
            )
        )
    arrows = f"Each corner of each view, with its error {times:g} times as long. Arrows that point the same way side "
    arrows += "by side are not noise: the lens, or the board, is not as assumed."
    bars = "A view that stands out was blurred or bent. Where orange is far above blue, views are too few."
    over = coverage(tilted, outcome["width"], outcome["height"], times)
    by_view = errors(made.views[~made.views["plane"] & (made.views["reason"] == "")])
    grid = [
        Figure("Errors over the picture", over, arrows),
        Figure("Errors view by view", by_view, bars),
    ]
    return Section("The camera", [Card("", [Table(columns, rows)]), Grid(grid)])


def views(made: Calibration, times: float) -> Section:
    """Every picture of the board, that in the plane first."""
    lead = f"Circles: corners as seen. Crosses: as the camera has them. Arrows: the errors, {times:g} times as long."
    shown = []
    for row in made.views.sort_values(
        "plane", ascending=False, kind="stable"
    ).itertuples():
        name = "in the plane of motion" if row.plane else f"view {row.view}"
        corners = made.corners[
            (made.corners["view"] == row.view) & (made.corners["plane"] == row.plane)
        ]
        words = row.reason or f"{row.rms:.2f} px, tilted by {np.degrees(row.tilt):.0f}°"
        shown.append(
            (joined([bold(name), "·", words]), view(row.picture, corners, times, name))
        )
    return Section("Views", [Text(lead), Card("", [Small(shown)])])


# --- pictures
LENGTH = 0.04  # of the picture's width, of an arrow that is as long as the usual error


def magnified(corners: pd.DataFrame, width: int) -> float:
    """The factor by which errors are magnified: a round number that makes them seen.
    width: of the pictures [px].
    """
    errors = np.hypot(corners["u"] - corners["fit_u"], corners["v"] - corners["fit_v"])
    ideal = LENGTH * width / max(rms(errors.to_numpy()), 1e-6)
    step = 10.0 ** np.floor(np.log10(ideal))
    return float(step * max(s for s in (1, 2, 5) if s * step <= ideal))


def arrows(axes: Axes, corners: pd.DataFrame, times: float, colour: str) -> None:
    """Arrows from the projection of each corner towards where it was seen."""
    shift = corners[["u", "v"]].to_numpy() - corners[["fit_u", "fit_v"]].to_numpy()
    at, along = (corners["fit_u"], corners["fit_v"]), (times * shift).T
    axes.quiver(
        *at, *along, color=colour, angles="xy", scale_units="xy", scale=1, width=0.004
    )


WHOLE = 6.0  # [inch]


def coverage(corners: pd.DataFrame, width: int, height: int, times: float) -> Picture:
    """corners: of all views, table CORNERS. width, height: of the pictures [px]. times:
    magnification of errors.
    """
    figure = Drawing(figsize=(WHOLE, WHOLE * height / width))
    axes = figure.subplots()
    axes.plot(
        corners["fit_u"], corners["fit_v"], ".", ms=2, color=LIGHT_COLOURS["after"]
    )
    arrows(axes, corners, times, LIGHT_COLOURS["before"])
    axes.set(
        xlim=(0, width),
        ylim=(height, 0),
        xlabel="u / px",
        ylabel="v / px",
        aspect="equal",
    )
    return vector(
        figure,
        f"{len(corners)} corners all over the picture with their errors, {times:g} times as long.",
    )


def errors(views: pd.DataFrame) -> Picture:
    """views: table VIEWS, those that were used to find the lens."""
    figure = Drawing(figsize=(6.0, 2.8))
    axes = figure.subplots()
    places = np.arange(len(views))
    axes.bar(
        places - 0.2,
        views["rms"],
        0.38,
        color=LIGHT_COLOURS["after"],
        label="with the lens of all views",
    )
    axes.bar(
        places + 0.2,
        views["held_out_rms"],
        0.38,
        color=LIGHT_COLOURS["before"],
        label="with the lens of the others",
    )
    axes.set_xticks(places, [str(number) for number in views["view"]])
    axes.set(xlabel="view", ylabel="error / px, rms")
    axes.legend()
    return vector(
        figure,
        "Reprojection error of each view, with the lens of all views and with that of the others.",
    )


ONE = 3.0  # [inch]


def view(jpeg: bytes, corners: pd.DataFrame, times: float, name: str) -> Picture:
    """corners: of this picture, table CORNERS; none where it was not used. times:
    magnification of errors.
    """
    image = np.asarray(
        cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    )
    rows, columns = image.shape
    figure = Drawing(figsize=(ONE, ONE * rows / columns))
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(image, cmap="gray", vmin=0, vmax=255)
    axes.axis("off")
    axes.plot(
        corners["u"],
        corners["v"],
        "o",
        ms=4,
        mfc="none",
        mec=ON_FRAMES["measured"],
        mew=0.8,
    )
    axes.plot(
        corners["fit_u"], corners["fit_v"], "+", ms=4, color=ON_FRAMES["after"], mew=0.8
    )
    arrows(axes, corners, times, ON_FRAMES["before"])
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
    return raster(figure, f"{name}: {len(corners)} corners seen.")
