"""Quality checks of a centre-line. A frame that fails one is refused.

A wrong line biases the estimate, and a refused frame only costs a frame.

The total light across a string is the same all along it, with any blur. Missing light
is a bridged gap; twice the light is another line on top. Light next to the line and
connected with it is a loop that the line cut off, or another object.
"""

from __future__ import annotations

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.extract.centreline import Centreline, UnreadableError
from stringcast.stages.extract.score import rasterise
from stringcast.stages.model.polyline import step_lengths

cv2 = LazyModule("cv2")

# Relative to the line's typical light.
MIN_RELATIVE_LIGHT = 0.35
MAX_RELATIVE_LIGHT = 1.8
# Longest run of dimmer or brighter points, in pixels or in widths of the string,
# whichever is larger.
MAX_GAP_PX = 6.0
MAX_GAP_WIDTHS = 1.0
MAX_OVERLAP_PX = 9.0
MAX_OVERLAP_WIDTHS = 1.5
MAX_ATTACHED_SHARE = 0.06  # of the line's length


def check_line(line: Centreline, mask: np.ndarray, half_width: float) -> None:
    """Raise UnreadableError with the reason if the line fails a quality check.

    mask: pixels of the string, (height, width) uint8. half_width: half its width [px].
    """
    step = np.append(step_lengths(line.points), 0.0)
    typical = 0.0
    if np.isfinite(line.light).any():
        typical = float(np.nanmedian(line.light))
    width = 2 * half_width
    gap = longest_run(line.light < MIN_RELATIVE_LIGHT * typical, step)
    if gap > max(MAX_GAP_PX, MAX_GAP_WIDTHS * width):
        raise UnreadableError("the string is interrupted")
    overlap = longest_run(line.light > MAX_RELATIVE_LIGHT * typical, step)
    if overlap > max(MAX_OVERLAP_PX, MAX_OVERLAP_WIDTHS * width):
        raise UnreadableError("the string lies on itself, or on something like it")
    if attached_length(line, mask, half_width) > MAX_ATTACHED_SHARE * line.depth[-1]:
        raise UnreadableError("something like a string hangs together with the string")


def longest_run(selected: np.ndarray, step: np.ndarray) -> float:
    """Measure the longest run of selected points [px].

    selected: (K,) bool. step: (K,) distance to the next point [px].
    """
    run = longest = 0.0
    for is_selected, length in zip(selected, step, strict=True):
        run = run + length if is_selected else 0.0
        longest = max(longest, run)
    return longest


def attached_length(line: Centreline, mask: np.ndarray, half_width: float) -> float:
    """Measure the pixels connected with the line but not on it, as a length [px].

    Their width counts as that of the line.
    """
    near = rasterise(line.points, mask.shape, 5 + 4 * half_width) > 0
    is_string = mask > 0
    patch = cv2.connectedComponents(mask, connectivity=8)[1]
    # Pixels of each patch: on the line, and in total.
    on_line = np.bincount(patch[near & is_string], minlength=patch.max() + 1)
    total = np.bincount(patch[is_string], minlength=patch.max() + 1)
    attached = (total - on_line)[on_line > 0].sum()
    return float(attached / max(on_line.sum(), 1) * line.depth[-1])
