"""Whether a calibration can be used, and if not, why and what to do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.stages.calibrate.fit import Fitted, rms
from stringcast.stages.calibrate.plane import Plane
from stringcast.stages.calibrate.views import View

CELLS = 6  # of the picture across and down, in which corners are looked for
SIDES = ("left", "right", "top", "bottom")


@dataclass(frozen=True)
class Thresholds:
    """Acceptance thresholds of a calibration, the settings of `calibrate`."""

    views: int
    spread: float
    coverage: float
    rms: float
    astray: float


@dataclass(frozen=True)
class Solution:
    """used: views of the board. lens: of them all; alone: RMS of each with the lens of the others (V,) [px]. held: the
    view in the plane of motion; plane: what follows. size: of the pictures [px]."""

    used: Sequence[View]
    lens: Fitted
    alone: np.ndarray
    held: View
    plane: Plane
    size: tuple[int, int]

    @property
    def filled(self) -> np.ndarray:
        """(CELLS, CELLS) bool, rows first: a corner was seen there."""
        every = np.concatenate([view.pixels for view in self.used])
        columns, rows = np.clip(every * CELLS // np.array(self.size), 0, CELLS - 1).astype(int).T
        filled = np.zeros((CELLS, CELLS), bool)
        filled[rows, columns] = True
        return filled

    @property
    def spread(self) -> float:
        """Largest angle between two views of the board [rad]."""
        cosines = self.lens.normals @ self.lens.normals.T
        return float(np.arccos(np.clip(cosines.min(), -1, 1)))

    @property
    def errors(self) -> np.ndarray:
        """RMS of each view (V,) [px]."""
        return np.array([rms(each) for each in self.lens.errors])

    @property
    def plane_rms(self) -> float:
        """RMS in the plane of motion [px]."""
        return rms(self.held.pixels - self.plane.fit)


def reason(solution: Solution, thresholds: Thresholds) -> str:
    """The reason why a calibration cannot be used, with the remedy; empty if it can. The first that is wrong explains
    those after it."""
    return next(filter(None, (check(solution, thresholds) for check in CHECKS)), "")


def _few(solution: Solution, thresholds: Thresholds) -> str:
    if len(solution.used) >= thresholds.views:
        return ""
    return f"{len(solution.used)} views can be used, {thresholds.views} are needed. Take more."


def _one_bad(solution: Solution, thresholds: Thresholds) -> str:
    errors = solution.alone
    worst, usual = int(np.argmax(errors)), float(np.median(errors))
    if errors[worst] <= thresholds.astray * usual or errors[worst] <= thresholds.rms:
        return ""
    return (
        f"view {solution.used[worst].number} does not fit the others: {errors[worst]:.2f} px, usual are {usual:.2f}. "
        "Leave it out, or take it again with board and camera still."
    )


def _parallel(solution: Solution, thresholds: Thresholds) -> str:
    if solution.spread >= thresholds.spread:
        return ""
    there, needed = np.degrees([solution.spread, thresholds.spread])
    return (
        f"the views differ in tilt by {there:.0f} degrees at most, {needed:.0f} are needed to tell focal length "
        "from distance. Tilt the board to the left, right, front and back."
    )


def _inaccurate(solution: Solution, thresholds: Thresholds) -> str:
    if solution.lens.rms <= thresholds.rms:
        return ""
    return (
        f"the reprojection error is {solution.lens.rms:.2f} px, allowed are {thresholds.rms:g}. See that the board "
        "is the one of the settings, flat, sharp and still, and that focus and zoom do not change."
    )


def _uncovered(solution: Solution, thresholds: Thresholds) -> str:
    filled = solution.filled
    if filled.mean() >= thresholds.coverage:
        return ""
    half = CELLS // 2
    parts = (filled[:, :half], filled[:, half:], filled[:half], filled[half:])
    emptiest = SIDES[int(np.argmin([part.mean() for part in parts]))]
    return (
        f"corners were seen in {filled.mean():.0%} of the picture, {thresholds.coverage:.0%} are needed, and fewest in "
        f"its {emptiest} half: the lens is not known there. Bring the board there too."
    )


def _plane_off(solution: Solution, thresholds: Thresholds) -> str:
    if solution.plane_rms <= thresholds.rms:
        return ""
    return (
        f"the view in the plane of motion is off by {solution.plane_rms:.2f} px, allowed are {thresholds.rms:g}. Hold "
        "the board flat and still, and leave focus and zoom as they were."
    )


CHECKS: tuple[Callable[[Solution, Thresholds], str], ...] = (
    _few,
    _parallel,
    _one_bad,
    _inaccurate,
    _uncovered,
    _plane_off,
)
