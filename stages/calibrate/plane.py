"""Fit of the plane of motion to one view of the board, with a known lens."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.calibrate.board import Board
from stringcast.stages.calibrate.fit import (
    LensFit,
    board_pose,
    distance_rms,
    lens_from_values,
    lens_values,
)
from stringcast.stages.calibrate.views import BoardView
from stringcast.stages.model.camera import CAMERA_AXES, Camera
from stringcast.stages.model.lens import Lens

cv2 = LazyModule("cv2")


@dataclass(frozen=True)
class BoardPlacement:
    """Place of the board's pattern in the world.

    Attributes
    ----------
    corner
        Lower left corner of the pattern [m].
    turn
        Angle of its lower edge to the world's x, counter-clockwise [rad].
    """

    corner: tuple[float, float]
    turn: float

    def to_world(self, board: np.ndarray) -> np.ndarray:
        """Transform points on the board (N, 2) [m] to the world."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return board @ np.array([[c, s], [-s, c]]) + np.array(self.corner)


@dataclass(frozen=True)
class PlaneFit:
    """A camera with lens and plane.

    Attributes
    ----------
    camera
        The camera.
    sigma
        Standard deviations of scale, origin (u, v), rotation and tilt about x and y
        (6,), including the uncertainty of the lens.
    fit
        Projected corners (N, 2) [px].
    """

    camera: Camera
    sigma: np.ndarray
    fit: np.ndarray


def fit_plane(
    view: BoardView, board: Board, place: BoardPlacement, lens: LensFit, camera: Camera
) -> PlaneFit:
    """Fit scale, origin, rotation and tilt of the camera.

    Parameters
    ----------
    view
        The view of the board in the plane of motion.
    board
        The board.
    place
        Placement of the board.
    lens
        The fitted lens.
    camera
        The camera. Its size, rate and exposure are kept.

    Returns
    -------
    PlaneFit
        The camera with standard deviations.
    """
    world = place.to_world(board.corners[view.corners])
    plain = replace(camera, distortion=0.0, lens=lens.lens)
    start = _plane_from_pose(view, board, place, lens.lens)
    values, jacobian = _solve_plane(plain, world, view.pixels, start)
    fitted = _camera(plain, values)
    error = distance_rms(view.pixels - fitted.pixels(world))
    count = view.pixels.size
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    covariance = inverse * error**2 / 2 * count / (count - len(values))
    # Uncertainty of the lens.
    for step in np.linalg.cholesky(lens.covariance).T:
        other = replace(plain, lens=lens_from_values(lens_values(lens.lens) + step))
        change = _solve_plane(other, world, view.pixels, values)[0] - values
        covariance += np.outer(change, change)
    return PlaneFit(fitted, np.sqrt(np.diag(covariance)), fitted.pixels(world))


def _plane_from_pose(
    view: BoardView, board: Board, place: BoardPlacement, lens: Lens
) -> np.ndarray:
    """Return the values of the plane (6,) from OpenCV's pose of the board.

    OpenCV's y points down on the board, and its z into it.
    """
    vector, board_place = board_pose(lens, board, view)
    board_axes = cv2.Rodrigues(vector)[0]
    turn = Rotation.from_euler("z", -place.turn).as_matrix()
    axes = board_axes @ CAMERA_AXES @ turn  # world axes in the camera's frame
    lower_left = board_place + board_axes @ np.array([0, board.size[1], 0])
    origin = lower_left - axes @ np.array([*place.corner, 0.0])
    tilt_x, tilt_y, roll = Rotation.from_matrix(axes @ CAMERA_AXES).as_euler("XYZ")
    depth = axes[:, 2] @ origin / axes[2, 2]
    u, v, w = lens.matrix @ origin
    return np.array([lens.mean_focal / depth, u / w, v / w, -roll, tilt_x, tilt_y])


def _solve_plane(
    camera: Camera, world: np.ndarray, pixels: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of a plane (6,) and the Jacobian of the pixels (2 N, 6)."""

    def residuals(values: np.ndarray) -> np.ndarray:
        return (_camera(camera, values).pixels(world) - pixels).ravel()

    solution = least_squares(residuals, start, x_scale="jac", xtol=1e-12)
    return solution.x, solution.jac


def _camera(camera: Camera, values: np.ndarray) -> Camera:
    """Return the camera with scale, origin, rotation and tilt from `values` (6,)."""
    scale, u, v, rotation, tilt_x, tilt_y = map(float, values)
    return replace(
        camera,
        px_per_m=scale,
        origin_px=(u, v),
        rotation=rotation,
        tilt=(tilt_x, tilt_y),
    )
