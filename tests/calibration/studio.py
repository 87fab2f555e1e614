"""Pictures of a board by a known camera: a pinhole, a lens, light, blur and noise."""

from functools import cache

import cv2
import numpy as np
from scipy.interpolate import RectBivariateSpline

from stringcast.stages.calibrate.board import Board
from stringcast.stages.calibrate.fit import lens_from_values

BOARD = Board((8, 11), 0.024, 0.012, "DICT_4X4_50")  # conf/board/a4.yaml
SIZE = (640, 480)
LENS = lens_from_values([720.0, 716.0, 331.0, 233.0, -0.22, 0.09, 0.0012, -0.0008])
OVERSAMPLING = (
    2  # factor by which rendering is finer than the picture, before averaging
)
SQUARE = 48  # pixels of a square of the texture


def pose(tilt_x, tilt_y, roll, across, down, distance):
    """Return the rotation [rad] and position [m] of a board.

    Its middle is at (across, down) of the picture, from -1 to 1, at the given distance.
    """
    turn = (
        cv2.Rodrigues(np.array([tilt_x, 0, 0]))[0]
        @ cv2.Rodrigues(np.array([0, tilt_y, 0]))[0]
    )
    turn = turn @ cv2.Rodrigues(np.array([0, 0, roll]))[0]
    ray = LENS.rays(np.array([(1 + across) * SIZE[0] / 2, (1 + down) * SIZE[1] / 2]))
    middle = np.array([*(ray * distance), distance])
    return turn, middle - turn @ np.array([*BOARD.size / 2, 0])


@cache
def pixel_directions(lens):
    """Return the directions (rows, columns, 3) of all fine pixels.

    Every eighth is computed. Interpolation between them is smooth.
    """
    fine = [
        (np.arange(side * OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5 for side in SIZE
    ]
    coarse = [np.append(every[::8], every[-1]) for every in fine]
    rays = np.moveaxis(lens.rays(np.stack(np.meshgrid(*coarse), axis=-1)), -1, 0)
    interpolated = [
        RectBivariateSpline(coarse[1], coarse[0], part)(fine[1], fine[0])
        for part in rays
    ]
    return np.stack([*interpolated, np.ones_like(interpolated[0])], axis=-1)


def picture(turn, place, rng, lens=LENS, board=BOARD, blur=0.6, noise=3.0):
    """Render the camera's picture.

    `blur` is that of the optics [px]; `noise` is that of the sensor [grey levels].
    """
    # from the board (x, y, 1) to directions
    flat = np.column_stack([turn[:, :2], place])
    on_plane = pixel_directions(lens) @ np.linalg.inv(flat).T
    on_board = on_plane[..., :2] / on_plane[..., 2:] / board.square * SQUARE - 0.5
    texture = cv2.copyMakeBorder(
        board.image(SQUARE),
        SQUARE,
        SQUARE,
        SQUARE,
        SQUARE,
        cv2.BORDER_CONSTANT,
        value=255,
    )
    maps = (on_board + SQUARE).astype(np.float32)
    rendered = cv2.remap(
        texture, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderValue=90
    )
    rendered = cv2.resize(
        cv2.GaussianBlur(rendered, (0, 0), blur * OVERSAMPLING),
        SIZE,
        interpolation=cv2.INTER_AREA,
    )
    lit = 20 + 0.8 * rendered.astype(float) * np.linspace(0.8, 1.1, SIZE[0])
    return np.clip(lit + rng.normal(0, noise, lit.shape), 0, 255).astype(np.uint8)


TILTED = [
    (0.5, 0.0, 0.0, -0.45, -0.3, 0.42),
    (-0.5, 0.1, 0.1, 0.45, 0.3, 0.42),
    (0.0, 0.55, -0.1, -0.45, 0.3, 0.42),
    (0.1, -0.55, 1.5, 0.4, -0.25, 0.45),
    (0.4, 0.4, 1.6, 0.0, 0.0, 0.5),
    (-0.4, -0.4, 0.2, -0.35, 0.0, 0.4),
    (0.35, -0.3, 3.0, 0.4, 0.0, 0.4),
    (-0.45, 0.3, -1.5, 0.0, -0.35, 0.45),
    (0.2, 0.6, 0.05, 0.0, 0.35, 0.45),
    (-0.6, -0.1, 1.55, -0.4, -0.2, 0.5),
    (0.0, 0.0, 0.0, 0.1, 0.0, 0.32),
    (0.3, -0.5, -0.2, 0.5, 0.35, 0.42),
]


def tilted(rng, poses=TILTED, **settings):
    return [picture(*pose(*each), rng, **settings) for each in poses]
