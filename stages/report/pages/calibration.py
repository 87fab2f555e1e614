"""The page of a calibration: parameters of a camera, and the errors of each view."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from stringcast.data.calibration import Calibration
from stringcast.data.lazy_module import LazyModule
from stringcast.stages.common import rms
from stringcast.stages.report.charts.axes import new_axes
from stringcast.stages.report.formatting import unit_markup
from stringcast.stages.report.page import stage_page
from stringcast.stages.report.parts import (
    Card,
    Cell,
    Figure,
    Section,
    Small,
    Text,
    Tiles,
    bold_text,
    join_sentences,
    number_cell,
    table_card,
)
from stringcast.stages.report.records import StageRecord
from stringcast.stages.report.theme import (
    FRAME_COLOURS,
    STYLE_SHEET,
    Picture,
    svg_picture,
    webp_picture,
)

cv2 = LazyModule("cv2")

ARROW_SHARE = 0.04  # length of an rms error's arrow, as a share of the picture's width
COVERAGE_WIDTH_IN = 6.0
VIEW_WIDTH_IN = 3.0


def calibration_page(facts: StageRecord) -> str:
    """Render the page of a calibration."""
    calibration: Calibration = facts.artifact
    outcome = calibration.outcome.iloc[0]
    tilted = calibration.corners[~calibration.corners["plane"]]
    magnification = _error_magnification(tilted, outcome["width"])
    with style.context(STYLE_SHEET):
        sections = [
            _tiles(outcome),
            _camera_section(calibration, tilted, magnification),
            _views_section(calibration, magnification),
        ]

    used = int((calibration.views["reason"] == "").sum()) - 1  # without the plane's
    pictures = (
        f"{used} of {len(calibration.views) - 1} pictures of the tilted board were "
        f"used, {outcome['width']} × {outcome['height']} px."
    )
    result = Markup("No <code>camera.yaml</code> was written.")
    if outcome["valid"]:
        result = Markup(
            "<code>camera.yaml</code> in this folder holds the camera; other "
            "experiments use it by <code>camera_from=</code> and this folder."
        )
    lead = join_sentences([pictures, result])
    tone = "good" if outcome["valid"] else "bad"
    return stage_page(facts, "calibration", sections, lead=lead, tone=tone)


def _tiles(outcome: Any) -> Tiles:
    return Tiles(
        [
            (f"{outcome['rms']:.2f} px", "reprojection error of the corners, rms"),
            (
                f"{outcome['held_out_rms']:.2f} px",
                "the same on views left out of the fit",
            ),
            (f"{outcome['plane_rms']:.2f} px", "the same in the plane of motion"),
            (f"{100 * outcome['coverage']:.0f} %", "of the picture contained a corner"),
            (
                f"{np.degrees(outcome['spread']):.0f}°",
                "largest angle between two views",
            ),
        ]
    )


def _camera_section(
    calibration: Calibration, tilted: pd.DataFrame, magnification: float
) -> Section:
    columns = ("parameter", "value ± one standard deviation", "unit", "meaning")
    rows = []
    for row in calibration.measured.to_dict("records"):
        value, sigma = row["value"], row["sigma"]
        # as many decimals as the uncertainty allows
        decimals = max(int(np.ceil(1 - np.log10(sigma))), 0) if sigma > 0 else 6
        name = Cell(f"camera.{row['name']}", "code")
        value = number_cell(f"{value:.{decimals}f} ± {sigma:.{decimals}f}")
        rows.append((name, value, unit_markup(row["unit"]), row["meaning"]))
    figure = Figure(
        "Errors over the picture",
        _coverage_picture(tilted, calibration.outcome.iloc[0], magnification),
        f"Each corner of each view, with its error enlarged {magnification:g} "
        "times. If neighbouring arrows point the same way, the errors are not "
        "noise: the model of the lens or the board is wrong.",
    )
    return Section("Camera", [table_card(columns, rows), figure])


def _views_section(calibration: Calibration, magnification: float) -> Section:
    """Show all pictures of the board; the one in the plane of motion is the first."""
    lead = (
        "Circles: corners as detected. Crosses: as the camera model projects them. "
        f"Arrows: the errors, enlarged {magnification:g} times. A view with a large "
        "error was blurred or the board was bent. If errors of views left out of the "
        "fit are far larger, there are too few views."
    )
    views = calibration.views.sort_values("plane", ascending=False, kind="stable")
    corners = calibration.corners
    pictures = []
    for row in views.itertuples():
        name = "in the plane of motion" if row.plane else f"view {row.view}"
        is_view = (corners["view"] == row.view) & (corners["plane"] == row.plane)
        picture = _view_picture(row.picture, corners[is_view], magnification, name)
        result = row.reason
        if not result:
            result = f"{row.rms:.2f} px, tilted by {np.degrees(row.tilt):.0f}°"
            if not row.plane:
                result += f"; {row.held_out_rms:.2f} px if left out of the fit"
        pictures.append((join_sentences([bold_text(name), "·", result]), picture))
    return Section("Views", [Text(lead), Card("", [Small(pictures)])])


# --- pictures
def _error_magnification(corners: pd.DataFrame, width: int) -> float:
    """Return a round factor that makes errors visible in a picture of a width [px]."""
    errors = corners[["u", "v"]].to_numpy() - corners[["fit_u", "fit_v"]].to_numpy()
    ideal = ARROW_SHARE * width / max(rms(np.hypot(*errors.T)), 1e-6)
    power = 10.0 ** np.floor(np.log10(ideal))
    return float(power * max(step for step in (1, 2, 5) if step * power <= ideal))


def _draw_error_arrows(
    axes: Axes, corners: pd.DataFrame, magnification: float, colour: str
) -> None:
    """Draw arrows from each projected corner towards the detected one."""
    u, v = corners["fit_u"], corners["fit_v"]
    du, dv = magnification * (corners["u"] - u), magnification * (corners["v"] - v)
    axes.quiver(
        u, v, du, dv, color=colour, angles="xy", scale_units="xy", scale=1, width=0.004
    )


def _coverage_picture(
    corners: pd.DataFrame, outcome: Any, magnification: float
) -> Picture:
    width, height = outcome["width"], outcome["height"]
    figure, axes = new_axes(COVERAGE_WIDTH_IN, COVERAGE_WIDTH_IN * height / width)
    axes.plot(corners["fit_u"], corners["fit_v"], ".", ms=2, color="after")
    _draw_error_arrows(axes, corners, magnification, "before")
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    axes.set(xlabel="u / px", ylabel="v / px")
    words = (
        f"{len(corners)} corners over the picture; errors enlarged {magnification:g} "
        "times."
    )
    return svg_picture(figure, words)


def _view_picture(
    jpeg: bytes, corners: pd.DataFrame, magnification: float, name: str
) -> Picture:
    """Draw a picture of the board with its corners, if it was used."""
    content = np.frombuffer(jpeg, np.uint8)
    image = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE)
    rows, columns = image.shape
    figure = Drawing(figsize=(VIEW_WIDTH_IN, VIEW_WIDTH_IN * rows / columns))
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(image, cmap="gray", vmin=0, vmax=255)
    axes.axis("off")
    marks: dict[str, Any] = {"ms": 4, "mew": 0.8, "mfc": "none", "ls": ""}
    detected, projected = FRAME_COLOURS["measured"], FRAME_COLOURS["after"]
    axes.plot(corners["u"], corners["v"], marker="o", color=detected, **marks)
    axes.plot(corners["fit_u"], corners["fit_v"], marker="+", color=projected, **marks)
    _draw_error_arrows(axes, corners, magnification, FRAME_COLOURS["before"])
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
    return webp_picture(figure, f"{name}: {len(corners)} corners detected.")
