"""Where a camera with a known lens sees the plane of motion, from one view of the board
held in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

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

PLANE_PARAMETERS = ("px_per_m", "origin_u", "origin_v", "rotation", "tilt_x", "tilt_y")


@dataclass(frozen=True)
class BoardPlacement:
    """The place of the lower left corner of the board's pattern in the world [m], and
    by how much its lower edge is turned from the world's x, counter-clockwise [rad].
    """

    corner: tuple[float, float]
    turn: float

    def to_world(self, board: np.ndarray) -> np.ndarray:
        """World points (N, 2) [m] of points on the board (N, 2) [m]."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return board @ np.array([[c, s], [-s, c]]) + np.array(self.corner)


@dataclass(frozen=True)
class PlaneFit:
    """camera: with lens and plane. sigma: (6,) of NAMES, that of the lens included.
    fit: (N, 2) corners as the camera has them [px].
    """

    camera: Camera
    sigma: np.ndarray
    fit: np.ndarray


def fit_plane(
    view: BoardView, board: Board, place: BoardPlacement, lens: LensFit, camera: Camera
) -> PlaneFit:
    """The camera that sees the view's corners where they are. camera: its size, rate
    and exposure are kept.
    """
    world = place.to_world(board.corners[view.corners])
    plain = replace(camera, distortion=0.0, lens=lens.lens)

    # start: from OpenCV's pose of the board, whose y is down and whose z goes into it
    turn, at = board_pose(lens.lens, board, view)
    spin = Rotation.from_euler("z", -place.turn).as_matrix()
    turned = cv2.Rodrigues(turn)[0] @ CAMERA_AXES @ spin
    lower_left = at + cv2.Rodrigues(turn)[0] @ np.array([0, board.size[1], 0])
    origin = lower_left - turned @ np.array([*place.corner, 0.0])
    tilt_x, tilt_y, roll = Rotation.from_matrix(turned @ CAMERA_AXES).as_euler("XYZ")
    depth = turned[:, 2] @ origin / turned[2, 2]
    u, v, w = lens.lens.matrix @ origin
    start = np.array(
        [lens.lens.mean_focal / depth, u / w, v / w, -roll, tilt_x, tilt_y]
    )

    values, slopes = _solve_plane(plain, world, view.pixels, start)
    error = distance_rms(view.pixels - _camera(plain, values).pixels(world))
    covariance = (
        np.linalg.inv(slopes.T @ slopes)
        * error**2
        / 2
        * view.pixels.size
        / (view.pixels.size - len(values))
    )
    for step in np.linalg.cholesky(lens.covariance).T:
        other = replace(plain, lens=lens_from_values(lens_values(lens.lens) + step))
        change = _solve_plane(other, world, view.pixels, values)[0] - values
        covariance += np.outer(change, change)
    found = _camera(plain, values)
    return PlaneFit(found, np.sqrt(np.diag(covariance)), found.pixels(world))


def _solve_plane(
    camera: Camera, world: np.ndarray, pixels: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """NAMES (6,) and the slopes of the pixels by them, (2 N, 6)."""
    found = least_squares(
        lambda values: (_camera(camera, values).pixels(world) - pixels).ravel(),
        start,
        x_scale="jac",
        xtol=1e-12,
    )
    return found.x, found.jac


def _camera(camera: Camera, values: np.ndarray) -> Camera:
    """The camera with these NAMES."""
    scale, u, v, rotation, tilt_x, tilt_y = map(float, values)
    return replace(
        camera,
        px_per_m=scale,
        origin_px=(u, v),
        rotation=rotation,
        tilt=(tilt_x, tilt_y),
    )
