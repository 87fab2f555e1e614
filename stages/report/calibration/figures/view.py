"""One picture of the board, with its corners as seen and as the camera has them."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stringcast.stages.report.calibration.figures.arrows import arrows
from stringcast.stages.report.picture import ON_FRAMES, Picture, raster

WIDTH = 3.0  # [inch]


def view(jpeg: bytes, corners: pd.DataFrame, times: float, name: str) -> Picture:
    """corners: of this picture, table CORNERS; none where it was not used. times: magnification of errors."""
    image = np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE))
    rows, columns = image.shape
    figure = Figure(figsize=(WIDTH, WIDTH * rows / columns))
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(image, cmap="gray", vmin=0, vmax=255)
    axes.axis("off")
    axes.plot(corners["u"], corners["v"], "o", ms=4, mfc="none", mec=ON_FRAMES["measured"], mew=0.8)
    axes.plot(corners["fit_u"], corners["fit_v"], "+", ms=4, color=ON_FRAMES["after"], mew=0.8)
    arrows(axes, corners, times, ON_FRAMES["before"])
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
    return raster(figure, f"{name}: {len(corners)} corners seen.")
