"""Filming with a device that drops, repeats and delays frames, or fails."""

import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from sensor import Sensor, number_in

from stringcast.hardware.camera import (
    Device,
    FilmingCamera,
    ImageFolder,
    VideoFile,
    filming,
)
from stringcast.hardware.camera.record import RawFilm, build_recording, repeated_frames
from stringcast.hardware.camera.schedule import fit_schedule
from stringcast.hardware.camera.source import Frame
from stringcast.stages.check.finding import Severity
from stringcast.stages.check.frames import check_dropped_frames
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.camera import Camera

# a slow camera, as busy machines are late by milliseconds
CAMERA = Camera(32, 24, 50.0, (16.0, 12.0), 50.0)
CONTROLS = {"AUTO_EXPOSURE": 1, "EXPOSURE": 10, "GAIN": 2}


@pytest.fixture
def plugged(monkeypatch):
    """Return a function that connects a sensor to a camera."""

    def plug(sensor, most_lost=0.02, delay=0.0, **device):
        monkeypatch.setattr(
            "stringcast.hardware.camera.device.cv2.VideoCapture", lambda *_: sensor
        )
        settings = {"controls": {}, "seconds": 0.2, "interval": 0.04} | device
        return FilmingCamera(CAMERA, Device(0, "ANY", delay, **settings), most_lost)

    return plug


def film(camera, sensor, seconds=0.8):
    """Film a movement that begins with the film.

    Returns the recording and the true exposure time of each frame.
    """
    with camera:
        sensor.film()
        camera.start()
        begun = time.monotonic()
        time.sleep(seconds)
        made = camera.stop(begun)
    assert sensor.released
    return made, np.array(
        [sensor.exposed_at(number_in(image)) - begun for image in made.images]
    )


@pytest.mark.parametrize("stamps", [True, False])
def test_frames_have_their_exposure_times(plugged, stamps):
    sensor = Sensor(stamps=stamps)
    made, truth = film(plugged(sensor), sensor)
    assert len(made.t) >= 38
    assert made.fault == ""
    # measured on a busy core with frames 5 ms late: below 0.3 ms at a period of 20 ms
    np.testing.assert_allclose(made.t, truth, atol=2e-3)
    assert made.summary["frames_dropped"] == made.summary["frames_repeated"] == 0
    assert made.summary["fps"] == pytest.approx(50, rel=2e-3)


def test_decoding_time_does_not_shift_exposure_times(plugged):
    """Decoding takes 4 or 12 ms, as with MJPG, also for dropped old frames."""
    sensor = Sensor()
    sensor.decoding = lambda number: 0.004 + 0.008 * (number % 2)
    with plugged(sensor) as camera:
        time.sleep(0.2)  # the driver fills its buffers
        begun = time.monotonic()
        camera.start()
        time.sleep(0.6)
        made = camera.stop(begun)
    truth = np.array(
        [sensor.exposed_at(number_in(image)) - begun for image in made.images]
    )
    assert truth[0] > 0.02  # negative if buffered frames were kept
    # including decoding, the errors would be 4 to 12 ms
    np.testing.assert_allclose(made.t, truth, atol=2e-3)
    assert made.fault == ""


def test_undecodable_frames_count_as_dropped(plugged):
    sensor = Sensor()
    sensor.damaged = {10, 20}
    made, _ = film(plugged(sensor, most_lost=0.1), sensor)
    assert made.summary["frames_dropped"] == 2
    assert made.fault == ""


def test_dropped_frames_are_found_and_too_many_are_refused(plugged):
    lost = {10, 11, 20, 25, 30, 31, 32}
    sensor = Sensor(lost=lost)
    made, _ = film(plugged(sensor), sensor)
    numbers = np.array([number_in(image) for image in made.images])
    np.testing.assert_array_equal(np.diff(made.counts["number"]), np.diff(numbers))
    assert made.summary["frames_dropped"] == len(lost)
    assert "of the frames were dropped, allowed are 2.0%" in made.fault
    sensor = Sensor(lost=lost)
    assert film(plugged(sensor, most_lost=0.25), sensor)[0].fault == ""


def test_repeated_frames_count_as_lost(plugged):
    sensor = Sensor(again={10, 11, 20})
    made, _ = film(plugged(sensor), sensor)
    assert made.summary["frames_repeated"] == made.summary["frames_dropped"] == 3
    assert made.counts["repeats"].sum() == 3
    assert made.counts["repeats"].max() == 2
    assert len({number_in(image) for image in made.images}) == len(made.images)
    assert "(3 came twice instead)" in made.fault


def test_rendered_scene_at_rest_has_no_repeated_frames():
    still, moved = np.zeros((4, 4), np.uint8), np.ones((4, 4), np.uint8)
    assert not repeated_frames([still] * 6 + [moved, moved], 6).any()
    noisy = [np.full((4, 4), k, np.uint8) for k in range(6)]
    assert repeated_frames([*noisy, moved, moved], 6).sum() == 1


def test_camera_failure_invalidates_the_film(plugged):
    sensor = Sensor(dies=15)
    made, _ = film(plugged(sensor), sensor)
    assert made.fault.startswith("the camera saw nothing after 0.2")
    assert 13 <= len(made.t) <= 15
    assert made.summary["frames_dropped"] >= 24  # in 0.8 s


def test_camera_without_frames_is_refused_before_a_movement(
    plugged,
):
    sensor = Sensor(dies=0)
    with plugged(sensor) as camera:
        sensor.film()
        with pytest.raises(
            HardwareError, match=r"no frame came \(it gives no more frames\)"
        ):
            camera.start()


@pytest.mark.parametrize("where", ["grab", "retrieve"])
def test_errors_of_reading_frames_are_reported(plugged, monkeypatch, where):
    sensor = Sensor()
    with plugged(sensor) as camera:
        monkeypatch.setattr(sensor, where, lambda: 1 // 0)
        with pytest.raises(
            HardwareError, match=r"no frame came \(integer division or modulo by zero\)"
        ):
            camera.start()
    assert sensor.released


def test_failed_conversion_to_grey_ends_the_film(plugged, monkeypatch):
    """Neither thread may wait for the other."""
    monkeypatch.setattr(filming, "QUEUE_FRAMES", 1)
    sensor = Sensor()
    with plugged(sensor) as camera:
        sensor.film()
        camera.start()
        begun = time.monotonic()
        monkeypatch.setattr(filming, "to_grey", lambda image: {}["format"])
        time.sleep(0.3)
        made, threads = camera.stop(begun), camera.film.threads
        assert not any(thread.is_alive() for thread in threads)
    assert made.fault.startswith("the camera saw nothing after")
    assert made.fault.endswith("'format'")
    assert sensor.released


def test_hanging_device_is_released_later(plugged, monkeypatch):
    monkeypatch.setattr(filming, "READ_TIMEOUT_S", 0.1)
    sensor = Sensor(held={5: 2.0})
    with plugged(sensor) as camera:
        sensor.film()
        camera.start()
        begun = time.monotonic()
        time.sleep(0.2)
        camera.stop(begun)
        taker = camera.film.threads[0]
    assert taker.is_alive()
    assert not sensor.released  # a read is in progress
    taker.join(3.0)
    assert sensor.released


def test_last_frames_are_awaited_for_a_limited_time(plugged):
    sensor = Sensor(held=dict.fromkeys(range(1000), 0.06))
    camera = plugged(sensor, delay=0.06)
    with camera:
        sensor.film()
        camera.start()
        begun = time.monotonic()
        time.sleep(0.2)
        asked = time.monotonic() - begun
        made = camera.stop(begun)
        assert time.monotonic() - begun < asked + 0.2
    assert made.t[-1] >= asked - 0.005
    assert made.summary["frames_dropped"] == 0


def test_hanging_camera_does_not_block(plugged):
    sensor = Sensor(held={10: 1.5})
    with plugged(sensor) as camera:
        sensor.film()
        camera.start()
        time.sleep(0.5)
        begun = time.monotonic()
        made = camera.stop(begun - 0.5)
        assert 0.4 < time.monotonic() - begun < 3.0
    assert "of the frames were dropped" in made.fault


def test_slow_host_loses_frames_and_reports_it(plugged, monkeypatch):
    monkeypatch.setattr(filming, "QUEUE_FRAMES", 2)
    monkeypatch.setattr(
        filming, "to_grey", lambda image: time.sleep(0.06) or image[..., 0]
    )
    sensor = Sensor()
    made, _ = film(plugged(sensor), sensor)
    assert "the host was too slow for" in made.summary["remarks"]
    assert made.summary["frames_dropped"] > 10


# --- settings of a device


def test_controls_are_set_and_verified(plugged):
    sensor = Sensor()
    with plugged(sensor, controls=CONTROLS) as camera:
        assert camera.stream.remarks == ()
    assert sensor.properties[cv2.CAP_PROP_EXPOSURE] == 10
    assert sensor.properties[cv2.CAP_PROP_FPS] == 50


def test_ignored_exposure_setting_is_refused(plugged):
    sensor = Sensor()
    sensor.ignored = {cv2.CAP_PROP_EXPOSURE}
    sensor.properties = {cv2.CAP_PROP_EXPOSURE: 156.0}
    with pytest.raises(
        HardwareError,
        match=r"source\.controls\.EXPOSURE is 10, the driver reports 156\. Set it to",
    ):
        plugged(sensor, controls=CONTROLS).__enter__()
    assert sensor.released


def test_unverifiable_controls_give_a_remark(plugged):
    sensor = Sensor()
    sensor.dumb = {cv2.CAP_PROP_EXPOSURE}
    made, _ = film(plugged(sensor, controls=CONTROLS), sensor, 0.3)
    assert made.summary["remarks"] == "the driver can neither set nor report EXPOSURE"


def test_changing_brightness_gives_a_remark(plugged):
    class Brightening(Sensor):
        def picture(self, number):
            return np.clip(super().picture(number) + 0.5 * number, 0, 255).astype(
                np.uint8
            )

    sensor = Brightening()
    with plugged(sensor) as camera:
        assert "is exposure locked?" in camera.stream.remarks[0]


class Deep(Sensor):
    def picture(self, number):
        return 256 * super().picture(number).astype(np.uint16)


REFUSED = {
    "size": (
        Sensor(size=(64, 48)),
        "asked for 32x24 and gives 64x48. Set camera.width",
    ),
    "rate": (Sensor(fps=30.0), r"[23]\d\.\d frames come in a second, camera.fps is 50"),
    "frozen": (Sensor(again=range(-10000, 10000)), "all the same to the bit"),
    "dead": (Sensor(dies=0), r"0 frame\(s\) came"),
    "deep": (
        Deep(),
        r"images are uint16 of shape \(24, 32, 3\), neither grey nor BGR of 8 bits",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_device_with_other_frames_is_refused_before_a_movement(plugged, kind):
    sensor, words = REFUSED[kind]
    sensor.film()
    with pytest.raises(HardwareError, match=words):
        plugged(sensor).__enter__()
    assert sensor.released


def test_stills_are_taken_at_intervals_after_the_user_is_ready(plugged):
    sensor, asked = Sensor(), []
    stills = list(plugged(sensor).source.stills(CAMERA, lambda: asked.append(1)))
    assert asked == [1]
    assert 4 <= len(stills) <= 6


# --- files in place of a device


def test_image_folders_and_videos_play_at_the_cameras_rate(tmp_path):
    sensor = Sensor()
    video = cv2.VideoWriter(
        str(tmp_path / "film.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (32, 24)
    )
    for number in range(60):
        cv2.imwrite(str(tmp_path / f"{number:03d}.png"), sensor.picture(number))
        video.write(sensor.picture(number))
    video.release()
    for source in (ImageFolder(tmp_path), VideoFile(tmp_path / "film.avi", every=20)):
        with FilmingCamera(CAMERA, source, 0.0) as camera:
            camera.start()
            begun = time.monotonic()
            time.sleep(0.5)
            made = camera.stop(begun)
        assert made.fault == ""
        np.testing.assert_allclose(np.diff(made.t), 0.02, atol=1e-9)
        assert 24 <= len(made.t) <= 30
    assert len(list(source.stills(CAMERA, lambda: None))) == 3


def test_empty_image_folders_and_wrong_sizes_are_refused(tmp_path):
    with pytest.raises(HardwareError, match=r"no image here.*Name the folder"):
        FilmingCamera(CAMERA, ImageFolder(tmp_path), 0.0).__enter__()
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((10, 20), np.uint8))
    with pytest.raises(HardwareError, match=r"images are 20x10\. Set camera\.width"):
        FilmingCamera(CAMERA, ImageFolder(tmp_path), 0.0).__enter__()


# --- the schedule of frames


def jittered_arrivals(rng, jitter, heavy, lost):
    """Make numbers and times of 200 frames at 199.4 Hz, with delays and losses.

    jitter: scale of delays [periods]; some frames are 1.5 periods late.
    """
    n = np.flatnonzero(rng.random(200) >= lost)
    late = rng.exponential(jitter, len(n)) + 1.5 * (rng.random(len(n)) < heavy)
    return n, np.maximum.accumulate(3.0 + (n + late) * 0.005015)


# Measured shares with twenty seeds: 0, 0, 0.0010, 0.0032, 0.011. A frame that arrives
# after the due time of its lost successor looks like it.
@pytest.mark.parametrize(
    ("jitter", "heavy", "lost", "wrong"),
    [
        (1e-9, 0, 0.3, 0),
        (0.1, 0, 0, 0),
        (0.2, 0, 0.05, 0.004),
        (0.3, 0, 0.05, 0.01),
        (0.2, 0.05, 0.1, 0.025),
    ],
)
def test_frame_numbers_are_recovered_from_jittered_times(jitter, heavy, lost, wrong):
    rng = np.random.default_rng(1)
    missed, total = 0, 0
    for _ in range(10):
        n, t = jittered_arrivals(rng, jitter, heavy, lost)
        found = fit_schedule(t, 0.005)
        shift = np.median(found.numbers - n)
        missed, total = missed + int((found.numbers - shift != n).sum()), total + len(n)
        assert found.period == pytest.approx(0.005015, rel=1e-3)
        assert np.abs(np.median(found.due - 3.0 - n * 0.005015)) < 0.0005
        assert (np.diff(found.numbers) > 0).all()
    assert missed <= wrong * total


def test_stamps_made_from_frame_numbers_are_rejected():
    """Frame numbers times the nominal period would hide dropped frames."""
    t = np.delete(np.arange(100), [30, 31, 32, 33]) * 0.005
    frames = [
        Frame(5.0 + at, (k + 1) * 0.005, np.full((2, 2), k, np.uint8))
        for k, at in enumerate(t)
    ]
    made = build_recording(RawFilm(frames, 0.495, "", ()), 5.0, 0.0, 0.005, 0.02)
    np.testing.assert_allclose(made.t, t, atol=1e-6)
    assert made.summary["frames_dropped"] == 4


@pytest.mark.parametrize("clock", [np.nan, 100.0])
def test_late_frames_get_their_exposure_times(clock):
    """Frames arrive 30 ms after their exposure, every fifth 13 ms later.

    A late frame is not lost. clock: the clock of the stamps, if any.
    """
    due = np.arange(40) * 0.02
    held = np.where(np.arange(40) % 5 == 3, 0.013, 0.0)
    came = zip(7.03 + due + held, clock + due, strict=True)
    frames = [Frame(*when, np.full((2, 2), k, np.uint8)) for k, when in enumerate(came)]
    made = build_recording(RawFilm(frames, 0.785, "", ()), 7.0, 0.03, 0.02, 0.0)
    np.testing.assert_allclose(made.t, due, atol=1e-9)
    np.testing.assert_allclose(made.counts["late"], held, atol=1e-9)
    assert made.summary["frames_late"] == 8
    assert made.fault == ""


def test_check_of_stored_frames_reports_missing_ones():
    t = np.delete(np.arange(100), [30, 31, 60]) * 0.005
    films = {"t01": SimpleNamespace(t=t), "t02": SimpleNamespace(t=t[:20])}
    (finding,) = check_dropped_frames(
        SimpleNamespace(
            data=SimpleNamespace(films=films), file=lambda name: f"{name}.parquet"
        )
    )
    assert finding.statement == "3 of 100 frames are missing (3.0%)"
    assert (finding.severity, finding.file, finding.trials) == (
        Severity.WARNING,
        "frames.parquet",
        ("t01",),
    )
