"""Centre-line: the ordered line from the grasp to the tip, to a fraction of a pixel.

The string's pixels are a graph. Depth is the cost of the cheapest way from the grasp, dear
where the string is faint, so that ways run along its ridge; the tip is the deepest pixel
and the way to it is the centre-line (the search from the grasp of IV-B). Each point is
then moved to the centroid of brightness across the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
GAP = 7  # [px] across which a broken string is joined
FAINT = 6.0  # how much dearer a pixel without brightness is
HALF = 4  # [px] half the width of the profile across the line


class UnreadableError(Exception):
    """The frame cannot be read; the message is the reason."""


@dataclass(frozen=True)
class Line:
    """points: (K, 2) [px], from the grasp to the tip. sigma: (K,) across the line [px]."""

    points: np.ndarray
    sigma: np.ndarray

    @property
    def depth(self) -> np.ndarray:
        """(K,) length along the line from its start [px]."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])


def trace(
    difference: np.ndarray, mask: np.ndarray, limb: np.ndarray, grasp: np.ndarray, start_radius: float
) -> np.ndarray:
    """Pixels (K, 2) as (u, v) from near the grasp to the tip. grasp: (2,) [px].

    limb: (height, width) bool, where the arm is: the string may go on in front of it unseen.
    """
    allowed = (cv2.dilate(mask, np.ones((GAP, GAP), np.uint8)) > 0) | limb
    rows, columns = np.nonzero(allowed)
    inside = mask[rows, columns] > 0
    if not inside.any():
        raise UnreadableError("no string in view")
    distance = np.hypot(columns - grasp[0], rows - grasp[1])
    if distance[inside].min() > start_radius:
        raise UnreadableError("no string at the grasp")
    depth, before = dijkstra(_graph(difference, allowed), indices=int(np.argmin(distance)), return_predecessors=True)
    reached = np.where(np.isfinite(depth) & inside, depth, -1.0)
    return _way(before, int(np.argmax(reached)), np.stack([columns, rows], axis=-1).astype(float))


def refine(difference: np.ndarray, way: np.ndarray, noise: float) -> Line:
    """Move points to the centroid of brightness across the line; sigma from noise [grey levels]."""
    smooth = gaussian_filter1d(way, 2.0, axis=0, mode="nearest")
    tangent = np.gradient(smooth, axis=0) if len(smooth) > 1 else np.array([[1.0, 0.0]])
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
    across = np.arange(-HALF, HALF + 0.25, 0.5)
    places = (smooth[:, None] + across[None, :, None] * normal[:, None]).astype(np.float32)
    profile = cv2.remap(difference, places[..., 0], places[..., 1], cv2.INTER_LINEAR)
    bright = np.maximum(profile - 2 * noise, 0)
    total = bright.sum(axis=1)
    shift = (bright * across).sum(axis=1) / np.maximum(total, 1e-9)
    sigma = 2 * noise * np.sqrt((across**2).sum() / 2) / np.maximum(total, 1e-9)
    lost = total < 4 * noise
    shift[lost], sigma[lost] = 0.0, HALF / 2
    moved = smooth + gaussian_filter1d(np.clip(shift, -HALF, HALF), 1.0, mode="nearest")[:, None] * normal
    return Line(_with_ends(moved, way), np.hypot(sigma, 0.2))


def _with_ends(moved: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Smoothing shortens the line: let it end where the last pixel is."""
    if len(moved) < 2:
        return moved
    ahead = moved[-1] - moved[-2]
    ahead /= max(float(np.linalg.norm(ahead)), 1e-9)
    return np.concatenate([moved[:-1], [moved[-1] + ahead * max(float((way[-1] - moved[-1]) @ ahead), 0.0)]])


def _graph(difference: np.ndarray, allowed: np.ndarray) -> coo_array:
    """Steps between neighbouring allowed pixels, priced by length and faintness."""
    number = np.full(allowed.shape, -1)
    count = int(allowed.sum())
    number[allowed] = np.arange(count)
    bright = np.minimum(difference / max(float(np.percentile(difference[allowed], 95)), 1e-6), 1.0)
    price = 1 + FAINT * (1 - bright[allowed])
    padded = np.pad(number, 1, constant_values=-1)
    inner = padded[1:-1, 1:-1]
    a, b, w = [], [], []
    for dv, du in NEIGHBOURS:
        other = padded[1 + dv : padded.shape[0] - 1 + dv, 1 + du : padded.shape[1] - 1 + du]
        joined = (inner >= 0) & (other >= 0)
        first, second = inner[joined], other[joined]
        a.append(first)
        b.append(second)
        w.append(np.hypot(dv, du) * (price[first] + price[second]) / 2)
    first, second, weight = np.concatenate(a), np.concatenate(b), np.concatenate(w)
    both = (np.concatenate([weight, weight]), (np.concatenate([first, second]), np.concatenate([second, first])))
    return coo_array(both, shape=(count, count)).tocsr()


def _way(before: np.ndarray, end: int, places: np.ndarray) -> np.ndarray:
    """From the start of the search to `end`."""
    way = [end]
    while before[way[-1]] >= 0:
        way.append(int(before[way[-1]]))
    return places[way[::-1]]
