"""Quality checks of a centre-line. A frame that fails one is refused: a wrong line
biases the estimate, a refused frame only costs a frame.

The light across a string is the same all along it, however blurred: where it is
missing, a gap was bridged; where it is twice too much, another line lies on top. Light
beside the line that is connected with it is a loop cut short, or something that is no
string.
"""

from __future__ import annotations

import cv2
import numpy as np

from stringcast.stages.extract.centreline import Centreline, UnreadableError
from stringcast.stages.extract.score import rasterise

MIN_RELATIVE_LIGHT, MAX_RELATIVE_LIGHT = 0.35, 1.8  # of the line's typical light
# [px] along the line for which it may be dimmer, or brighter
MAX_GAP_WIDTHS, MAX_HEAP_WIDTHS = 6.0, 9.0
WIDTH_RANGE = 1.0, 1.5  # ... or so many times its width, if that is more
MAX_ATTACHED_SHARE = 0.06  # of the line's length: what may be beside it


def check_line(line: Centreline, mask: np.ndarray, half: float) -> None:
    """Raise UnreadableError with the reason where the line fails a quality check. mask:
    (height, width) uint8, the string's pixels. half: half its width [px].
    """
    step = np.append(np.linalg.norm(np.diff(line.points, axis=0), axis=1), 0.0)
    typical = float(np.nanmedian(line.light)) if np.isfinite(line.light).any() else 0.0
    if longest_run(line.light < MIN_RELATIVE_LIGHT * typical, step) > max(
        MAX_GAP_WIDTHS, WIDTH_RANGE[0] * 2 * half
    ):
        raise UnreadableError("the string is interrupted")
    if longest_run(line.light > MAX_RELATIVE_LIGHT * typical, step) > max(
        MAX_HEAP_WIDTHS, WIDTH_RANGE[1] * 2 * half
    ):
        raise UnreadableError("the string lies on itself, or on something like it")
    if attached_length(line, mask, half) > MAX_ATTACHED_SHARE * line.depth[-1]:
        raise UnreadableError("something like a string hangs together with the string")


def longest_run(these: np.ndarray, step: np.ndarray) -> float:
    """Length of the longest run of points [px]. these: (K,) bool, step: (K,) to the
    next point [px].
    """
    run = best = 0.0
    for there, length in zip(these, step, strict=True):
        run = run + length if there else 0.0
        best = max(best, run)
    return best


def attached_length(line: Centreline, mask: np.ndarray, half: float) -> float:
    """Length of what hangs together with the line and is not on it, were it as wide as
    the line [px].
    """
    near = rasterise(line.points, mask.shape, 5 + 4 * half) > 0
    patch = cv2.connectedComponents(mask, connectivity=8)[1]
    on = np.bincount(patch[near & (mask > 0)], minlength=patch.max() + 1)
    whole = np.bincount(patch[mask > 0], minlength=patch.max() + 1)
    return float(((whole - on)[on > 0]).sum() / max(on.sum(), 1) * line.depth[-1])
