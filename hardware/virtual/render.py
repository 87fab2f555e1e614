"""Rendered camera frames of an arm and a string, with light, blur and noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.model.camera import Camera

cv2 = LazyModule("cv2")

FRACTIONAL_BITS = 4  # of OpenCV's coordinates
SUBPIXELS = 1 << FRACTIONAL_BITS
PIECES_PER_PX = 3  # of a strip, in each direction


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
    arm, string = camera.pixels(joints), camera.pixels(strings)
    _draw_lines(frame, arm, arm_width, look.arm, _round_line_coverage)
    _draw_lines(frame, string, string_width, look.string, strip_coverage)
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
    shape = camera.height, camera.width
    return _round_line_coverage(shape, camera.pixels(line), width * camera.px_per_m)


def strip_coverage(
    shape: tuple[int, ...], pixels: np.ndarray, width: float
) -> np.ndarray:
    """Compute the fraction of each pixel that a strip covers.

    The strip ends flat at the ends of its line. OpenCV's thin lines end 0.1 to 0.4 px
    later, depending on their direction. The strip is cut into small pieces, each of
    which counts as an upright rectangle.

    Parameters
    ----------
    shape
        Height and width of the picture [px].
    pixels : (n, 2)
        Middle of the strip [px].
    width
        Its width [px].

    Returns
    -------
    ndarray of this shape
        Fractions from 0 to 1.
    """
    tangent = np.gradient(pixels, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
    segment = np.diff(pixels, axis=0)  # (n - 1, 2)
    length = np.linalg.norm(segment, axis=1)
    # longer segments, far ones and those that are no numbers: of diverged simulations
    reach = sum(shape)
    is_near = (np.abs(pixels) < 2 * reach).all(axis=1)
    is_drawn = is_near & np.isfinite(normal).all(axis=1)
    drawn = np.flatnonzero((length < reach) & is_drawn[:-1] & is_drawn[1:])
    if not len(drawn):
        return np.zeros(shape)

    count_along = max(int(np.ceil(PIECES_PER_PX * length[drawn].max())), 1)
    count_across = max(int(np.ceil(PIECES_PER_PX * width)), 1)
    along = ((np.arange(count_along) + 0.5) / count_along)[:, None]
    across = ((np.arange(count_across) + 0.5) / count_across - 0.5) * width
    middle = pixels[drawn, None] + along * segment[drawn, None]  # (n - 1, A, 2)
    turn = normal[drawn + 1] - normal[drawn]
    side = normal[drawn, None] + along * turn[:, None]
    piece = middle[:, :, None] + across[:, None] * side[:, :, None]  # (n - 1, A, B, 2)

    # sides of the upright rectangle around a piece, (n - 1, 2) [px]
    size_along = length[drawn] / count_along
    size_across = width / count_across
    unit = np.abs(segment[drawn]) / np.maximum(length[drawn, None], 1e-9)
    sides = unit * size_along[:, None] + unit[:, ::-1] * size_across
    areas = np.broadcast_to((size_along * size_across)[:, None, None], piece.shape[:-1])
    return np.asarray(np.minimum(_rectangle_sums(shape, piece, sides, areas), 1.0))


def _rectangle_sums(
    shape: tuple[int, ...], middle: np.ndarray, sides: np.ndarray, areas: np.ndarray
) -> np.ndarray:
    """Sum the areas that small upright rectangles have in each pixel of a picture.

    middle: (S, A, B, 2) [px]. sides: (S, 2), at most a pixel. areas: (S, A, B) [px^2].
    """
    sides = sides[:, None, None]
    first = middle + 0.5 - sides / 2  # from the first edge of the picture
    pixel = np.floor(first).astype(int)
    # the share of a rectangle that is in the next column and row
    beyond = np.clip((first + sides - pixel - 1) / np.maximum(sides, 1e-9), 0, 1)
    numbers = []
    parts = []
    for next_column in (0, 1):
        for next_row in (0, 1):
            column = pixel[..., 0] + next_column
            row = pixel[..., 1] + next_row
            inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
            share = np.abs(1 - next_column - beyond[..., 0])
            share = share * np.abs(1 - next_row - beyond[..., 1])
            numbers.append(row[inside] * shape[1] + column[inside])
            parts.append((areas * share)[inside])
    pixels = shape[0] * shape[1]
    sums = np.bincount(np.concatenate(numbers), np.concatenate(parts), pixels)
    return sums.reshape(shape)


def _draw_lines(
    frame: np.ndarray,
    lines: np.ndarray,
    width: float,
    brightness: float,
    coverage: Callable[[tuple[int, ...], np.ndarray, float], np.ndarray],
) -> None:
    """Draw the mean of polylines (K, n, 2) [px] of a width [px] into a frame.

    Only the part of the frame in which they lie is changed. `coverage` computes the
    fraction of each pixel that one of them covers.
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


def _round_line_coverage(
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
