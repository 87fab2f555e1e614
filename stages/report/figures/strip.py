"""Frames over the movement."""

from __future__ import annotations

import cv2
import numpy as np
from matplotlib.colors import to_rgb

from stringcast.stages.report.picture import ON_FRAMES, Picture, photograph
from stringcast.stages.report.record import Cast, Record
from stringcast.stages.report.scene import View, corners, spread_levels
from stringcast.stages.report.words import ms

FRAMES = 6
WIDTH = 182  # [px] natural width of a still, drawn at twice that
FINER = 4  # fractional bits of OpenCV's coordinates


def strip(record: Record, cast: Cast, part: View) -> list[tuple[str, Picture]]:
    """Frames evenly over the movement, each with its time; empty where nothing was filmed."""
    if not len(cast.trial.images):
        return []
    chosen = sorted({cast.frame(t) for t in np.linspace(0, cast.motion.duration, FRAMES)})
    return [(ms(cast.t[frame]), _still(record, cast, frame, part)) for frame in chosen]


def _still(record: Record, cast: Cast, frame: int, part: View) -> Picture:
    """A frame with target, obstacles and strings painted into it: a tenth of what a figure of it would take."""
    scale = 2 * WIDTH / float(part.size[0])
    grey = spread_levels(part.crop(cast.trial.images[frame]), cast.levels, scale)
    image = cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)

    def paint(world: np.ndarray, name: str, closed: bool = False) -> None:
        if np.isfinite(world).all():
            colour = [round(255 * share) for share in to_rgb(ON_FRAMES[name])]
            line = np.rint(part.pixels(record.camera, world, scale) * (1 << FINER)).astype(np.int32)
            cv2.polylines(image, [line[:, None]], closed, colour, 2, cv2.LINE_AA, FINER)

    for obstacle in record.obstacles:
        paint(corners(obstacle), "wall", closed=True)
    paint(corners(record.target), "target", closed=True)
    paint(cast.before[frame], "before")
    paint(cast.after[frame], "after")
    words = f"Camera frame at {ms(cast.t[frame])} with the string as simulated before and after estimation."
    return photograph(image, words)
