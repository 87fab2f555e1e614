"""The arm is found in the frames if its reported joints are wrong."""

from dataclasses import replace

import numpy as np
import pytest

from stringcast.hardware.virtual.bench import VirtualArm, VirtualBench, VirtualCamera
from stringcast.hardware.virtual.render import Look
from stringcast.stages.execute.execute import execute
from stringcast.stages.extract.arm_in_image import ReportedArm, fit_arm
from stringcast.stages.extract.extract import extract
from stringcast.stages.extract.footage import Footage, footage_from_joints
from stringcast.stages.extract.segment import uncovered_brightness
from tests.conftest import specimen, swing

ARM_WIDTH_M = 0.035
JOINT_GAIN = {"joint_gain": {"gain": 0.04}}


FAST = (14.6, 10.4, -16.7)  # speeds of the joints [rad/s]
SLOW = (1.5, 1.0, -1.7)


def film_cast(arm, camera, hidden, look=None, speeds=FAST):
    """Film a short swing; return footage, true arm and true tip (F, ...) [m]."""
    bench = VirtualBench(
        arm,
        camera,
        replace(specimen("A"), hidden=hidden),
        seed=3,
        look=look or Look(),
    )
    motion = swing(duration=0.24, speeds=speeds)
    trial = execute(
        motion, VirtualArm(bench), VirtualCamera(bench), before=0.05, after=0.05
    )
    t = trial.frames["t"].to_numpy()
    body = bench.camera_view(bench.joints_at, t)
    tip = bench.camera_view(bench.string_at, t)[:, -1]
    return footage_from_joints(trial.film, arm), body, tip


def read_string(footage, camera):
    return extract(
        footage,
        camera,
        string_length=0.3,
        points=31,
        sigmas=6.0,
        arm_width=ARM_WIDTH_M,
        hidden=0.01,
        shorter=0.08,
        longer=0.4,
    )


def find_arm(footage, camera):
    uncovered = uncovered_brightness(footage.images)
    return fit_arm(footage, camera, uncovered, ARM_WIDTH_M * camera.px_per_m)


def test_a_string_is_read_if_joints_turn_more_than_reported(arm, camera):
    slow = replace(camera, fps=100.0)
    footage, body, tip = film_cast(arm, slow, JOINT_GAIN)
    points = read_string(footage, slow)
    readings = points.readings
    assert readings["valid"].mean() >= 0.95
    distance = np.linalg.norm(readings[["tip_x", "tip_y"]] - tip, axis=1)
    assert np.nanquantile(distance, 0.95) < 3 / camera.px_per_m

    true_shift = np.linalg.norm(body[:, -1] - footage.body[:, -1], axis=1)
    assert true_shift.max() > 5 / camera.px_per_m
    assert readings["hand_shift"].to_numpy() == pytest.approx(
        true_shift, abs=1.5 / camera.px_per_m
    )
    at_grasp = points.points[points.points["s"] == 0]
    is_read = readings["valid"].to_numpy(bool)
    missed = at_grasp[["x", "y"]].to_numpy() - body[is_read, -1]
    assert np.sqrt(np.mean(missed**2)) < 1.5 * at_grasp["sigma"].mean()


@pytest.mark.parametrize(
    "hidden",
    [
        {"camera_rotation": {"angle": 0.05}},
        {"time_offset": {"offset": 0.01}},
        {"camera_offset": {"x": 0.02}},
    ],
)
def test_errors_of_camera_and_clock_are_found(arm, camera, hidden):
    footage, body, _ = film_cast(arm, replace(camera, fps=100.0), hidden)
    before = np.linalg.norm(body[:, -1] - footage.body[:, -1], axis=1)
    after = np.linalg.norm(body - find_arm(footage, camera).body, axis=-1)[:, -1]
    assert before.max() > 5 / camera.px_per_m
    assert after.max() < 2 / camera.px_per_m


def test_an_arm_that_shows_beyond_its_outline_is_found(arm, camera):
    """Its edge, 2 px wide, was taken for a string, and most frames were refused."""
    slow = replace(camera, fps=100.0)
    rotation = {"camera_rotation": {"angle": 0.01}}
    footage, _, tip = film_cast(arm, slow, rotation, speeds=SLOW)
    readings = read_string(footage, slow).readings
    assert readings["valid"].all()
    distance = np.linalg.norm(readings[["tip_x", "tip_y"]] - tip, axis=1)
    assert distance.max() < 1 / camera.px_per_m


def test_a_hand_as_reported_is_known_as_well_as_a_shift_is_noticed(arm, camera):
    """It was stated to be known to 0.1 mm, and pulled a joint gain to zero."""
    slow = replace(camera, fps=100.0)
    footage, body, _ = film_cast(arm, slow, JOINT_GAIN, speeds=SLOW)
    points = read_string(footage, slow)
    assert "hand_shift" not in points.readings
    at_grasp = points.points[points.points["s"] == 0]
    missed = np.linalg.norm(body[:, -1] - footage.body[:, -1], axis=1)
    assert missed.max() > 5 * 1e-4
    assert missed.max() < 2 * at_grasp["sigma"].min()


@pytest.mark.parametrize(
    ("hidden", "arm_level"), [({}, 150.0), (JOINT_GAIN, 45.0)], ids=["right", "unseen"]
)
def test_a_correct_or_invisible_arm_is_not_moved(arm, camera, hidden, arm_level):
    slow = replace(camera, fps=100.0)
    footage, _, _ = film_cast(arm, slow, hidden, Look(arm=arm_level))
    assert find_arm(footage, camera) is None


@pytest.mark.parametrize(("beside_px", "is_moved"), [(4.0, False), (12.0, True)])
def test_deviations_within_the_outline_do_not_move_the_arm(
    arm, camera, monkeypatch, beside_px, is_moved
):
    """Only one edge of the last link may be visible."""
    t = np.linspace(0, 0.5, 50)
    body = arm.joint_positions(np.stack([2 * t, t, -t], axis=-1))
    footage = Footage(t, [np.zeros((640, 640), np.uint8)] * 50, body[:, -1], body)
    start, hand = camera.pixels(body[:, -2]), camera.pixels(body[:, -1])
    across = (hand - start)[:, ::-1] * [1, -1]
    across *= beside_px / np.linalg.norm(across, axis=1, keepdims=True)
    share = np.linspace(0.3, 1, 100)[:, None]
    seen = {}
    for frame in range(50):
        seen[frame] = start[frame] + share * (hand - start)[frame] + across[frame]
    monkeypatch.setattr(
        "stringcast.stages.extract.arm_in_image.bright_wide_pixels", lambda *_: seen
    )
    fit = fit_arm(footage, camera, None, ARM_WIDTH_M * camera.px_per_m)
    assert (fit is not None) == is_moved


def test_offset_gain_and_lag_move_the_arm_as_defined(arm):
    t = np.linspace(0, 1, 201)
    angles = np.stack([np.sin(3 * t), 1 - np.cos(2 * t), 0.5 * t**2], axis=-1)
    reported = ReportedArm.build(t, arm.joint_positions(angles))
    offset, gain, lag = 0.02, 0.05, 0.004
    parameters = np.array([*np.tile([offset, gain, lag], 3), 0.01, -0.02])
    rates = np.stack([3 * np.cos(3 * t), 2 * np.sin(2 * t), t], axis=-1)
    turned = offset + gain * (angles - angles[0]) + lag * rates
    expected = arm.joint_positions(angles + turned) + [0.01, -0.02]
    assert reported.joint_positions(parameters) == pytest.approx(expected, abs=2e-4)
