"""Camera and simulation at the closest approach."""

from __future__ import annotations

import numpy as np

from stringcast.stages.report.picture import ON_FRAMES, Picture, raster
from stringcast.stages.report.record import Cast, Record
from stringcast.stages.report.scene import corners, draw, frame_figure, line, millimetres, view
from stringcast.stages.report.words import mm, ms

AROUND = 0.03  # [s] of the tip's way, each side of the closest approach


def overlay(record: Record, cast: Cast) -> Picture | None:
    """The frame nearest in time, as large as hand, strings and target allow, with the tip's way through it."""
    if not len(cast.trial.images):
        return None
    frame = cast.nearest
    shown = [cast.before[frame], cast.after[frame], corners(record.target)]
    shown += [cast.measured[frame][:, :2]] if frame in cast.measured else []
    part = view(record, np.concatenate(shown))
    figure, axes = frame_figure(part, 5.4)
    draw(axes, record, cast, frame, part)
    if frame in cast.measured:
        line(axes, record, cast.measured[frame][:, :2], color=ON_FRAMES["measured"], ls="", marker=".", ms=2.5)
    way = cast.tip(cast.verdict.t + np.linspace(-AROUND, AROUND, 121))
    line(axes, record, way[np.isfinite(way).all(axis=1)], color=ON_FRAMES["measured"], lw=0.9, ls=(0, (2, 2)))
    line(axes, record, cast.tip(np.array([cast.verdict.t])), color=ON_FRAMES["ink"], marker="o", ms=8, mfc="none")
    millimetres(axes, record, part)
    return raster(figure, _alt(cast, frame))


def _alt(cast: Cast, frame: int) -> str:
    known = np.isfinite(cast.verdict.distance)
    closest = f"{mm(cast.verdict.distance)} from its centre at {ms(cast.verdict.t, 1)}" if known else "never seen"
    return (
        f"Camera frame at {ms(cast.t[frame])}, with the target box and the string as measured and as simulated "
        f"before and after estimation. The tip is {closest}."
    )
