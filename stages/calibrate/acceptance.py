"""Whether a calibration can be used, and if not, why and what to do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from stringcast.stages.calibrate.fit import LensFit, distance_rms
from stringcast.stages.calibrate.plane import PlaneFit
from stringcast.stages.calibrate.views import BoardView

GRID_CELLS = 6  # of the picture across and down, in which corners are looked for
SIDES = ("left", "right", "top", "bottom")


@dataclass(frozen=True)
class CalibrationThresholds:
    """Acceptance thresholds of a calibration, the settings of `calibrate`."""

    views: int
    spread: float
    coverage: float
    rms: float
    astray: float


@dataclass(frozen=True)
class CalibrationSolution:
    """used: views of the board. lens: of them all; alone: RMS of each with the lens of
    the others (V,) [px]. held: the view in the plane of motion; plane: what follows.
    size: of the pictures [px].
    """

    used_views: Sequence[BoardView]
    lens: LensFit
    held_out_rms: np.ndarray
    plane_view: BoardView
    plane: PlaneFit
    size: tuple[int, int]

    @property
    def covered_cells(self) -> np.ndarray:
        """(CELLS, CELLS) bool, rows first: a corner was seen there."""
        every = np.concatenate([view.pixels for view in self.used_views])
        columns, rows = (
            np.clip(every * GRID_CELLS // np.array(self.size), 0, GRID_CELLS - 1)
            .astype(int)
            .T
        )
        filled = np.zeros((GRID_CELLS, GRID_CELLS), bool)
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
        return np.array([distance_rms(each) for each in self.lens.errors])

    @property
    def plane_rms(self) -> float:
        """RMS in the plane of motion [px]."""
        return distance_rms(self.plane_view.pixels - self.plane.fit)


def rejection_reason(
    solution: CalibrationSolution, thresholds: CalibrationThresholds
) -> str:
    """The reason why a calibration cannot be used, with the remedy; empty if it can.
    The first that is wrong explains those after it.
    """
    return next(
        chain(_view_faults(solution, thresholds), _lens_faults(solution, thresholds)),
        "",
    )


def _view_faults(
    solution: CalibrationSolution, thresholds: CalibrationThresholds
) -> Iterator[str]:
    """Too few views, views that are too much alike, and one that does not fit the
    others.
    """
    if len(solution.used_views) < thresholds.views:
        yield f"{len(solution.used_views)} views can be used, {thresholds.views} are needed. Take more."
    if not solution.spread >= thresholds.spread:
        there, needed = np.degrees([solution.spread, thresholds.spread])
        yield (
            f"the views differ in tilt by {there:.0f} degrees at most, {needed:.0f} are needed to tell focal length "
            "from distance. Tilt the board to the left, right, front and back."
        )
    errors = solution.held_out_rms
    worst, usual = int(np.argmax(errors)), float(np.median(errors))
    if not errors[worst] <= max(thresholds.astray * usual, thresholds.rms):
        yield (
            f"view {solution.used_views[worst].number} does not fit the others: {errors[worst]:.2f} px, usual are "
            f"{usual:.2f}. Leave it out, or take it again with board and camera still."
        )


def _lens_faults(
    solution: CalibrationSolution, thresholds: CalibrationThresholds
) -> Iterator[str]:
    """A lens that does not explain the views, or is not known all over the picture; a
    plane that is off.
    """
    if not solution.lens.rms <= thresholds.rms:  # what is no number is refused, too
        yield (
            f"the reprojection error is {solution.lens.rms:.2f} px, allowed are {thresholds.rms:g}. See that the board "
            "is the one of the settings, flat, sharp and still, and that focus and zoom do not change."
        )
    filled, half = solution.covered_cells, GRID_CELLS // 2
    if not filled.mean() >= thresholds.coverage:
        parts = (filled[:, :half], filled[:, half:], filled[:half], filled[half:])
        emptiest = SIDES[int(np.argmin([part.mean() for part in parts]))]
        yield (
            f"corners were seen in {filled.mean():.0%} of the picture, {thresholds.coverage:.0%} are needed, and "
            f"fewest in its {emptiest} half: the lens is not known there. Bring the board there too."
        )
    if not solution.plane_rms <= thresholds.rms:
        yield (
            f"the view in the plane of motion is off by {solution.plane_rms:.2f} px, allowed are {thresholds.rms:g}. "
            "Hold the board flat and still, and leave focus and zoom as they were."
        )
