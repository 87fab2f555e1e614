"""Rendered camera frames of an arm and a string, with light, blur and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.model.camera import Camera

cv2 = LazyModule("cv2")

FRACTIONAL_BITS = 4  # of OpenCV's coordinates
SUBPIXELS = 1 << FRACTIONAL_BITS


@dataclass(frozen=True)
class Look:
    """The appearance of the scene.

    Attributes
    ----------
    background
        Mean brightness [grey levels].
    unevenness, texture
        Its slow and its fine variation [grey levels].
    string, arm
        Brightness of string and arm [grey levels].
    string_width, arm_width
        Their widths [m].
    noise
        Sensor noise, one sigma [grey levels].
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
    """Render the background without noise, (height, width) float32.

    It has uneven light and a textured wall.
    """
    rng = np.random.default_rng([seed, 1])
    size = (camera.width, camera.height)
    coarse = rng.normal(size=(4, 4)).astype(np.float32)
    light = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    fine = rng.normal(size=size[::-1]).astype(np.float32)
    grain = cv2.GaussianBlur(fine, (0, 0), 3.0)
    wall = look.background + look.unevenness * light / 2
    return np.asarray(wall + look.texture * grain / grain.std())


def render_frame(
    camera: Camera,
    look: Look,
    joints: np.ndarray,
    strings: np.ndarray,
    wall: np.ndarray,
) -> np.ndarray:
    """Render one frame without noise.

    Parameters
    ----------
    camera
        The camera.
    look
        The appearance of the scene.
    joints : (K, J + 1, 2)
        The arm at K moments of the exposure, whose mean the shutter sees [m].
    strings : (K, n, 2)
        The string at these moments [m].
    wall : (height, width)
        The background.

    Returns
    -------
    (height, width) ndarray of float32
        The frame [grey levels].
    """
    frame = wall.copy()
    arm_width = look.arm_width * camera.px_per_m
    string_width = look.string_width * camera.px_per_m
    _draw_lines(frame, camera.pixels(joints), arm_width, look.arm)
    _draw_lines(frame, camera.pixels(strings), string_width, look.string)
    return frame


def add_sensor_noise(
    frame: np.ndarray, look: Look, rng: np.random.Generator
) -> np.ndarray:
    """Add the sensor's noise to a frame and round it, uint8."""
    noise = rng.standard_normal(frame.shape, dtype=np.float32)
    grey = np.rint(frame + look.noise * noise)
    return np.asarray(np.clip(grey, 0, 255), np.uint8)


def line_coverage(camera: Camera, line: np.ndarray, width: float) -> np.ndarray:
    """Compute the fraction of each pixel that a polyline covers.

    Parameters
    ----------
    camera
        The camera.
    line : (n, 2)
        The polyline [m].
    width
        Its width [m].

    Returns
    -------
    (height, width) ndarray of float32
        Fractions from 0 to 1.
    """
    thickness = max(round(width * camera.px_per_m), 1)
    shape = camera.height, camera.width
    return _pixel_coverage(shape, camera.pixels(line), thickness)


def _draw_lines(
    frame: np.ndarray, lines: np.ndarray, width: float, brightness: float
) -> None:
    """Draw the mean of polylines (K, n, 2) [px] of a width [px] into a frame.

    Only the part of the frame in which they lie is changed.
    """
    thickness = max(round(width), 1)
    size = frame.shape[::-1]
    low = np.floor(lines.min(axis=(0, 1))).astype(int) - thickness - 2
    low = np.clip(low, 0, size)
    high = np.ceil(lines.max(axis=(0, 1))).astype(int) + thickness + 3
    high = np.clip(high, low, size)
    part = frame[low[1] : high[1], low[0] : high[0]]
    if part.size:
        covers = [_pixel_coverage(part.shape, line - low, thickness) for line in lines]
        part += np.mean(covers, axis=0) * (brightness - part)


def _pixel_coverage(
    shape: tuple[int, ...], pixels: np.ndarray, thickness: int
) -> np.ndarray:
    """Compute the fraction of each pixel that a polyline (n, 2) [px] covers."""
    canvas = np.zeros(shape, np.uint8)
    fine = np.rint(pixels * SUBPIXELS).astype(np.int32)
    cv2.polylines(
        canvas, [fine[:, None]], False, 255, thickness, cv2.LINE_AA, FRACTIONAL_BITS
    )
    return canvas.astype(np.float32) / 255
