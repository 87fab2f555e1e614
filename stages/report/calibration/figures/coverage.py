"""Where in the picture corners were seen, and how far off each was."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from stringcast.stages.report.calibration.figures.arrows import arrows
from stringcast.stages.report.picture import LIGHT, Picture, vector

WIDTH = 6.0  # [inch]


def coverage(corners: pd.DataFrame, width: int, height: int, times: float) -> Picture:
    """corners: of all views, table CORNERS. width, height: of the pictures [px]. times: magnification of errors."""
    figure = Figure(figsize=(WIDTH, WIDTH * height / width))
    axes = figure.subplots()
    axes.plot(corners["fit_u"], corners["fit_v"], ".", ms=2, color=LIGHT["after"])
    arrows(axes, corners, times, LIGHT["before"])
    axes.set(xlim=(0, width), ylim=(height, 0), xlabel="u / px", ylabel="v / px", aspect="equal")
    return vector(figure, f"{len(corners)} corners all over the picture with their errors, {times:g} times as long.")
