"""The ways of hand and tip through the plane."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from stringcast.stages.model.box import Box
from stringcast.stages.report.picture import LIGHT, MM, Picture, framed, vector
from stringcast.stages.report.record import Cast, Record
from stringcast.stages.report.words import mm

SIZE = (5.4, 4.9)


def path(record: Record, cast: Cast) -> Picture | None:
    """One manipulation: the ways of hand and tip, the arm at the start and at the closest approach."""
    if cast.trial.arm.empty:
        return None
    figure, axes = _plane(record)
    joints = cast.joints(record.arm) * MM
    for frame, alpha in ((0, 0.35), (_row(cast), 1.0)):
        axes.plot(*joints[frame].T, "-o", color=LIGHT["soft"], lw=3, ms=4, alpha=alpha)
    axes.plot(*joints[:, -1].T, color=LIGHT["after"], label="hand")
    way = cast.tip(np.arange(0, cast.motion.duration, 0.001)) * MM
    if np.isfinite(way).any():
        axes.plot(*way.T, color=LIGHT["measured"], lw=1, label="string's tip")
    _legend(figure, axes)
    return vector(figure, f"Way of the hand, {mm(_length(joints[:, -1]))} long, and of the tip; {_where(record)}.")


def paths(record: Record) -> Picture | None:
    """The hand's way in each manipulation, dark to bright."""
    casts = [cast for cast in record.casts if not cast.trial.arm.empty]
    if len(casts) < 2:
        return None
    figure, axes = _plane(record)
    for number, cast in enumerate(record.casts, start=1):
        hand = cast.joints(record.arm)[:, -1] * MM
        share = (number - 1) / max(len(record.casts) - 1, 1)
        axes.plot(*hand.T, color=LIGHT["after"], alpha=0.25 + 0.75 * share, lw=1 + share, label=f"cast {number}")
    axes.plot(*np.array(record.arm.base) * MM, "s", ms=6, color=LIGHT["soft"])
    _legend(figure, axes)
    return vector(figure, f"Way of the hand in {len(casts)} casts; {_where(record)}.")


def _plane(record: Record) -> tuple[Figure, Axes]:
    """Target and obstacles, to scale."""
    figure = framed(*SIZE)
    axes = figure.subplots()
    axes.margins(0.08)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    axes.add_patch(_box(record.target, fill=False, edgecolor=LIGHT["target"], lw=1.8, label="target"))
    for obstacle in record.obstacles:
        axes.add_patch(_box(obstacle, facecolor=LIGHT["wall"], alpha=0.5, lw=0, label="obstacle"))
    return figure, axes


def _box(box: Box, **style: object) -> Rectangle:
    corner = ((box.x - box.w / 2) * MM, (box.y - box.h / 2) * MM)
    return Rectangle(corner, box.w * MM, box.h * MM, **style)  # type: ignore[arg-type]


def _legend(figure: Figure, axes: Axes) -> None:
    """Above the axes, every label once."""
    once = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(once.values(), once.keys(), loc="upper left", ncols=6)
    figure.subplots_adjust(top=1 - (0.1 + 0.18 * np.ceil(len(once) / 6)) / SIZE[1])  # [inches]


def _row(cast: Cast) -> int:
    """The measured posture nearest to the closest approach."""
    at = cast.verdict.t if np.isfinite(cast.verdict.t) else cast.motion.duration
    return int(np.argmin(np.abs(cast.trial.arm["t"].to_numpy() - at)))


def _length(way: np.ndarray) -> float:
    return float(np.hypot(*np.diff(way, axis=0).T).sum() / MM)


def _where(record: Record) -> str:
    walls = len(record.obstacles)
    around = f" and {walls} obstacle{'s' if walls > 1 else ''}" if walls else ""
    return f"target at ({record.target.x * MM:.0f}, {record.target.y * MM:.0f}) mm{around}"
