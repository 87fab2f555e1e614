"""The animation: small frames and the strings, as data for the page's player."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stringcast.stages.report.picture import data_uri, webp
from stringcast.stages.report.record import Cast, Record
from stringcast.stages.report.scene import View, corners, spread_levels

FRAMES = 240  # at most in one page, shared among its casts
FEWEST = 24  # of one cast
SIZE = 480  # [px] of the longer side
QUALITIES = (60, 35, 15)  # of WebP, lowered where noise makes a frame larger than
LARGEST = 12_000  # [bytes]
REST = 0.03  # [s] shown before and after the movement


def animation(record: Record, cast: Cast, part: View) -> dict[str, Any] | None:
    """Everything the player draws, JSON-able; coordinates in its own pixels, times in ms. None without frames."""
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
    return {
        "width": width,
        "height": height,
        "t": [round(float(cast.t[f]) * 1e3, 1) for f in chosen],
        "start": chosen.index(cast.nearest) if cast.nearest in chosen else 0,
        "frames": [_small(part.crop(cast.trial.images[f]), cast.levels, scale) for f in chosen],
        "target": _pixels(record, corners(record.target), part, scale),
        "obstacles": [_pixels(record, corners(box), part, scale) for box in record.obstacles],
        "strings": {name: [_pixels(record, line, part, scale) for line in lines] for name, lines in drawn.items()},
    }


def choose(cast: Cast, most: int) -> list[int]:
    """At most `most` frames, evenly over the movement, the closest approach among them."""
    first, last = cast.frame(-REST), cast.frame(cast.motion.duration + REST)
    even = np.linspace(first, last, min(most, last - first + 1)).round().astype(int)
    if np.isfinite(cast.verdict.t):
        even[np.argmin(np.abs(even - cast.nearest))] = cast.nearest
    return sorted(set(even.tolist()))


def _small(image: np.ndarray, black_white: tuple[float, float], scale: float) -> str:
    """A frame with its levels spread, never larger than it was filmed: the player enlarges it."""
    clear = spread_levels(image, black_white, min(scale, 1.0))
    for quality in QUALITIES:
        data = webp(clear, quality)
        if len(data) <= LARGEST:
            break
    return data_uri("webp", data)


def _pixels(record: Record, world: np.ndarray, part: View, scale: float) -> list[list[float]]:
    """Pixels of the small picture (corner of the first at 0); empty where the simulation did not stay finite."""
    if not np.isfinite(world).all():
        return []
    return np.round(part.pixels(record.camera, world, scale), 1).tolist()
