"""How effects draw their laws, in labelled axes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from stages.model.camera import Camera

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def line(axes: Axes, x: np.ndarray, y: np.ndarray, across: str, up: str) -> None:
    """Draw y over x, with zero in view and the axes named."""
    axes.plot(x, np.broadcast_to(y, np.shape(x)))
    axes.axhline(0.0, linewidth=0.5, color="0.6")
    axes.set_xlabel(across)
    axes.set_ylabel(up)


def grid(axes: Axes, seen: Callable[..., np.ndarray], **values: float) -> None:
    """Draw a square grid, dashed, and as a camera effect's law sees it."""
    camera = Camera(200, 200, 100.0, (99.5, 99.5), 1.0)
    lines = np.stack(np.meshgrid(np.linspace(-0.9, 0.9, 5), np.linspace(-0.9, 0.9, 41), indexing="ij"), axis=-1)
    given = {name: np.full((1, 1, 1, 1), value) for name, value in values.items()}
    for way in (lines, lines[..., ::-1]):
        bent = seen(way[None], 0 * way[None], np.zeros(1), camera, **given)[0]
        axes.plot(*way.T, color="0.7", linestyle="--", linewidth=0.5)
        axes.plot(*bent.T, color="C0")
    axes.set_aspect("equal")
    axes.set_xlabel("x / m")
    axes.set_ylabel("y / m")
