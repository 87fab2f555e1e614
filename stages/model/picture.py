"""How effects draw their laws, in labelled axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.camera import Camera
from stringcast.stages.model.effect import HELD, arguments, taken

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from stringcast.stages.model.effect import StringEffect


def line(axes: Axes, x: np.ndarray, y: np.ndarray, across: str, up: str) -> None:
    """Draw y over x, with zero in view and the axes named."""
    axes.plot(x, np.broadcast_to(y, np.shape(x)))
    axes.axhline(0.0, linewidth=0.5, color="0.6")
    axes.set_xlabel(across)
    axes.set_ylabel(up)


def loop(axes: Axes, effect: type[StringEffect], values: Mapping[str, float], farthest: float, lapse: float) -> None:
    """Draw what a hinge or a grasp with a memory holds, bent there and back to +-farthest [1/m] or [rad] within a lapse
    [s] a quarter."""
    bent = farthest * np.interp(np.linspace(0.0, 5.0, 501), np.arange(6), [0.0, 1.0, 0.0, -1.0, 0.0, 1.0])
    laws, state, moments = effect.laws(), 0.0, []
    held, moment, bends = next(each for each in HELD.values() if each[0] in laws)
    own = {slot: {name: values[name] for name in arguments(laws[slot]) if name in values} for slot in laws}
    for change in np.diff(bent, prepend=0.0):
        known = {"held": state, "change": change, "dt": lapse / 100}
        state = laws[held](**taken(laws[held], known), **own[held])
        moments.append(laws[moment](state, **own[moment]))
    across = {"curvature": "curvature / (1/m)", "angle": "angle at the grasp / rad"}[bends]
    line(axes, bent, np.array(moments), across, "moment / (m3/s2)")


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
