"""Calibrate: the lens from many tilted views of a board, the plane of motion from one
view of it in that plane.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

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

MIN_SOLVABLE_VIEWS = 4  # views below which there is nothing to judge
# of the cross-validation of the lens: each view is predicted by a lens that has not
# seen it
FOLDS = 4


def run(
    call: StageCall,
    tilted: Sequence[np.ndarray],
    flat: Sequence[np.ndarray],
    board: Board,
) -> Calibration:
    """The camera, as a stage."""
    made: Calibration = call.by(
        tilted, flat, board, call.setup.model.camera, progress=call.progress
    )
    return made


def calibrate(
    pictures: Sequence[np.ndarray],
    flat: Sequence[np.ndarray],
    board: Board,
    camera: Camera,
    *,
    place: BoardPlacement,
    views: Annotated[int, Field(ge=MIN_SOLVABLE_VIEWS)],
    spread: Annotated[float, Field(gt=0)],
    coverage: Annotated[float, Field(gt=0, le=1)],
    rms: Annotated[float, Field(gt=0)],
    astray: Annotated[float, Field(gt=1)],
    progress: Progress = lambda share: None,
) -> Calibration:
    """Calibration of `camera`, whose rate and exposure are kept.

    pictures: of the board tilted in all directions. flat: of the board held in the
    plane of motion, of which the one with most corners is used. Both uint8 (height,
    width) or (height, width, 3).

    place: of the board in that plane. views: fewest that must be usable. spread: least
    angle between two of them [rad]. coverage: least share of the picture where corners
    were seen. rms: largest reprojection error [px]. astray: times the usual error that
    no view's may be. What misses one of these is in the artifact, with the reason.
    Raises DataError where there is too little to work out anything.
    """
    seen = []
    for number, picture in enumerate(pictures):
        seen.append(detect_board(number, picture, board))
        # most of the time goes into finding the markers
        progress(0.9 * (number + 1) / len(pictures))
    used = _readable_views(seen)
    held = _plane_view(flat, board)
    sizes = sorted({view.image.shape[::-1] for view in (*seen, held)})
    if len(sizes) > 1:
        several = " and ".join(f"{width}x{height}" for width, height in sizes[:2])
        raise DataError(
            f"pictures are {several} px. Take all with the camera set as for the experiment."
        )
    size = (int(sizes[0][0]), int(sizes[0][1]))
    lens = fit_lens(used, board, size)
    alone = held_out_rms(used, board, size, FOLDS)
    plane = fit_plane(
        held, board, place, lens, replace(camera, width=size[0], height=size[1])
    )
    solution = CalibrationSolution(used, lens, alone, held, plane, size)
    return calibration_tables(
        solution,
        seen,
        rejection_reason(
            solution, CalibrationThresholds(views, spread, coverage, rms, astray)
        ),
    )


def _readable_views(seen: Sequence[BoardView]) -> list[BoardView]:
    """The views in which the board can be read. Raises DataError where there are too
    few.
    """
    used = [view for view in seen if not view.reason]
    if len(used) < MIN_SOLVABLE_VIEWS:
        reasons = Counter(view.reason for view in seen if view.reason)
        why = f"; of most, {reasons.most_common(1)[0][0]}" if reasons else ""
        raise DataError(
            f"the board can be read in {len(used)} of {len(seen)} pictures{why}. Take ten and more of the board in the "
            "settings (board=...), sharp, lit evenly, tilted in all directions and all over the picture."
        )
    return used


def _plane_view(flat: Sequence[np.ndarray], board: Board) -> BoardView:
    """The view in the plane of motion."""
    seen = [detect_board(number, picture, board) for number, picture in enumerate(flat)]
    if not seen:
        raise DataError(
            "the board in the plane of motion: there is no picture of it. Take one."
        )
    best = max(seen, key=lambda view: len(view.corners))
    if best.reason:
        raise DataError(
            f"the board in the plane of motion: {best.reason}. Hold it in view, lit and still."
        )
    return best
