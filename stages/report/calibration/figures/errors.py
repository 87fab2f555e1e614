"""Reprojection error view by view."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stringcast.stages.report.picture import LIGHT, Picture, vector


def errors(views: pd.DataFrame) -> Picture:
    """views: table VIEWS, those that were used to find the lens."""
    figure = Figure(figsize=(6.0, 2.8))
    axes = figure.subplots()
    places = np.arange(len(views))
    axes.bar(places - 0.2, views["rms"], 0.38, color=LIGHT["after"], label="with the lens of all views")
    axes.bar(places + 0.2, views["held_out_rms"], 0.38, color=LIGHT["before"], label="with the lens of the others")
    axes.set_xticks(places, [str(number) for number in views["view"]])
    axes.set(xlabel="view", ylabel="error / px, rms")
    axes.legend()
    return vector(figure, "Reprojection error of each view, with the lens of all views and with that of the others.")
