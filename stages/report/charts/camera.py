"""Camera frames with everything that is known of them drawn on top, in the camera's own
pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.stages.model.box import Box
from stringcast.stages.model.camera import Camera
from stringcast.stages.report.formatting import mm, ms
from stringcast.stages.report.records import Cast, RunRecord
from stringcast.stages.report.theme import (
    MM_PER_M,
    ON_FRAMES,
    Picture,
    data_uri,
    raster,
    webp,
)

GRID = 0.1  # [m]
SHADOW = [patheffects.withStroke(linewidth=2.4, foreground="#000000a0")]


@dataclass(frozen=True)
class View:
    """Part of the camera's image [px]: columns left to right - 1, rows top to bottom -
    1.
    """

    left: int
    top: int
    right: int
    bottom: int

    def crop(self, image: np.ndarray) -> np.ndarray:
        """The part of an image in the view, grey."""
        part = image[self.top : self.bottom, self.left : self.right]
        return part if part.ndim == 2 else cv2.cvtColor(part, cv2.COLOR_BGR2GRAY)

    def pixels(self, camera: Camera, world: np.ndarray, scale: float) -> np.ndarray:
        """Pixels (..., 2) of world points in this part made `scale` times as large, the
        corner of the first at 0.
        """
        return (camera.pixels(world) - (self.left, self.top) + 0.5) * scale

    @property
    def size(self) -> np.ndarray:
        """Width and height [px]."""
        return np.array([self.right - self.left, self.bottom - self.top])


def view(record: RunRecord, world: np.ndarray, margin: float = 0.05) -> View:
    """The part of the image that shows world points. world: (N, 2), margin [m]; NaN is
    passed over.
    """
    camera = record.model.camera
    seen = camera.pixels(world[np.isfinite(world).all(axis=1)])
    border = margin * camera.px_per_m
    whole = np.array([camera.width, camera.height])
    low = np.clip(np.floor(seen.min(axis=0) - border), 0, whole - 16).astype(int)
    high = np.clip(np.ceil(seen.max(axis=0) + border), low + 16, whole).astype(int)
    return View(*low.tolist(), *high.tolist())


def whole_view(record: RunRecord) -> View:
    """All that happened in a run, the same part for each of its casts."""
    places = [
        np.array([record.model.arm.base]),
        corners(record.target),
        *map(corners, record.obstacles),
    ]
    for cast in record.casts:
        places += [
            cast.joints(record.model.arm).reshape(-1, 2),
            *(line[:, :2] for line in cast.measured.values()),
        ]
    return view(record, np.concatenate(places))


def corners(box: Box) -> np.ndarray:
    """(4, 2) corners of a box, in turn [m]."""
    around = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    return np.array([box.x, box.y]) + around * [box.w, box.h]


def frame_figure(part: View, width: float) -> tuple[Figure, Axes]:
    """An empty figure that is nothing but the picture. width [inches]."""
    columns, rows = part.size
    figure = Figure(figsize=(width, width * rows / columns))
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set(
        xlim=(part.left - 0.5, part.right - 0.5),
        ylim=(part.bottom - 0.5, part.top - 0.5),
    )
    return figure, axes


def draw(
    axes: Axes, record: RunRecord, cast: Cast, frame: int, part: View, lw: float = 1.5
) -> None:
    """The frame, target and obstacles, and the strings simulated before and after. lw:
    width of lines [pt].
    """
    low, high = cast.levels
    extent = (part.left - 0.5, part.right - 0.5, part.bottom - 0.5, part.top - 0.5)
    image = part.crop(cast.trial.images[frame])
    axes.imshow(
        image, cmap="gray", vmin=low, vmax=high, extent=extent, aspect="auto", zorder=0
    )
    for obstacle in record.obstacles:
        axes.fill(
            *record.model.camera.pixels(corners(obstacle)).T,
            facecolor=ON_FRAMES["wall"],
            alpha=0.55,
        )
    axes.fill(
        *record.model.camera.pixels(corners(record.target)).T,
        fill=False,
        edgecolor=ON_FRAMES["target"],
        lw=lw,
    )
    line(axes, record, cast.before[frame], color=ON_FRAMES["before"], lw=lw)
    line(axes, record, cast.after[frame], color=ON_FRAMES["after"], lw=lw)


def line(axes: Axes, record: RunRecord, world: np.ndarray, **style: Any) -> None:
    """A line through world points (K, 2) [m]; nothing where any is not finite."""
    if np.isfinite(world).all():
        axes.plot(*record.model.camera.pixels(world).T, **style)


def millimetres(axes: Axes, record: RunRecord, part: View) -> None:
    """A grid every 100 mm with its coordinates; bent as the lens bends it."""
    box = np.array(
        [
            [part.left, part.bottom],
            [part.right, part.bottom],
            [part.right, part.top],
            [part.left, part.top],
        ]
    )
    seen = record.model.camera.world(box)
    low, high = seen.min(axis=0), seen.max(axis=0)
    for axis in (0, 1):
        for at in (
            np.arange(np.ceil(low[axis] / GRID), np.floor(high[axis] / GRID) + 1) * GRID
        ):
            way = np.linspace(low, high, 40)
            way[:, axis] = at
            line(axes, record, way, color="white", alpha=0.14, lw=0.7)
            _label(
                axes,
                record.model.camera.pixels(way),
                axis,
                f"{at * MM_PER_M:.0f}",
                part,
            )
    axes.annotate(
        "mm",
        (1, 0),
        (-6, 5),
        "axes fraction",
        "offset points",
        ha="right",
        color="white",
        fontsize=8,
    )


def _label(axes: Axes, way: np.ndarray, axis: int, text: str, part: View) -> None:
    """A coordinate where its grid line meets the lower or left edge, unless in the
    corner.
    """
    edge = np.array([part.left, part.bottom])[1 - axis]
    u, v = way[np.argmin(np.abs(way[:, 1 - axis] - edge))]
    room = 0.08 * part.size
    place = (u, part.bottom - 0.5) if axis == 0 else (part.left - 0.5, v)
    if (
        part.left + room[0] < u < part.right - room[0]
        if axis == 0
        else part.top + 12 < v < part.bottom - room[1]
    ):
        shift, align = ((0, 5), "center") if axis == 0 else ((5, -3), "left")
        axes.annotate(
            text,
            place,
            shift,
            textcoords="offset points",
            ha=align,
            color="white",
            fontsize=8,
            path_effects=SHADOW,
        )


# --- the closest approach
AROUND = 0.03  # [s] of the tip's way, each side of the closest approach


def overlay(record: RunRecord, cast: Cast) -> Picture | None:
    """The frame nearest in time, as large as hand, strings and target allow, with the
    tip's way through it.
    """
    if not len(cast.trial.images):
        return None
    frame = cast.nearest
    shown = [cast.before[frame], cast.after[frame], corners(record.target)]
    shown += [cast.measured[frame][:, :2]] if frame in cast.measured else []
    part = view(record, np.concatenate(shown))
    figure, axes = frame_figure(part, 5.4)
    draw(axes, record, cast, frame, part)
    if frame in cast.measured:
        line(
            axes,
            record,
            cast.measured[frame][:, :2],
            color=ON_FRAMES["measured"],
            ls="",
            marker=".",
            ms=2.5,
        )
    way = cast.tip(cast.verdict.t + np.linspace(-AROUND, AROUND, 121))
    line(
        axes,
        record,
        way[np.isfinite(way).all(axis=1)],
        color=ON_FRAMES["measured"],
        lw=0.9,
        ls=(0, (2, 2)),
    )
    line(
        axes,
        record,
        cast.tip(np.array([cast.verdict.t])),
        color=ON_FRAMES["ink"],
        marker="o",
        ms=8,
        mfc="none",
    )
    millimetres(axes, record, part)
    known = np.isfinite(cast.verdict.distance)
    closest = (
        f"{mm(cast.verdict.distance)} from its centre at {ms(cast.verdict.t, 1)}"
        if known
        else "never seen"
    )
    return raster(
        figure,
        f"Camera frame at {ms(cast.t[frame])}, with the target box and the string as measured and as simulated "
        f"before and after estimation. The tip is {closest}.",
    )


# --- the player
FRAMES = 100  # at most in one page, shared among its casts
FEWEST = 10  # of one cast
SIZE = 440  # [px] of the longer side
SMALLER = (
    (1.0, 45),
    (1.0, 25),
    (1.0, 12),
    (0.5, 45),
    (0.5, 25),
)  # size and quality of WebP, until noise makes no frame larger than
# [bytes]: 100 frames are 0.33 MB of a page, which shall have 1.5 at most
LARGEST = 2_500
STILLS = 6  # below the film
REST = 0.03  # [s] shown before and after the movement


def animation(record: RunRecord, cast: Cast, part: View) -> dict[str, Any] | None:
    """Everything the player draws, JSON-able; coordinates in its own pixels, times in
    ms. None without frames.
    """
    if not len(cast.trial.images):
        return None
    scale = SIZE / float(part.size.max())
    width, height = np.round(part.size * scale).astype(int).tolist()
    chosen = choose(cast, max(FRAMES // len(record.casts), FEWEST))
    measured = [cast.measured.get(f, np.zeros((0, 3)))[:, :2] for f in chosen]
    drawn: dict[str, Sequence[np.ndarray]] = {
        "before": list(cast.before[chosen]),
        "after": list(cast.after[chosen]),
        "measured": measured,
    }
    evenly = np.linspace(0, len(chosen) - 1, STILLS)
    return {
        "width": width,
        "height": height,
        "t": [round(float(cast.t[f]) * 1e3, 1) for f in chosen],
        "start": chosen.index(cast.nearest) if cast.nearest in chosen else 0,
        "frames": [
            _small(part.crop(cast.trial.images[f]), cast.levels, scale) for f in chosen
        ],
        "boxes": [
            (ON_FRAMES[kind], _pixels(record, corners(box), part, scale))
            for kind, box in [
                ("target", record.target),
                *(("wall", box) for box in record.obstacles),
            ]
        ],
        "stills": [
            (chosen.index(frame), ms(cast.t[frame]))
            for frame in sorted({chosen[i] for i in evenly.round().astype(int)})
        ],
        "strings": {
            name: [_pixels(record, line, part, scale) for line in lines]
            for name, lines in drawn.items()
        },
    }


def choose(cast: Cast, most: int) -> list[int]:
    """Numbers of at most `most` frames, evenly over the movement, the closest approach
    among them.
    """
    first, last = cast.frame(-REST), cast.frame(cast.motion.duration + REST)
    even = np.linspace(first, last, min(most, last - first + 1)).round().astype(int)
    if np.isfinite(cast.verdict.t):
        even[np.argmin(np.abs(even - cast.nearest))] = cast.nearest
    return sorted(set(even.tolist()))


def _small(image: np.ndarray, black_white: tuple[float, float], scale: float) -> str:
    """A frame with its levels spread, never larger than it was filmed: the player
    enlarges it.
    """
    low, high = black_white
    clear = np.clip(
        (image.astype(np.float32) - low) * (255 / (high - low)), 0, 255
    ).astype(np.uint8)
    for smaller, quality in SMALLER:
        share = min(scale, 1.0) * smaller
        data = webp(
            cv2.resize(clear, None, fx=share, fy=share, interpolation=cv2.INTER_AREA),
            quality,
        )
        if len(data) <= LARGEST:
            break
    return data_uri("webp", data)


def _pixels(
    record: RunRecord, world: np.ndarray, part: View, scale: float
) -> list[list[float]]:
    """Pixels of the small picture (corner of the first at 0); empty where the
    simulation did not stay finite.
    """
    if not np.isfinite(world).all():
        return []
    return np.round(part.pixels(record.model.camera, world, scale), 1).tolist()
