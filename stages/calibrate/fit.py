"""Fit of the lens to many views of a plane.

References
----------
Zhang, "A flexible new technique for camera calibration", 2000.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.calibrate.board import Board
from stringcast.stages.calibrate.views import BoardView
from stringcast.stages.model.lens import Lens

cv2 = LazyModule("cv2")

LENS_PARAMETERS = ("focal_x", "focal_y", "centre_x", "centre_y", "k1", "k2", "p1", "p2")
LENS_PARAMETER_COUNT = len(LENS_PARAMETERS)
Pose = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class LensFit:
    """A lens fitted to views of a board.

    Attributes
    ----------
    lens
        The lens.
    poses
        Rotation vector (3,) [rad] and position (3,) [m] of the board in each view.
    covariance
        Covariance of LENS_PARAMETERS (8, 8).
    errors
        Measured minus projected corners of each view (N, 2) [px].
    """

    lens: Lens
    poses: Sequence[Pose]
    covariance: np.ndarray
    errors: Sequence[np.ndarray] = field(repr=False)

    @property
    def normals(self) -> np.ndarray:
        """Normals of the board in the camera's frame (V, 3)."""
        return np.array([cv2.Rodrigues(vector)[0][:, 2] for vector, _ in self.poses])

    @property
    def rms(self) -> float:
        """Root mean square distance between measured and projected corners [px]."""
        return distance_rms(np.concatenate(self.errors))


def distance_rms(errors: np.ndarray) -> float:
    """Return the root mean square length of errors (N, 2) [px]."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))


def fit_lens(
    views: Sequence[BoardView], board: Board, size: tuple[int, int]
) -> LensFit:
    """Fit the lens to all views. size: width and height of the pictures [px]."""
    points = [_board_points(board, view) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    # A third radial coefficient is seldom determined, and distorts edges without data.
    with _one_opencv_thread():
        _, matrix, distortion, rotations, places = cv2.calibrateCamera(
            points, pixels, size, None, None, flags=cv2.CALIB_FIX_K3
        )
    focal = matrix[[0, 1], [0, 1]]
    lens = lens_from_values([*focal, *matrix[:2, 2], *distortion.ravel()[:4]])
    poses, errors = [], []
    for view, rotation, place in zip(views, rotations, places, strict=True):
        pose = rotation.ravel(), place.ravel()
        poses.append(pose)
        errors.append(view.pixels - project_corners(lens, board, view, *pose))
    covariance = _lens_covariance(lens, points, poses, np.concatenate(errors))
    return LensFit(lens, poses, covariance, errors)


@contextmanager
def _one_opencv_thread() -> Iterator[None]:
    """Let OpenCV use one thread: the order of several changes the last digits."""
    count = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(count)


def _lens_covariance(
    lens: Lens, points: Sequence[np.ndarray], poses: Sequence[Pose], errors: np.ndarray
) -> np.ndarray:
    """Return the covariance of LENS_PARAMETERS, (8, 8), with unknown poses.

    A and B are the Jacobians of a view's corners by its pose and by the lens. The part
    of B that no pose explains informs about the lens:

        R = B - A A^+ B,    covariance = s^2 (sum of R^T R over the views)^-1.

    s^2 is the sum of squared errors (N, 2) [px] over the degrees of freedom. points:
    corners on the board (K, 3) [m] of each view.
    """
    information = np.zeros((LENS_PARAMETER_COUNT, LENS_PARAMETER_COUNT))
    for board_points, pose in zip(points, poses, strict=True):
        _, jacobian = cv2.projectPoints(
            board_points, *pose, lens.matrix, np.array(lens.distortion)
        )
        by_pose, by_lens, _ = np.split(jacobian, [6, 6 + LENS_PARAMETER_COUNT], axis=1)
        along_pose = by_pose @ np.linalg.lstsq(by_pose, by_lens, rcond=None)[0]
        remaining = by_lens - along_pose
        information += remaining.T @ remaining
    freedom = errors.size - LENS_PARAMETER_COUNT - 6 * len(poses)
    variance_sum = float((errors**2).sum())
    return np.linalg.inv(information) * variance_sum / max(freedom, 1)


def lens_values(lens: Lens) -> np.ndarray:
    """Return the values of a lens in the order of LENS_PARAMETERS (8,)."""
    return np.array([*lens.focal, *lens.centre, *lens.distortion])


def lens_from_values(values: Iterable[float]) -> Lens:
    """Return the lens with these values of LENS_PARAMETERS (8,)."""
    fx, fy, cx, cy, k1, k2, p1, p2 = map(float, values)
    return Lens((fx, fy), (cx, cy), (k1, k2, p1, p2))


def held_out_rms(
    views: Sequence[BoardView], board: Board, size: tuple[int, int], folds: int
) -> np.ndarray:
    """Cross-validate the lens: fit only the pose of a view, with a lens from others.

    Parameters
    ----------
    views
        Views of the board.
    board
        The board.
    size
        Width and height of the pictures [px].
    folds
        Number of groups of views, each predicted by a lens from the other groups.

    Returns
    -------
    array
        RMS of each view (V,) [px].
    """
    errors = np.zeros(len(views))
    for fold in range(folds):
        training = [view for k, view in enumerate(views) if k % folds != fold]
        lens = fit_lens(training, board, size).lens
        for k in range(fold, len(views), folds):
            pose = board_pose(lens, board, views[k])
            projected = project_corners(lens, board, views[k], *pose)
            errors[k] = distance_rms(views[k].pixels - projected)
    return errors


def board_pose(lens: Lens, board: Board, view: BoardView) -> Pose:
    """Return rotation vector (3,) [rad] and position (3,) [m] of a view's board."""
    points = _board_points(board, view)
    distortion = np.array(lens.distortion)
    known = (points, view.pixels, lens.matrix, distortion)
    _, rotation, place = cv2.solvePnP(*known, flags=cv2.SOLVEPNP_IPPE)
    rotation, place = cv2.solvePnPRefineLM(*known, rotation, place)
    return rotation.ravel(), place.ravel()


def project_corners(
    lens: Lens, board: Board, view: BoardView, rotation: np.ndarray, place: np.ndarray
) -> np.ndarray:
    """Project the corners of a view (N, 2) [px]."""
    points = _board_points(board, view)
    distortion = np.array(lens.distortion)
    pixels, _ = cv2.projectPoints(points, rotation, place, lens.matrix, distortion)
    return pixels.reshape(-1, 2)


def _board_points(board: Board, view: BoardView) -> np.ndarray:
    """Return corners on the board (N, 3) [m] in OpenCV's axes."""
    return board.points[view.corners].astype(np.float32)
