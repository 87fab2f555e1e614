"""Faults of clocks and camera, and the points that are reported with them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from stringcast.stages.model.camera import Camera

# Positions (F, S, 2) [m] at times (F,) of the arm's clock [s].
PositionsAt = Callable[[np.ndarray], np.ndarray]
KNOCK_EDGE_S = 0.005


class CameraFaults(NamedTuple):
    """Faults of clocks and camera, each absent at zero."""

    offset: float = 0.0  # [s], arm's clock less the camera's
    drift: float = 0.0
    roll: float = 0.0  # [rad]
    scale: float = 0.0
    lens: float = 0.0
    readout: float = 0.0  # [s], from the top row to the bottom one
    # outside the library: a clock that jumps, a knock, a camera that shakes or looks
    # askew, axes of unlike scale, wrong arc lengths
    jump: float = 0.0  # [s]
    jump_when: float = 0.0
    knock_x: float = 0.0  # [m]
    knock_y: float = 0.0
    knock_when: float = 0.0  # [s]
    shake_x: float = 0.0  # [m]
    shake_y: float = 0.0
    shake_frequency: float = 9.0  # [Hz]
    perspective_x: float = 0.0  # [1/m]
    perspective_y: float = 0.0
    stretch: float = 0.0
    length_error: float = 0.0  # share of the arc lengths


def report_points(
    positions: PositionsAt, times: np.ndarray, camera: Camera, faults: CameraFaults
) -> np.ndarray:
    """Return points (F, S, 2) [m] as reported at times (F,) of the camera's clock."""
    jump = faults.jump * (times >= faults.jump_when)
    arm_times = times * (1 + faults.drift) + faults.offset + jump
    if faults.readout:
        points = expose_rolling_shutter(positions, arm_times, camera, faults.readout)
    else:
        points = positions(arm_times)
    x, y = np.moveaxis(points - camera.centre, -1, 0)
    x = x * (1 + faults.stretch)
    depth = 1 + faults.perspective_x * x + faults.perspective_y * y
    x, y = x / depth, y / depth
    cosine, sine = np.cos(faults.roll), np.sin(faults.roll)
    x, y = cosine * x - sine * y, sine * x + cosine * y
    half_width = camera.width / 2 / camera.px_per_m
    # Fitzgibbon's division model of a lens
    straight = 1 - faults.lens * (x * x + y * y) / half_width**2
    points = np.stack([x / straight, y / straight], axis=-1) + camera.centre
    points = points * (1 + faults.scale)
    wave = np.sin(2 * np.pi * faults.shake_frequency * times)[:, None, None]
    shaking = wave * [faults.shake_x, faults.shake_y]
    since_knock = 0.5 + 0.5 * np.tanh((times - faults.knock_when) / KNOCK_EDGE_S)
    knocked = since_knock[:, None, None] * [faults.knock_x, faults.knock_y]
    return np.asarray(points + shaking + knocked)


def expose_rolling_shutter(
    positions: PositionsAt, times: np.ndarray, camera: Camera, readout: float
) -> np.ndarray:
    """Return each point where it is when its row is exposed.

    The middle row is exposed at the frame's time. Points move on parabolas in time.
    """
    before = positions(times - 0.5 * readout)
    now = positions(times)
    after = positions(times + 0.5 * readout)
    share = np.zeros(now.shape[:-1])  # share of the readout, from the middle row
    for _ in range(4):
        linear = share[..., None] * (after - before)
        quadratic = 2 * share[..., None] ** 2 * (after + before - 2 * now)
        points = now + linear + quadratic
        share = camera.pixels(points)[..., 1] / camera.height - 0.5
    return np.asarray(points)
