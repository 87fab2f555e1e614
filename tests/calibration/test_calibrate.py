"""Calibration from boards that a known camera rendered.

The camera is recovered within the stated uncertainty, or the set is refused with the
reason.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from studio import BOARD, LENS, SIZE, TILTED, picture, pose, tilted

from stringcast.data.schema import DataError
from stringcast.stages.calibrate.board import Board
from stringcast.stages.calibrate.calibrate import calibrate
from stringcast.stages.calibrate.fit import (
    fit_lens,
    lens_from_values,
    lens_values,
    project_corners,
)
from stringcast.stages.calibrate.plane import BoardPlacement
from stringcast.stages.calibrate.views import BoardView, detect_board
from stringcast.stages.model.camera import CAMERA_AXES, Camera

NOMINAL = Camera(320, 320, 340.0, (1.0, 1.0), 200.0, exposure=0.001)
PLACEMENT = BoardPlacement((0.3, 0.1), 0.2)
THRESHOLDS = {
    "place": PLACEMENT,
    "views": 10,
    "spread": 0.5,
    "coverage": 0.6,
    "rms": 0.5,
    "outlier_ratio": 3.0,
}
FLAT_POSE = pose(0.03, -0.05, 0.04, 0.0, 0.05, 0.42)


def draw_pictures(seed, **how):
    rng = np.random.default_rng(seed)
    return tilted(rng, **how), picture(*FLAT_POSE, rng, **how)


@pytest.fixture(scope="module")
def pictures():
    return draw_pictures(0)


@pytest.fixture(scope="module")
def clean(pictures):
    return calibrate_pictures(*pictures)


def calibrate_pictures(pictures, flat, board=BOARD, **changed):
    return calibrate(pictures, [flat], board, NOMINAL, **THRESHOLDS | changed)


def true_pixels(world):
    """Return where the true lens sees points of the world (N, 2).

    They are computed by way of the board and OpenCV.
    """
    turn, place = FLAT_POSE
    c, s = np.cos(PLACEMENT.turn), np.sin(PLACEMENT.turn)
    board = (world - PLACEMENT.corner) @ np.array([[c, -s], [s, c]])
    solid = np.column_stack(
        [board[:, 0], BOARD.size[1] - board[:, 1], np.zeros(len(world))]
    )
    seen, _ = cv2.projectPoints(
        solid, cv2.Rodrigues(turn)[0], place, LENS.matrix, np.array(LENS.distortion)
    )
    return seen[:, 0]


def test_a_known_camera_is_recovered_within_its_uncertainty(clean):
    found = clean
    assert found.reason == ""
    lens = found.measured.iloc[:8]
    z = (lens["value"] - lens_values(LENS)) / lens["sigma"]
    assert np.abs(z).max() < 3  # measured: 1.5
    outcome = found.outcome.iloc[0]
    assert 0.03 < outcome["rms"] < 0.1  # measured: 0.065
    assert outcome["rms"] < outcome["held_out_rms"] < 1.1 * outcome["rms"]
    assert lens["sigma"].iloc[0] < 0.5  # px of 720; measured: 0.23
    assert outcome["spread"] > 1.0
    assert (outcome["width"], outcome["height"]) == SIZE


def test_the_plane_of_the_board_is_recovered(clean):
    found = clean
    block = yaml.safe_load(found.outcome["camera"].iloc[0])
    camera = Camera(
        **block
        | {
            "lens": lens_from_values(
                [v for part in block["lens"].values() for v in part]
            )
        }
    )
    assert (camera.width, camera.height, camera.fps, camera.exposure) == (
        *SIZE,
        200.0,
        0.001,
    )
    world = PLACEMENT.to_world(
        np.random.default_rng(0).uniform(0, 1, (200, 2)) * BOARD.size
    )
    pixels = true_pixels(world)
    off = np.linalg.norm(camera.world(pixels) - world, axis=1)
    assert off.max() < 1e-4  # measured: 0.023 mm; a pixel is 0.6 mm
    np.testing.assert_allclose(camera.pixels(camera.world(pixels)), pixels, atol=1e-6)
    truth = {
        "px_per_m": LENS.mean_focal / _distance(),
        "rotation": -0.04 - PLACEMENT.turn,
        "tilt[0]": 0.03,
        "tilt[1]": -0.05,
    }
    rows = found.measured.set_index("name")
    for name, value in truth.items():  # measured: 1.4, 0.1, 0.8 and 1.1 deviations
        assert abs(rows.loc[name, "value"] - value) < 3 * rows.loc[name, "sigma"], name
    assert rows.loc["px_per_m", "sigma"] < 0.5  # of 1710; measured: 0.09


def _distance():
    """Return the distance from the lens along its axis to the board."""
    turn, place = FLAT_POSE
    return turn[:, 2] @ place / turn[2, 2]


@pytest.mark.parametrize(("blur", "noise"), [(1.4, 3.0), (0.6, 10.0)])
def test_blur_and_noise_increase_errors_and_stated_sigmas(clean, blur, noise):
    worse = calibrate_pictures(*draw_pictures(1, blur=blur, noise=noise))
    z = (worse.measured["value"].iloc[:8] - lens_values(LENS)) / worse.measured[
        "sigma"
    ].iloc[:8]
    assert np.abs(z).max() < 3.5  # measured: 2.2 and 1.6
    if noise > 3:
        assert worse.outcome["rms"].iloc[0] > 1.3 * clean.outcome["rms"].iloc[0]


def detect_exactly(rng, sigma, lens=LENS, poses=TILTED):
    """Return views without pictures: all corners, with noise [px]."""
    views = []
    for number, each in enumerate(poses):
        turn, place = pose(*each)
        view = BoardView(
            number,
            np.zeros(SIZE[::-1], np.uint8),
            np.arange(len(BOARD.points)),
            np.zeros((len(BOARD.points), 2)),
        )
        pixels = project_corners(lens, BOARD, view, cv2.Rodrigues(turn)[0], place)
        views.append(replace(view, pixels=pixels + rng.normal(0, sigma, pixels.shape)))
    return views


def test_stated_sigmas_equal_the_spread_of_repeated_calibrations():
    rng = np.random.default_rng(3)
    fits = [fit_lens(detect_exactly(rng, 0.3), BOARD, SIZE) for _ in range(12)]
    z = np.array(
        [
            (lens_values(fit.lens) - lens_values(LENS))
            / np.sqrt(np.diag(fit.covariance))
            for fit in fits
        ]
    )
    assert 0.75 < np.sqrt(np.mean(z**2)) < 1.25  # 96 values; measured: 0.95
    assert np.abs(z).max() < 4


def test_a_calibration_is_reproducible_to_the_bit():
    """OpenCV's threads would add in a varying order."""
    views = detect_exactly(np.random.default_rng(3), 0.3)
    fits = {tuple(lens_values(fit_lens(views, BOARD, SIZE).lens)) for _ in range(12)}
    assert len(fits) == 1


def test_the_covariance_has_the_standard_deviations_of_opencv():
    views = detect_exactly(np.random.default_rng(4), 0.3)
    sigmas = np.sqrt(np.diag(fit_lens(views, BOARD, SIZE).covariance))
    solid = [BOARD.points.astype(np.float32)] * len(views)
    opencv_sigmas = cv2.calibrateCameraExtended(
        solid,
        [view.pixels.astype(np.float32) for view in views],
        SIZE,
        None,
        None,
        flags=cv2.CALIB_FIX_K3,
    )[5].ravel()[:8]
    np.testing.assert_allclose(sigmas, opencv_sigmas, rtol=0.02)


# --- refused sets


def test_parallel_views_do_not_determine_the_focal_length():
    rng = np.random.default_rng(5)
    parallel = [
        (0.02 * (k % 2), 0.02 * (k % 3), 0.1 * k, 0.4 * (k % 3 - 1), 0.3 * (k % 2), 0.4)
        for k in range(10)
    ]
    found = calibrate_pictures(tilted(rng, parallel), picture(*FLAT_POSE, rng))
    assert not found.outcome["valid"].iloc[0]
    assert (
        "are needed to distinguish focal length from distance. Tilt the board"
        in found.reason
    )


def test_a_half_of_the_picture_without_corners_is_reported(pictures):
    rng = np.random.default_rng(6)
    left = [(x, y, roll, -0.75, down, 0.6) for x, y, roll, _, down, _ in TILTED]
    found = calibrate_pictures(tilted(rng, left), pictures[1])
    assert "fewest in its right half: the lens is not known there" in found.reason


def test_one_view_that_does_not_fit_is_reported(pictures):
    """A view of a bent or shaken board fits no pinhole camera."""
    tilts, flat = pictures
    across, down = np.meshgrid(*(np.arange(side, dtype=np.float32) for side in SIZE))
    distorted = cv2.remap(
        tilts[4],
        across + 3 * np.sin(down / 40, dtype=np.float32),
        down,
        cv2.INTER_LINEAR,
    )
    found = calibrate_pictures([*tilts[:4], distorted, *tilts[5:]], flat)
    assert found.reason.startswith("view 4 does not fit the others:")
    assert "Leave it out" in found.reason
    assert not found.outcome["valid"].iloc[0]


def test_too_few_views_are_refused(pictures):
    tilts, flat = pictures
    assert (
        calibrate_pictures(tilts[:6], flat, coverage=0.1).reason
        == "6 views can be used, 10 are needed. Take more."
    )
    with pytest.raises(
        DataError,
        match=r"read in 2 of 4 pictures; of most, no marker of the dictionary is seen\. Take",
    ):
        calibrate_pictures([*tilts[:2], np.zeros_like(flat), np.zeros_like(flat)], flat)
    with pytest.raises(DataError, match="board in the plane of motion: no marker"):
        calibrate_pictures(tilts, np.zeros_like(flat))


OTHER_BOARDS = {
    "fewer squares": Board((7, 10), 0.024, 0.012, "DICT_4X4_50"),
    "as many squares, turned": Board((11, 8), 0.024, 0.012, "DICT_4X4_50"),
}


@pytest.mark.parametrize("kind", OTHER_BOARDS)
def test_a_board_of_other_dimensions_is_recognised(pictures, kind):
    assert (
        "it is another board"
        in detect_board(0, pictures[0][4], OTHER_BOARDS[kind]).reason
    )
    with pytest.raises(DataError, match="it is another board"):
        calibrate_pictures(*pictures, board=OTHER_BOARDS[kind])


def test_corners_on_one_line_do_not_determine_a_pose(pictures):
    """Ten visible corners on one line are refused.

    No pose follows from them.
    """
    strip = cv2.copyMakeBorder(
        BOARD.image(40)[:, :80], 20, 20, 280, 280, cv2.BORDER_CONSTANT, value=255
    )
    assert (
        detect_board(0, strip, BOARD).reason
        == "the 10 corners that are seen are on one line"
    )
    assert calibrate_pictures([strip, *pictures[0]], pictures[1]).reason == ""
    two = cv2.copyMakeBorder(
        BOARD.image(40)[:, :120], 20, 20, 260, 260, cv2.BORDER_CONSTANT, value=255
    )
    assert detect_board(0, two, BOARD).reason == ""


def test_pictures_of_two_sizes_are_refused(pictures):
    with pytest.raises(DataError, match="pictures are 320x240 and 640x480 px"):
        calibrate_pictures(pictures[0], cv2.resize(pictures[1], (320, 240)))


def test_an_impossible_board_is_refused():
    with pytest.raises(ValueError, match="smaller than the square"):
        Board((8, 11), 0.02, 0.02, "DICT_5X5_100")
    with pytest.raises(ValueError, match="has 50 markers, the board needs 60"):
        Board((10, 12), 0.02, 0.015, "DICT_4X4_50")
    with pytest.raises(ValueError, match="no dictionary DICT_9X9"):
        Board((8, 11), 0.02, 0.015, "DICT_9X9")


# --- the calibrated camera


def test_a_lens_without_distortion_or_tilt_is_the_plain_camera():
    plain = Camera(*SIZE, 340.0, (251.5, 387.5), 200.0, rotation=0.1)
    through = replace(plain, lens=lens_from_values([900, 900, 330, 250, 0, 0, 0, 0]))
    world = np.random.default_rng(0).uniform(-0.5, 0.8, (3, 7, 2))
    np.testing.assert_allclose(through.pixels(world), plain.pixels(world), atol=1e-9)
    np.testing.assert_allclose(through.world(plain.pixels(world)), world, atol=1e-12)
    turned = plain.world(
        np.array([[251.5, 387.5], [251.5 + 34 * np.cos(0.1), 387.5 - 34 * np.sin(0.1)]])
    )
    np.testing.assert_allclose(turned, [[0, 0], [0.1, 0]], atol=1e-12)


def test_a_tilted_plane_is_projected_as_by_a_pinhole():
    camera = Camera(
        *SIZE, 500.0, (300.0, 260.0), 200.0, rotation=0.3, tilt=(0.2, -0.1), lens=LENS
    )
    world = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 2))
    x, y, z = (
        cv2.Rodrigues(np.array(v))[0] for v in ([0.2, 0, 0], [0, -0.1, 0], [0, 0, -0.3])
    )
    turn = x @ y @ z @ CAMERA_AXES
    straight = np.linalg.inv(LENS.matrix) @ [300.0, 260.0, 1.0]
    origin = straight * (LENS.mean_focal / 500.0) * turn[2, 2] / (turn[:, 2] @ straight)
    seen, _ = cv2.projectPoints(
        np.column_stack([world, 0 * world[:, 0]]),
        turn,
        origin,
        LENS.matrix,
        np.array(LENS.distortion),
    )
    np.testing.assert_allclose(camera.pixels(world), seen[:, 0], atol=1e-9)
    np.testing.assert_allclose(camera.world(seen[:, 0]), world, atol=1e-9)


def test_contradictory_camera_settings_are_refused():
    with pytest.raises(ValueError, match=r"set camera\.distortion to 0"):
        Camera(*SIZE, 340.0, (1.0, 1.0), 200.0, distortion=0.1, lens=LENS)
    with pytest.raises(ValueError, match=r"needs camera\.lens"):
        Camera(*SIZE, 340.0, (1.0, 1.0), 200.0, tilt=(0.1, 0.0))
