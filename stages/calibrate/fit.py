"""The lens from many views of a plane (Zhang, A flexible new technique for camera
calibration, 2000).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from stringcast.stages.calibrate.board import Board
from stringcast.stages.calibrate.views import BoardView
from stringcast.stages.model.lens import Lens

# a third radial coefficient is seldom determined, and bends the edge where nothing is
FLAGS = cv2.CALIB_FIX_K3
LENS_PARAMETERS = ("focal_x", "focal_y", "centre_x", "centre_y", "k1", "k2", "p1", "p2")
LENS_PARAMETER_COUNT = len(LENS_PARAMETERS)
Pose = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class LensFit:
    """lens, and of each view the pose: turn (3,) [rad] and place (3,) [m] of the board
    before the camera. covariance: (8, 8) of NAMES. errors: measured less projected
    corners of each view, (N, 2) [px].
    """

    lens: Lens
    poses: Sequence[Pose]
    covariance: np.ndarray
    errors: Sequence[np.ndarray] = field(repr=False)

    @property
    def normals(self) -> np.ndarray:
        """(V, 3), of the board in front of the camera."""
        return np.array([cv2.Rodrigues(turn)[0][:, 2] for turn, _ in self.poses])

    @property
    def rms(self) -> float:
        """Root mean square distance between measured and projected corners [px]."""
        return distance_rms(np.concatenate(self.errors))


def distance_rms(errors: np.ndarray) -> float:
    """Root mean square of distances. errors: (N, 2) [px]."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))


def fit_lens(
    views: Sequence[BoardView], board: Board, size: tuple[int, int]
) -> LensFit:
    """The lens that explains all views best. size: width and height [px]."""
    solid = [_board_points(board, view) for view in views]
    seen = [view.pixels.astype(np.float32) for view in views]
    _, matrix, bent, turns, places = cv2.calibrateCamera(
        solid, seen, size, None, None, flags=FLAGS
    )
    lens = lens_from_values(
        [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *bent.ravel()[:4]]
    )
    poses = [
        (turn.ravel(), place.ravel()) for turn, place in zip(turns, places, strict=True)
    ]
    errors = [
        view.pixels - project_corners(lens, board, view, *at)
        for view, at in zip(views, poses, strict=True)
    ]

    # covariance of the lens: the inverse of what the views say of it once each has
    # chosen its own pose
    known = np.zeros((LENS_PARAMETER_COUNT, LENS_PARAMETER_COUNT))
    for points, (turn, place) in zip(solid, poses, strict=True):
        _, slopes = cv2.projectPoints(
            points, turn, place, lens.matrix, np.array(lens.distortion)
        )
        own, common = slopes[:, :6], slopes[:, 6 : 6 + LENS_PARAMETER_COUNT]
        left = common - own @ np.linalg.lstsq(own, common, rcond=None)[0]
        known += left.T @ left
    every = np.concatenate(errors)
    freedom = every.size - LENS_PARAMETER_COUNT - 6 * len(poses)
    covariance = np.linalg.inv(known) * float((every**2).sum()) / max(freedom, 1)
    return LensFit(lens, poses, covariance, errors)


def lens_values(lens: Lens) -> np.ndarray:
    """Values (8,) of a lens in the order of NAMES."""
    return np.array([*lens.focal, *lens.centre, *lens.distortion])


def lens_from_values(values: Iterable[float]) -> Lens:
    """The lens with these values of NAMES (8,)."""
    fx, fy, cx, cy, k1, k2, p1, p2 = map(float, values)
    return Lens((fx, fy), (cx, cy), (k1, k2, p1, p2))


def held_out_rms(
    views: Sequence[BoardView], board: Board, size: tuple[int, int], folds: int
) -> np.ndarray:
    """RMS of each view with the lens of the others, (V,) [px]; only its pose is its
    own.
    """
    errors = np.zeros(len(views))
    for fold in range(folds):
        left = list(range(fold, len(views), folds))
        lens = fit_lens(
            [view for k, view in enumerate(views) if k not in left], board, size
        ).lens
        for k in left:
            errors[k] = distance_rms(
                views[k].pixels
                - project_corners(
                    lens, board, views[k], *board_pose(lens, board, views[k])
                )
            )
    return errors


def board_pose(lens: Lens, board: Board, view: BoardView) -> Pose:
    """Turn (3,) [rad] and place (3,) [m] of the board before a known lens."""
    bent = np.array(lens.distortion)
    _, turn, place = cv2.solvePnP(
        _board_points(board, view),
        view.pixels,
        lens.matrix,
        bent,
        flags=cv2.SOLVEPNP_IPPE,
    )
    turn, place = cv2.solvePnPRefineLM(
        _board_points(board, view), view.pixels, lens.matrix, bent, turn, place
    )
    return turn.ravel(), place.ravel()


def project_corners(
    lens: Lens, board: Board, view: BoardView, turn: np.ndarray, place: np.ndarray
) -> np.ndarray:
    """Corners of a view as the lens projects them, (N, 2) [px]."""
    pixels, _ = cv2.projectPoints(
        _board_points(board, view), turn, place, lens.matrix, np.array(lens.distortion)
    )
    return pixels.reshape(-1, 2)


def _board_points(board: Board, view: BoardView) -> np.ndarray:
    """Corners on the board, (N, 3) [m], as OpenCV has them: y down."""
    return board.points[view.corners].astype(np.float32)
