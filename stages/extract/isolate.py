"""Isolate: what in a frame is brighter than the scene without the string would be."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

SAMPLES = 120  # frames from which the background is learnt
LEVEL = 3  # percentile over time: a pixel shows the background when the string has left it at least this often
STATIC = 0.35  # of the string's length: how far from a resting grasp the string may never leave its pixels
STILL = 5.0  # [px] a resting grasp moves less
WIDEST = 350  # [px] of the median that fills it in; OpenCV does none that is wider than 361


def background(images: Sequence[np.ndarray]) -> np.ndarray:
    """The scene without moving bright things, (height, width) float32."""
    chosen = np.unique(np.linspace(0, len(images) - 1, SAMPLES).astype(int))
    stack = np.stack([images[int(i)] for i in chosen])
    low, middle = (np.percentile(stack, level, axis=0).astype(np.float32) for level in (LEVEL, 50))
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


def excess(image: np.ndarray, scene: np.ndarray, limb: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Brightness above what the scene and the arm explain, (height, width) float32, at least 0.

    limb: where the arm may be, middle: where it surely is, (height, width) bool. The arm is
    taken to be as bright as along its middle; a string in front of it must be brighter.
    """
    body = np.median(image[middle]) if middle.any() else 0.0
    expected = np.where(limb, np.maximum(scene, body), scene)
    return np.maximum(image - expected, 0).astype(np.float32)


def threshold(difference: np.ndarray, sigmas: float) -> float:
    """Level that noise exceeds by `sigmas` of its own spread, from the median of what is above 0."""
    above = difference[difference > 0]
    return sigmas * float(np.median(above)) / 0.6745 if above.size else np.inf


def silhouette(shape: tuple[int, int], body: np.ndarray | None, width: float) -> np.ndarray:
    """Pixels within `width` / 2 [px] of the arm's links, bool. body: (J + 1, 2) joints [px] or None."""
    canvas = np.zeros(shape, np.uint8)
    if body is not None:
        pixels = np.rint(body * 16).astype(np.int32)
        cv2.polylines(canvas, [pixels[:, None]], False, 255, max(round(width), 1), cv2.LINE_8, 4)
    return canvas > 0
