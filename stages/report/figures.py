"""The figures of the report, each a function from artifacts to a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from data.artifacts import JOINTS
from stages.generate import Box
from stages.report.record import Cast, Record

mpl.rcParams |= {
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a94a6",
    "axes.labelcolor": "#3b4252",
    "svg.fonttype": "none",
    "legend.frameon": False,
}
# Okabe and Ito's colours, told apart by everyone.
BEFORE, AFTER, REAL, TARGET, WALL = "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#777777"
STRIP = 6
MM = 1e3


def overlay(record: Record, cast: Cast) -> Figure:
    """Simulation and camera at the closest approach."""
    figure = Figure(figsize=(5.6, 5.2), layout="constrained")
    axes = figure.subplots()
    _scene(axes, record, cast, cast.nearest)
    axes.legend(loc="lower left", fontsize=8, labelcolor="white")
    t = cast.trial.frames["t"].iloc[cast.nearest]
    axes.set_title(f"t = {t * 1e3:.0f} ms", fontsize=9)
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    return figure


def strip(record: Record, cast: Cast) -> Figure:
    """Frames over the movement, with the simulated strings."""
    figure = Figure(figsize=(11, 2.1), layout="constrained")
    t = cast.trial.frames["t"].to_numpy()
    wanted = np.linspace(0, cast.motion.duration, STRIP)
    for axes, moment in zip(figure.subplots(1, STRIP), wanted, strict=True):
        frame = int(np.argmin(np.abs(t - moment)))
        _scene(axes, record, cast, frame)
        axes.set_title(f"{t[frame] * 1e3:.0f} ms", fontsize=8)
        axes.set_axis_off()
    return figure


def matching(cast: Cast) -> Figure:
    """E over time, before and after estimation."""
    figure = Figure(figsize=(5.6, 2.6), layout="constrained")
    axes = figure.subplots()
    if cast.estimate is not None:
        table = cast.estimate.matching
        axes.plot(table["t"], table["before"], color=BEFORE, label="before")
        axes.plot(table["t"], table["after"], color=AFTER, label="after")
    axes.axvspan(0, cast.motion.duration, color="#8a94a6", alpha=0.12, lw=0)
    if np.isfinite(cast.verdict.t):
        axes.axvline(cast.verdict.t, color=TARGET, lw=1, ls="--", label="closest approach")
    axes.set(xlabel="time [s]", ylabel="matching rate $E_f$", ylim=(0, 1.02))
    axes.legend(fontsize=8, ncols=3, loc="lower center")
    return figure


def residual(record: Record, cast: Cast) -> Figure:
    """Distance between simulated and measured centre-line over arc length and time, after estimation."""
    figure = Figure(figsize=(5.6, 2.6), layout="constrained")
    axes = figure.subplots()
    points = cast.points.points
    if not points.empty:
        t = cast.trial.frames["t"].to_numpy()
        frame = np.searchsorted(t, points["t"].to_numpy() - 1e-9)
        s = record.string.arc_lengths()
        there = np.stack([_along(s, cast.after[f], x) for f, x in zip(frame, points["s"], strict=True)])
        away = np.linalg.norm(there - points[["x", "y"]].to_numpy(), axis=1) * MM
        drawn = axes.scatter(points["t"], points["s"] * MM, c=away, s=2, marker="s", cmap="viridis", rasterized=True)
        figure.colorbar(drawn, ax=axes, label="residual [mm]")
    axes.set(xlabel="time [s]", ylabel="arc length [mm]")
    return figure


def joints(cast: Cast) -> Figure:
    """Joint angles, commanded and measured."""
    figure = Figure(figsize=(5.6, 2.6), layout="constrained")
    axes = figure.subplots()
    for number, joint in enumerate(JOINTS):
        colour = (AFTER, BEFORE, REAL)[number]
        axes.plot(cast.motion.commands["t"], np.degrees(cast.motion.commands[joint]), color=colour, lw=1, ls="--")
        axes.plot(cast.trial.arm["t"], np.degrees(cast.trial.arm[joint]), color=colour, label=joint)
    axes.set(xlabel="time [s]", ylabel="angle [deg]")
    axes.legend(fontsize=8, ncols=3, title="dashed: commanded, solid: measured", title_fontsize=8)
    return figure


def trajectory(record: Record) -> Figure:
    """The hand's way in each manipulation."""
    figure = Figure(figsize=(5.6, 4.6), layout="constrained")
    axes = figure.subplots()
    for number, cast in enumerate(record.casts, start=1):
        way = cast.hand(record.arm) * MM
        axes.plot(*way.T, color=mpl.colormaps["viridis"](number / (len(record.casts) + 1)), label=f"cast {number}")
        axes.plot(*way[0], "o", ms=4, color="#3b4252")
    _boxes(axes, record)
    axes.plot(*np.array(record.arm.base) * MM, "s", color="#3b4252", label="arm's base")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    axes.legend(fontsize=8)
    return figure


def parameters(record: Record) -> Figure:
    """Each parameter over the manipulations, within its range."""
    known = record.string.parameters
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    panels = np.atleast_2d(figure.subplots(2, -(-len(known) // 2), sharex=True)).ravel()
    for axes, parameter in zip(panels, known, strict=False):
        rows = [e.parameters.set_index("name").loc[parameter.name] for e in record.estimates]
        number = np.arange(1, len(rows) + 1)
        value = [row["value"] for row in rows]
        axes.axhspan(parameter.low, parameter.high, color="#8a94a6", alpha=0.12, lw=0)
        axes.plot([0, *number], [parameter.start, *value], color=AFTER, lw=1)
        for n, row in zip(number, rows, strict=True):
            axes.plot([n, n], [row["low"], row["high"]], color=AFTER, lw=4, alpha=0.3)
            axes.plot(n, row["value"], "o", ms=5, color=AFTER, mfc=AFTER if row["determined"] else "white")
        axes.set_yscale("log" if parameter.low > 0 else "linear")
        axes.set_title(f"{parameter.symbol or parameter.name} [{parameter.unit}]", fontsize=8)
        axes.set_xticks([0, *number])
    return figure


def _scene(axes: Axes, record: Record, cast: Cast, frame: int) -> None:
    """A camera frame in millimetres, with everything that is known of it drawn on top."""
    camera = record.camera
    corners = camera.world(np.array([[-0.5, camera.height - 0.5], [camera.width - 0.5, -0.5]])) * MM
    extent = (corners[0, 0], corners[1, 0], corners[0, 1], corners[1, 1])
    axes.imshow(cast.trial.images[frame], cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="nearest")
    axes.plot(*(cast.before[frame] * MM).T, color=BEFORE, lw=1.4, label="simulated before")
    axes.plot(*(cast.after[frame] * MM).T, color=AFTER, lw=1.4, label="simulated after")
    measured = cast.measured(frame) * MM
    axes.plot(*measured.T, color=REAL, lw=0.9, ls=":", label="measured")
    _boxes(axes, record)
    shown = np.concatenate([cast.measured(f) for f in range(len(cast.trial.images))] or [np.zeros((0, 2))])
    shown = np.concatenate([shown, cast.hand(record.arm), [record.arm.base, (record.target.x, record.target.y)]]) * MM
    low, high = shown.min(axis=0) - 40, shown.max(axis=0) + 40
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def _boxes(axes: Axes, record: Record) -> None:
    """Target and obstacles."""
    _box(axes, record.target, fill=False, edgecolor=TARGET, lw=1.6, label="target")
    for obstacle in record.obstacles:
        _box(axes, obstacle, facecolor=WALL, alpha=0.7, lw=0)


def _box(axes: Axes, box: Box, **style: Any) -> None:
    corner = ((box.x - box.w / 2) * MM, (box.y - box.h / 2) * MM)
    axes.add_patch(Rectangle(corner, box.w * MM, box.h * MM, **style))


def _along(s: np.ndarray, points: np.ndarray, at: float) -> Sequence[float]:
    return [np.interp(at, s, points[:, 0]), np.interp(at, s, points[:, 1])]
