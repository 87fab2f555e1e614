"""Rules by which a calibration is rejected, with the reason and the remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.stages.calibrate.fit import LensFit, distance_rms
from stringcast.stages.calibrate.plane import PlaneFit
from stringcast.stages.calibrate.views import BoardView

GRID_CELLS = 6  # of the picture, across and down
SIDES = ("left", "right", "top", "bottom")


@dataclass(frozen=True)
class CalibrationThresholds:
    """Acceptance thresholds of a calibration: the settings of `calibrate`."""

    views: int
    spread: float
    coverage: float
    rms: float
    outlier_ratio: float


@dataclass(frozen=True)
class CalibrationSolution:
    """Results of a calibration before it is accepted.

    Attributes
    ----------
    used_views
        The V usable views of the tilted board.
    lens
        The lens fitted to all these views.
    held_out_rms
        RMS of each view with a lens fitted to others (V,) [px].
    plane_view, plane
        The view in the plane of motion, and its fit.
    size
        Width and height of the pictures [px].
    """

    used_views: Sequence[BoardView]
    lens: LensFit
    held_out_rms: np.ndarray
    plane_view: BoardView
    plane: PlaneFit
    size: tuple[int, int]

    @property
    def covered_cells(self) -> np.ndarray:
        """Whether a corner was seen in each cell of the picture, rows first."""
        pixels = np.concatenate([view.pixels for view in self.used_views])
        cells = np.clip(pixels * GRID_CELLS // np.array(self.size), 0, GRID_CELLS - 1)
        columns, rows = cells.astype(int).T
        is_covered = np.zeros((GRID_CELLS, GRID_CELLS), bool)
        is_covered[rows, columns] = True
        return is_covered

    @property
    def spread(self) -> float:
        """Largest angle between two views of the board [rad]."""
        cosines = self.lens.normals @ self.lens.normals.T
        return float(np.arccos(np.clip(cosines.min(), -1, 1)))

    @property
    def errors(self) -> np.ndarray:
        """RMS errors of the views (V,) [px]."""
        return np.array([distance_rms(errors) for errors in self.lens.errors])

    @property
    def plane_rms(self) -> float:
        """RMS error in the plane of motion [px]."""
        return distance_rms(self.plane_view.pixels - self.plane.fit)


def rejection_reason(
    solution: CalibrationSolution, thresholds: CalibrationThresholds
) -> str:
    """Return the first fault of a calibration, which may cause the later ones.

    Parameters
    ----------
    solution
        The results.
    thresholds
        Limits of the results.

    Returns
    -------
    str
        The reason with the remedy; empty if the calibration can be used.
    """
    return _view_fault(solution, thresholds) or _lens_fault(solution, thresholds)


def _view_fault(
    solution: CalibrationSolution, thresholds: CalibrationThresholds
) -> str:
    """Return a fault of number, tilt or consistency of the views."""
    views = solution.used_views
    if len(views) < thresholds.views:
        return (
            f"{len(views)} views can be used, {thresholds.views} are needed. Take more."
        )
    # Comparisons are negated so that NaN is refused.
    if not solution.spread >= thresholds.spread:
        spread, needed = np.degrees([solution.spread, thresholds.spread])
        return (
            f"the views differ in tilt by {spread:.0f} degrees at most, {needed:.0f} "
            "are needed to distinguish focal length from distance. Tilt the board to "
            "the left, right, front and back."
        )
    errors = solution.held_out_rms
    worst, median = int(np.argmax(errors)), float(np.median(errors))
    if not errors[worst] <= max(thresholds.outlier_ratio * median, thresholds.rms):
        return (
            f"view {views[worst].number} does not fit the others: {errors[worst]:.2f} "
            f"px, the median is {median:.2f}. Leave it out, or take it again with "
            "board and camera still."
        )
    return ""


def _lens_fault(
    solution: CalibrationSolution, thresholds: CalibrationThresholds
) -> str:
    """Return a fault of the lens, of its coverage, or of the plane."""
    if not solution.lens.rms <= thresholds.rms:
        return (
            f"the reprojection error is {solution.lens.rms:.2f} px, allowed are "
            f"{thresholds.rms:g}. Use the board of the settings, flat, sharp and "
            "still, and do not change focus and zoom."
        )
    cells, half = solution.covered_cells, GRID_CELLS // 2
    if not cells.mean() >= thresholds.coverage:
        halves = (cells[:, :half], cells[:, half:], cells[:half], cells[half:])
        emptiest = SIDES[int(np.argmin([part.mean() for part in halves]))]
        return (
            f"corners were seen in {cells.mean():.0%} of the picture, "
            f"{thresholds.coverage:.0%} are needed, and fewest in its {emptiest} half: "
            "the lens is not known there. Take views of the board there too."
        )
    if not solution.plane_rms <= thresholds.rms:
        return (
            f"the view in the plane of motion is off by {solution.plane_rms:.2f} px, "
            f"allowed are {thresholds.rms:g}. Hold the board flat and still, and leave "
            "focus and zoom as they were."
        )
    return ""
