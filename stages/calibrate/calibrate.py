"""Calibration of a camera: lens and plane from views of a board."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field, PositiveFloat

from stringcast.data.calibration import Calibration
from stringcast.data.schema import DataError
from stringcast.stages.calibrate.acceptance import (
    CalibrationSolution,
    CalibrationThresholds,
    rejection_reason,
)
from stringcast.stages.calibrate.board import Board
from stringcast.stages.calibrate.fit import fit_lens, held_out_rms
from stringcast.stages.calibrate.plane import BoardPlacement, fit_plane
from stringcast.stages.calibrate.tables import calibration_tables
from stringcast.stages.calibrate.views import BoardView, detect_board
from stringcast.stages.common import Progress
from stringcast.stages.model.camera import Camera
from stringcast.stages.spec import StageCall

MIN_SOLVABLE_VIEWS = 4  # fewer do not determine the lens
FOLDS = 4  # of the cross-validation of the lens


def run(
    call: StageCall,
    tilted: Sequence[np.ndarray],
    flat: Sequence[np.ndarray],
    board: Board,
) -> Calibration:
    """Calibrate the camera, as a stage.

    Parameters
    ----------
    call
        Camera, progress and the configured function.
    tilted, flat
        Pictures of the tilted board, and of the board in the plane of motion.
    board
        The board.

    Returns
    -------
    Calibration
        The camera, or the reason why it cannot be used.
    """
    return call.by(tilted, flat, board, call.setup.model.camera, progress=call.progress)


def calibrate(
    pictures: Sequence[np.ndarray],
    flat: Sequence[np.ndarray],
    board: Board,
    camera: Camera,
    *,
    place: BoardPlacement,
    views: Annotated[int, Field(ge=MIN_SOLVABLE_VIEWS)],
    spread: PositiveFloat,
    coverage: Annotated[float, Field(gt=0, le=1)],
    rms: PositiveFloat,
    outlier_ratio: Annotated[float, Field(gt=1)],
    progress: Progress = lambda share: None,
) -> Calibration:
    """Calibrate a camera with pictures of a board.

    Parameters
    ----------
    pictures
        Pictures of the board tilted in all directions, uint8 (height, width) or
        (height, width, 3).
    flat
        Pictures of the board in the plane of motion. The one with most corners is used.
    board
        The board.
    camera
        The camera. Its rate and exposure are kept.
    place
        Place of the board in the plane of motion.
    views
        Smallest number of usable views.
    spread
        Angle that the largest angle between two views must reach [rad].
    coverage
        Smallest share of the picture in which corners were seen.
    rms
        Largest reprojection error [px].
    outlier_ratio
        Largest error of a view relative to the median.
    progress
        Called with the share done.

    Returns
    -------
    Calibration
        The camera, or the violated limit.

    Raises
    ------
    DataError
        If too few pictures show the board.
    """
    all_views = []
    for number, picture in enumerate(pictures):
        all_views.append(detect_board(number, picture, board))
        # Detection takes most of the time.
        progress(0.9 * (number + 1) / len(pictures))
    used_views = _readable_views(all_views)
    plane_view = _plane_view(flat, board)
    sizes = sorted({view.image.shape[::-1] for view in (*all_views, plane_view)})
    if len(sizes) > 1:
        two_sizes = " and ".join(f"{width}x{height}" for width, height in sizes[:2])
        raise DataError(
            "",
            f"pictures are {two_sizes} px",
            "Take all with the camera set as for the experiment.",
        )
    width, height = map(int, sizes[0])
    lens = fit_lens(used_views, board, (width, height))
    solution = CalibrationSolution(
        used_views,
        lens,
        held_out_rms(used_views, board, (width, height), FOLDS),
        plane_view,
        fit_plane(
            plane_view, board, place, lens, replace(camera, width=width, height=height)
        ),
        (width, height),
    )
    thresholds = CalibrationThresholds(views, spread, coverage, rms, outlier_ratio)
    reason = rejection_reason(solution, thresholds)
    return calibration_tables(solution, all_views, reason)


def _readable_views(views: Sequence[BoardView]) -> list[BoardView]:
    """Return the views with a readable board; refuse too few."""
    readable = [view for view in views if not view.reason]
    if len(readable) < MIN_SOLVABLE_VIEWS:
        reasons = Counter(view.reason for view in views if view.reason)
        reason = f"; of most, {reasons.most_common(1)[0][0]}" if reasons else ""
        raise DataError(
            "",
            f"the board can be read in {len(readable)} of {len(views)} "
            f"pictures{reason}",
            "Take at least ten of the board in the settings (board=...): sharp, "
            "lit evenly, tilted in all directions, in all parts of the picture.",
        )
    return readable


def _plane_view(flat: Sequence[np.ndarray], board: Board) -> BoardView:
    """Return the view in the plane of motion with most corners."""
    if not len(flat):
        raise DataError(
            "",
            "there is no picture of the board in the plane of motion",
            "Take one.",
        )
    views = [detect_board(number, image, board) for number, image in enumerate(flat)]
    best = max(views, key=lambda view: len(view.corners))
    if best.reason:
        raise DataError(
            "",
            f"the board in the plane of motion: {best.reason}",
            "Hold it in view, lit and still.",
        )
    return best
