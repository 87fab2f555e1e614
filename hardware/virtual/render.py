"""Rendered camera frames of an arm and a string, with light, blur and noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.polyline import (
    step_lengths,
    turn_left,
    unit_tangents,
)

cv2 = LazyModule("cv2")

FRACTIONAL_BITS = 4  # of coordinates in OpenCV
SUBPIXELS = 1 << FRACTIONAL_BITS
PIECES_PER_PX = 3  # of a strip, per direction


@dataclass(frozen=True)
class Look:
    """The appearance of the scene.

    Attributes
    ----------
    background
        Mean brightness [grey levels].
    unevenness, texture
        Slow and fine variation of the background [grey levels].
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
    """Render the textured wall in uneven light, (height, width) float32."""
    rng = np.random.default_rng([seed, 1])
    size = (camera.width, camera.height)
    coarse = rng.normal(size=(4, 4)).astype(np.float32)
    light = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    fine = rng.normal(size=size[::-1]).astype(np.float32)
    grain = cv2.GaussianBlur(fine, (0, 0), 3.0)
    wall = look.background + look.unevenness * light / 2
    return wall + look.texture * grain / grain.std()


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
        The arm at K moments of the exposure, which are averaged [m].
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
    arm, string = camera.pixels(joints), camera.pixels(strings)
    _draw_lines(frame, arm, arm_width, look.arm, line_coverage)
    _draw_lines(frame, string, string_width, look.string, strip_coverage)
    return frame


def add_sensor_noise(
    frame: np.ndarray, look: Look, rng: np.random.Generator
) -> np.ndarray:
    """Add the sensor's noise to a frame and round it, uint8."""
    noise = rng.standard_normal(frame.shape, dtype=np.float32)
    grey = np.rint(frame + look.noise * noise)
    return np.clip(grey, 0, 255).astype(np.uint8)


def _draw_lines(
    frame: np.ndarray,
    lines: np.ndarray,
    width: float,
    brightness: float,
    coverage: Callable[[tuple[int, ...], np.ndarray, float], np.ndarray],
) -> None:
    """Draw the mean of polylines (K, n, 2) [px] of a width [px] into a frame.

    `coverage` computes the fraction of each pixel that a polyline covers.
    """
    margin = int(np.ceil(width)) + 2
    size = frame.shape[::-1]
    low = np.floor(lines.min(axis=(0, 1))).astype(int) - margin
    low = np.clip(low, 0, size)
    high = np.ceil(lines.max(axis=(0, 1))).astype(int) + margin + 1
    high = np.clip(high, low, size)
    part = frame[low[1] : high[1], low[0] : high[0]]
    if part.size:
        covers = [coverage(part.shape, line - low, width) for line in lines]
        part += np.mean(covers, axis=0) * (brightness - part)


def line_coverage(
    shape: tuple[int, ...], pixels: np.ndarray, width: float
) -> np.ndarray:
    """Compute the fraction of each pixel that a polyline with round ends covers.

    pixels: (n, 2) [px]. width: [px].
    """
    canvas = np.zeros(shape, np.uint8)
    fine = np.rint(pixels * SUBPIXELS).astype(np.int32)
    thickness = max(round(width), 1)
    cv2.polylines(
        canvas, [fine[:, None]], False, 255, thickness, cv2.LINE_AA, FRACTIONAL_BITS
    )
    return canvas.astype(np.float32) / 255


def strip_coverage(
    shape: tuple[int, ...], pixels: np.ndarray, width: float
) -> np.ndarray:
    """Compute the fraction of each pixel that a strip covers.

    The strip has flat ends; OpenCV's thin lines end 0.1 to 0.4 px later, depending on
    their direction. The strip is cut into small pieces, approximated by upright
    rectangles.

    Parameters
    ----------
    shape
        Height and width of the picture [px].
    pixels : (n, 2)
        Centre line of the strip [px].
    width
        Its width [px].

    Returns
    -------
    ndarray of this shape
        Fractions from 0 to 1.
    """
    normal = turn_left(unit_tangents(pixels))
    drawn = _drawn_segments(shape, pixels, normal)
    if not len(drawn):
        return np.zeros(shape)
    segment = pixels[drawn + 1] - pixels[drawn]  # (S, 2)
    length = np.linalg.norm(segment, axis=1)

    # A pieces along each segment, B across the strip
    count_along = max(int(np.ceil(PIECES_PER_PX * length.max())), 1)
    count_across = max(int(np.ceil(PIECES_PER_PX * width)), 1)
    along = ((np.arange(count_along) + 0.5) / count_along)[:, None]
    across = ((np.arange(count_across) + 0.5) / count_across - 0.5) * width
    turn = normal[drawn + 1] - normal[drawn]
    middle = pixels[drawn, None] + along * segment[:, None]  # (S, A, 2)
    side = normal[drawn, None] + along * turn[:, None]
    piece = middle[:, :, None] + across[:, None] * side[:, :, None]  # (S, A, B, 2)

    # upright rectangle of a piece: sides (S, 2) [px]; area of the piece
    size_along = length / count_along
    size_across = width / count_across
    direction = np.abs(segment) / np.maximum(length[:, None], 1e-9)
    sides = direction * size_along[:, None] + direction[:, ::-1] * size_across
    areas = size_along * size_across
    return np.minimum(_rectangle_sums(shape, piece, sides, areas), 1.0)


def _drawn_segments(
    shape: tuple[int, ...], pixels: np.ndarray, normal: np.ndarray
) -> np.ndarray:
    """Choose the segments of a line (n, 2) [px] that may be in a picture, by index.

    Diverged simulations have segments that are too long, far away or not finite.
    normal: normals of the line (n, 2).
    """
    reach = sum(shape)
    is_near = (np.abs(pixels) < 2 * reach).all(axis=1)
    is_short = step_lengths(pixels) < reach
    is_whole = np.isfinite(normal).all(axis=1)
    is_drawn = is_near & is_whole
    return np.flatnonzero(is_short & is_drawn[:-1] & is_drawn[1:])


def _rectangle_sums(
    shape: tuple[int, ...], middle: np.ndarray, sides: np.ndarray, areas: np.ndarray
) -> np.ndarray:
    """Sum the areas of small upright rectangles in each pixel of a picture.

    middle: (S, A, B, 2) [px]. sides: (S, 2), at most a pixel. areas: (S,) [px^2].
    """
    sides = sides[:, None, None]
    first = middle + 0.5 - sides / 2  # from the edge of the picture
    pixel = np.floor(first).astype(int)
    # share of a rectangle in the next column and row
    beyond = np.clip((first + sides - pixel - 1) / np.maximum(sides, 1e-9), 0, 1)
    shares = (1 - beyond, beyond)
    height, width = shape
    numbers = []
    parts = []
    for next_column, next_row in product((0, 1), (0, 1)):
        column = pixel[..., 0] + next_column
        row = pixel[..., 1] + next_row
        is_inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        share = shares[next_column][..., 0] * shares[next_row][..., 1]
        numbers.append(row[is_inside] * width + column[is_inside])
        parts.append((areas[:, None, None] * share)[is_inside])
    sums = np.bincount(np.concatenate(numbers), np.concatenate(parts), height * width)
    return sums.reshape(shape)
