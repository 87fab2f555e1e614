"""How far the simulated string is from the measured one, over arc length and time."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from stringcast.stages.report.figures.timeline import mark_movement
from stringcast.stages.report.picture import LIGHT, MM, Picture, framed, vector
from stringcast.stages.report.record import Cast, Record
from stringcast.stages.report.words import mm

CELLS = 30  # along the string


def residual(record: Record, cast: Cast) -> Picture | None:
    """Above, where and when, after estimation; below, over the whole string, before and after."""
    if not cast.measured:
        return None
    before, after = (residuals(record, cast, simulated) for simulated in (cast.before, cast.after))
    figure = framed(5.4, 3.7)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    _map((top, bottom), record, cast, after)
    for name, table in (("before", before), ("after", after)):
        bottom.plot(cast.t * MM, _rms(table, cast) * MM, color=LIGHT[name], label=f"{name} estimation")
    mark_movement(bottom, cast)
    bottom.set(xlabel="time [ms]", ylabel="RMS [mm]", ylim=(0, None))
    figure.legend(*bottom.get_legend_handles_labels(), loc="upper left", ncols=3)
    whole = [mm(float(np.sqrt(np.mean(table["away"] ** 2))), 1) for table in (before, after)]
    return vector(
        figure, f"Distance of the simulated from the measured string: RMS {whole[0]} before, {whole[1]} after."
    )


def residuals(record: Record, cast: Cast, simulated: np.ndarray) -> pd.DataFrame:
    """Table of frame, s [m] and away [m]: each measured point's distance from the simulated string (F, n, 2)
    at the same arc length."""
    frame = np.repeat(list(cast.measured), [len(line) for line in cast.measured.values()])
    x, y, s = np.concatenate(list(cast.measured.values())).T
    place = np.clip(s / record.string.segment, 0, record.string.points - 1)
    first = np.minimum(place.astype(int), record.string.points - 2)
    share = (place - first)[:, None]
    there = (1 - share) * simulated[frame, first] + share * simulated[frame, first + 1]
    return pd.DataFrame({"frame": frame, "s": s, "away": np.hypot(*(there - np.stack([x, y], axis=-1)).T)})


def _map(panels: tuple[Axes, Axes], record: Record, cast: Cast, table: pd.DataFrame) -> None:
    """Mean distance in cells of arc length and frame, in the upper panel; frames not read stay empty."""
    axes = panels[0]
    half = np.median(np.diff(cast.t)) / 2 if len(cast.t) > 1 else cast.motion.duration
    moments = np.append(cast.t - half, cast.t[-1] + half)
    edges = np.linspace(0, max(record.string.length, table["s"].max()), CELLS + 1)
    places = (table["s"], cast.t[table["frame"]])
    total, count = (np.histogram2d(*places, (edges, moments), weights=w)[0] for w in (table["away"], None))
    with np.errstate(invalid="ignore"):
        cells = total / count
    drawn = axes.pcolorfast(moments * MM, edges * MM, cells * MM, cmap="viridis", vmin=0)
    axes.grid(visible=False)
    axes.set_ylabel("arc length [mm]")
    assert axes.figure is not None
    axes.figure.colorbar(drawn, ax=panels, aspect=30, label="distance [mm]", pad=0.02)


def _rms(table: pd.DataFrame, cast: Cast) -> np.ndarray:
    """(F,) root mean square over the string, NaN where the frame was not read."""
    squares = (table["away"] ** 2).groupby(table["frame"]).mean()
    return np.sqrt(squares.reindex(range(len(cast.t))).to_numpy())
