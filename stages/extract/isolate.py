"""Isolate: what in a frame is brighter than the scene without the string would be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

SAMPLES = 120  # frames from which the background is learnt
LEVEL = 3  # percentile over time: a pixel shows the background when the string has left it at least this often
STATIC = 0.35  # of the string's length: how far from a resting grasp the string may never leave its pixels
STILL = 5.0  # [px] a resting grasp moves less
WIDEST = 350  # [px] of the median that fills it in; OpenCV does none that is wider than 361
SPECK = 12  # [px] a patch with fewer is the arm's edge or noise, not string
OUTLINE = 1.0  # [px] by how much the outline of a resting arm may be off
LEAST = 5.0  # the string outshines nothing less than this part of the typical
UNCERTAIN = 10.0  # [grey levels] more than this off, a pixel does not tell where the string's middle is
GREY = 0.3  # [grey levels] noise of rounding to whole levels


@dataclass(frozen=True)
class Backdrop:
    """What all frames share: the scene without string and arm (height, width), and the string's brightness."""

    scene: np.ndarray
    string: float


@dataclass(frozen=True)
class Isolated:
    """The string of one frame, each (height, width).

    light: brightness above what else is seen, as in front of the scene [grey levels]. mask:
    where it is certain, uint8. arm: where the arm may hide it, outline: where the arm's edge
    blurs what is what, bool. noise: one sigma of light.
    """

    light: np.ndarray
    mask: np.ndarray
    arm: np.ndarray
    outline: np.ndarray
    noise: float


def isolate(
    image: np.ndarray, backdrop: Backdrop, moments: np.ndarray, width: float, blur: float, sigmas: float
) -> Isolated:
    """What in a frame is neither scene nor arm.

    moments: (K, J + 1, 2) the arm's joints [px] at moments of the exposure. width: of a link,
    blur: how far the arm moves in the exposure [px]; its clock may be half an exposure off.
    sigmas: by how much the string stands out from the noise.
    """
    seen, body, outline = expected(image, backdrop.scene, moments, width, OUTLINE + blur / 2)
    above = cv2.GaussianBlur(image - seen, (0, 0), 0.8)
    grain = noise(above[::3, ::3])
    rough = max(grain, noise(above[body])) if body.any() else grain
    mask = without_specks((above > sigmas * np.where(body, rough, grain)).astype(np.uint8))
    arm = silhouette(image.shape, moments, width + 4 + blur)
    return Isolated(alike(above, seen, backdrop.string), mask, arm, outline, grain)


def background(images: Sequence[np.ndarray]) -> np.ndarray:
    """The scene without moving bright things, (height, width) float32."""
    chosen = np.unique(np.linspace(0, len(images) - 1, SAMPLES).astype(int))
    stack = np.stack([images[int(i)] for i in chosen])
    low, middle = np.percentile(stack, (LEVEL, 50), axis=0).astype(np.float32)
    return low + np.median(middle - low)  # noise alone makes a low percentile darker than the scene


def uncovered(scene: np.ndarray, grasp: np.ndarray, length: float) -> np.ndarray:
    """The scene with the string's ever-covered beginning replaced by what surrounds it.

    grasp: (F, 2) [px], length: of the string [px]. Only where the grasp rests; a moving one
    uncovers everything.
    """
    if np.ptp(grasp, axis=0).max() > STILL:
        return scene
    width = min(int(length), WIDEST) // 2 * 2 + 1
    around = cv2.medianBlur(np.clip(scene, 0, 255).astype(np.uint8), width).astype(np.float32)
    v, u = np.indices(scene.shape)
    near = np.hypot(u - grasp[0, 0], v - grasp[0, 1]) < STATIC * length
    return np.where(near, np.minimum(scene, around), scene)


def expected(
    image: np.ndarray, scene: np.ndarray, moments: np.ndarray, width: float, doubt: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a frame would show at most without the string, (height, width) float32.

    Also, bool: where the arm is all it shows, and where the arm's outline makes it uncertain.

    moments: (K, J + 1, 2) the arm's joints [px] at moments of the exposure, width: of a link,
    doubt: by how much its outline may be off [px]. The arm is taken to be as bright as along
    its middle; the string in front of it must be brighter.
    """
    if not len(moments):
        nowhere = np.zeros(scene.shape, bool)
        return scene, nowhere, nowhere
    covers = [silhouette(scene.shape, joints[None], width) for joints in moments]
    cover = cv2.GaussianBlur(np.mean(covers, axis=0, dtype=np.float32), (0, 0), 0.5)
    middle = silhouette(scene.shape, moments, max(width / 3, 1)) & (cover > 0.99)
    body = float(np.median(image[middle])) if middle.any() else 0.0
    seen = scene + cover * (body - scene)
    around = np.ones((2 * round(doubt) + 1,) * 2, np.uint8)
    near = cv2.dilate(cover, around) > 0
    most = np.where(near, cv2.dilate(seen, around), seen)
    return most, cover > 0.99, near & (most > seen + UNCERTAIN)


def brightest(images: Sequence[np.ndarray], scene: np.ndarray) -> float:
    """How bright the string is where nothing blurs it, from where each frame outshines the scene most."""
    chosen = np.unique(np.linspace(0, len(images) - 1, SAMPLES // 4).astype(int))
    return float(np.percentile([images[int(i)].flat[np.argmax(images[int(i)] - scene)] for i in chosen], 90))


def alike(difference: np.ndarray, seen: np.ndarray, string: float) -> np.ndarray:
    """Brightness above `seen` as it would be in front of a typical part of it, at least 0.

    A string of brightness `string` outshines a bright arm less than a dark wall.
    """
    room = string - seen
    typical = max(float(np.median(room)), GREY)
    return np.maximum(difference, 0) * typical / np.maximum(room, typical / LEAST)


def noise(difference: np.ndarray) -> float:
    """One sigma of what is not string, by the median: the string covers less than half. difference: any shape."""
    return max(float(np.median(np.abs(difference - np.median(difference)))) / 0.6745, GREY)


def without_specks(mask: np.ndarray) -> np.ndarray:
    """The mask without patches of fewer than SPECK pixels. mask: (height, width) uint8, 0 or 1."""
    _, label, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    return mask & (stats[:, cv2.CC_STAT_AREA] >= SPECK)[label].astype(np.uint8)


def silhouette(shape: tuple[int, ...], moments: np.ndarray, width: float) -> np.ndarray:
    """Pixels within `width` / 2 [px] of the arm's links at any moment, bool. moments: (K, J + 1, 2) joints [px]."""
    canvas = np.zeros(shape, np.uint8)
    pixels = list(np.rint(moments * 16).astype(np.int32)[:, :, None])
    cv2.polylines(canvas, pixels, False, 255, max(round(width), 1), cv2.LINE_8, 4)
    return canvas > 0
