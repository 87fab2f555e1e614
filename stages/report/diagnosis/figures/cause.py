"""An effect's own picture of its law."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.stages.model.effect import Effect
from stringcast.stages.report.picture import LIGHT, Picture, vector


def cause(effect: type[Effect], values: Mapping[str, float]) -> Picture:
    """The law with the values found. values: of the effect's parameters, by own names."""
    figure = Figure(figsize=(3.4, 2.5))
    axes = figure.subplots()
    effect.plot(axes, values)
    _in_theme(axes)
    return vector(figure, f"The law of {effect.name.replace('_', ' ')}: {effect.words(values)}.")


def _in_theme(axes: Axes) -> None:
    """Grey lines and black arrows in colours that have a dark side."""
    for line in axes.lines:
        if line.get_color() in ("0.6", "0.7"):
            line.set_color(LIGHT["axis"])
    for arrows in axes.collections:
        arrows.set_facecolor(LIGHT["after"])
