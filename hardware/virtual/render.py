"""Camera frames of an arm and a string: light, blur, noise, and everything in view."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stages.model.camera import Camera

SHIFT = 4  # fractional bits of opencv's coordinates
FINER = 1 << SHIFT


@dataclass(frozen=True)
class Look:
    """How the scene looks. Brightness in grey levels, widths in metres.

    background: mean brightness; unevenness: its slow variation; texture: its fine variation;
    noise: one sigma of the sensor's.
    """

    background: float = 45.0
    unevenness: float = 18.0
    texture: float = 4.0
    string: float = 205.0
    arm: float = 150.0
    string_width: float = 0.004
    arm_width: float = 0.035
    noise: float = 2.0


def scenery(camera: Camera, look: Look, seed: int) -> np.ndarray:
    """The background without noise, (height, width) float32: uneven light and a textured wall."""
    rng = np.random.default_rng([seed, 1])
    size = (camera.width, camera.height)
    light = cv2.resize(rng.normal(size=(4, 4)).astype(np.float32), size, interpolation=cv2.INTER_CUBIC)
    grain = cv2.GaussianBlur(rng.normal(size=size[::-1]).astype(np.float32), (0, 0), 3.0)
    return look.background + look.unevenness * light / 2 + look.texture * grain / grain.std()


def render(camera: Camera, look: Look, joints: np.ndarray, strings: np.ndarray, wall: np.ndarray) -> np.ndarray:
    """One noiseless frame, (height, width) float32.

    joints: (K, J + 1, 2) and strings: (K, n, 2), arm and string [m] at K moments of the
    exposure, whose mean is what the shutter sees. wall: `scenery`.
    """
    arms = np.mean([cover(camera, j, look.arm_width) for j in joints], axis=0)
    cords = np.mean([cover(camera, s, look.string_width) for s in strings], axis=0)
    frame = wall + arms * (look.arm - wall)
    return frame + cords * (look.string - frame)


def noisy(frame: np.ndarray, look: Look, rng: np.random.Generator) -> np.ndarray:
    """The frame as the sensor reports it, uint8."""
    noise = rng.standard_normal(frame.shape, dtype=np.float32)
    return np.clip(np.rint(frame + look.noise * noise), 0, 255).astype(np.uint8)


def cover(camera: Camera, line: np.ndarray, width: float) -> np.ndarray:
    """Share of each pixel covered by a polyline of a width [m], (height, width) float32 in [0, 1]."""
    pixels = np.rint(camera.pixels(line) * FINER).astype(np.int32)
    canvas = np.zeros((camera.height, camera.width), np.uint8)
    thickness = max(round(width * camera.px_per_m), 1)
    cv2.polylines(canvas, [pixels[:, None]], False, 255, thickness, cv2.LINE_AA, SHIFT)
    return canvas.astype(np.float32) / 255
