"""Camera frames of an arm and a string: light, blur, noise, and everything in view."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stringcast.stages.model.camera import Camera

FRACTIONAL_BITS = 4  # fractional bits of opencv's coordinates
SUBPIXELS = 1 << FRACTIONAL_BITS


@dataclass(frozen=True)
class Look:
    """The appearance of the scene. Brightness in grey levels, widths in metres.

    background: mean brightness; unevenness: its slow variation; texture: its fine
    variation; noise: one sigma of the sensor's.
    """

    background: float = 45.0
    unevenness: float = 18.0
    texture: float = 4.0
    string: float = 205.0
    arm: float = 150.0
    string_width: float = 0.004
    arm_width: float = 0.035
    noise: float = 2.0


def render_background(camera: Camera, look: Look, seed: int) -> np.ndarray:
    """The background without noise, (height, width) float32: uneven light and a
    textured wall.
    """
    rng = np.random.default_rng([seed, 1])
    size = (camera.width, camera.height)
    light = cv2.resize(
        rng.normal(size=(4, 4)).astype(np.float32), size, interpolation=cv2.INTER_CUBIC
    )
    grain = cv2.GaussianBlur(
        rng.normal(size=size[::-1]).astype(np.float32), (0, 0), 3.0
    )
    return (
        look.background
        + look.unevenness * light / 2
        + look.texture * grain / grain.std()
    )


def render_frame(
    camera: Camera,
    look: Look,
    joints: np.ndarray,
    strings: np.ndarray,
    wall: np.ndarray,
) -> np.ndarray:
    """One noiseless frame, (height, width) float32.

    joints: (K, J + 1, 2) and strings: (K, n, 2), arm and string [m] at K moments of the
    exposure, whose mean is what the shutter sees. wall: `scenery`.
    """
    frame = wall.copy()
    _draw_lines(
        frame, camera.pixels(joints), look.arm_width * camera.px_per_m, look.arm
    )
    _draw_lines(
        frame, camera.pixels(strings), look.string_width * camera.px_per_m, look.string
    )
    return frame


def add_sensor_noise(
    frame: np.ndarray, look: Look, rng: np.random.Generator
) -> np.ndarray:
    """The frame as the sensor reports it, uint8."""
    noise = rng.standard_normal(frame.shape, dtype=np.float32)
    return np.clip(np.rint(frame + look.noise * noise), 0, 255).astype(np.uint8)


def line_coverage(camera: Camera, line: np.ndarray, width: float) -> np.ndarray:
    """Share of each pixel covered by a polyline of a width [m], (height, width) float32
    in [0, 1].
    """
    return _pixel_coverage(
        (camera.height, camera.width),
        camera.pixels(line),
        max(round(width * camera.px_per_m), 1),
    )


def _draw_lines(
    frame: np.ndarray, lines: np.ndarray, width: float, brightness: float
) -> None:
    """Draw the mean of polylines (K, n, 2) [px] of a width [px] into a frame, touching
    only the part they lie in.
    """
    thickness = max(round(width), 1)
    size = frame.shape[::-1]
    low = np.clip(np.floor(lines.min(axis=(0, 1))).astype(int) - thickness - 2, 0, size)
    high = np.clip(
        np.ceil(lines.max(axis=(0, 1))).astype(int) + thickness + 3, low, size
    )
    part = frame[low[1] : high[1], low[0] : high[0]]
    if part.size:
        cover = np.mean(
            [_pixel_coverage(part.shape, line - low, thickness) for line in lines],
            axis=0,
        )
        part += cover * (brightness - part)


def _pixel_coverage(
    shape: tuple[int, ...], pixels: np.ndarray, thickness: int
) -> np.ndarray:
    """Share of each pixel covered by a polyline (n, 2) [px], float32 in [0, 1]."""
    canvas = np.zeros(shape, np.uint8)
    fine = np.rint(pixels * SUBPIXELS).astype(np.int32)
    cv2.polylines(
        canvas, [fine[:, None]], False, 255, thickness, cv2.LINE_AA, FRACTIONAL_BITS
    )
    return canvas.astype(np.float32) / 255
