"""Clocks and camera: their faults, absent at zero, and the points that they then
report.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from stringcast.stages.model.camera import Camera

# positions (F, S, 2) [m] at times (F,) of the arm's clock [s]
Where = Callable[[np.ndarray], np.ndarray]


class Sight(NamedTuple):
    """Faults of clocks and camera, each absent at zero."""

    offset: float = 0.0  # [s], arm's clock less the camera's
    drift: float = 0.0
    roll: float = 0.0  # [rad]
    scale: float = 0.0
    lens: float = 0.0
    readout: float = 0.0  # [s] from the top row to the bottom one
    # outside the library: a clock that jumps, a knock, a camera that shakes or looks
    # askew, unlike axes, wrong lengths
    jump: float = 0.0  # [s]
    jump_when: float = 0.0
    bump_x: float = 0.0  # [m]
    bump_y: float = 0.0
    bump_when: float = 0.0
    shake_x: float = 0.0  # [m]
    shake_y: float = 0.0
    shake_frequency: float = 9.0  # [Hz]
    askew_x: float = 0.0  # [1/m]
    askew_y: float = 0.0
    stretch: float = 0.0
    misread: float = 0.0  # of arc lengths, as a share


def seen(where: Where, times: np.ndarray, camera: Camera, sight: Sight) -> np.ndarray:
    """Points as reported (F, S, 2) [m] at times (F,) of the camera's clock [s]."""
    arm = (
        times * (1 + sight.drift)
        + sight.offset
        + sight.jump * (times >= sight.jump_when)
    )
    points = rolled(where, arm, camera, sight.readout) if sight.readout else where(arm)
    x, y = np.moveaxis(points - camera.centre, -1, 0)
    x = x * (1 + sight.stretch)
    near = 1 + sight.askew_x * x + sight.askew_y * y
    x, y = x / near, y / near
    c, s = np.cos(sight.roll), np.sin(sight.roll)
    x, y = c * x - s * y, s * x + c * y
    half = camera.width / 2 / camera.px_per_m
    straight = 1 - sight.lens * (x * x + y * y) / half**2  # Fitzgibbon's division model
    points = (np.stack([x / straight, y / straight], axis=-1) + camera.centre) * (
        1 + sight.scale
    )
    shaking = np.sin(2 * np.pi * sight.shake_frequency * times)[:, None, None] * [
        sight.shake_x,
        sight.shake_y,
    ]
    knocked = (0.5 + 0.5 * np.tanh((times - sight.bump_when) / 0.005))[
        :, None, None
    ] * [sight.bump_x, sight.bump_y]
    return np.asarray(points + shaking + knocked)


def rolled(
    where: Where, times: np.ndarray, camera: Camera, readout: float
) -> np.ndarray:
    """Each point where it is when its row is exposed, the middle row at the frame's
    time: on a parabola in time.
    """
    before, now, after = (where(times + share * readout) for share in (-0.5, 0.0, 0.5))
    share = np.zeros(now.shape[:-1])
    for _ in range(4):
        there = (
            now
            + share[..., None] * (after - before)
            + 2 * share[..., None] ** 2 * (after + before - 2 * now)
        )
        share = camera.pixels(there)[..., 1] / camera.height - 0.5
    return np.asarray(there)
