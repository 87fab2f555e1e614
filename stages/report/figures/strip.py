"""Frames over the movement."""

from __future__ import annotations

import numpy as np

from stringcast.stages.report.picture import Picture, raster
from stringcast.stages.report.record import Cast, Record
from stringcast.stages.report.scene import View, draw, frame_figure
from stringcast.stages.report.words import ms

FRAMES = 6


def strip(record: Record, cast: Cast, part: View) -> list[tuple[str, Picture]]:
    """Frames evenly over the movement, each with its time; empty where nothing was filmed."""
    if not len(cast.trial.images):
        return []
    chosen = sorted({cast.frame(t) for t in np.linspace(0, cast.motion.duration, FRAMES)})
    return [(ms(cast.t[frame]), _still(record, cast, frame, part)) for frame in chosen]


def _still(record: Record, cast: Cast, frame: int, part: View) -> Picture:
    figure, axes = frame_figure(part, 1.9)
    draw(axes, record, cast, frame, part, lw=1.0)
    return raster(
        figure, f"Camera frame at {ms(cast.t[frame])} with the string as simulated before and after estimation."
    )
