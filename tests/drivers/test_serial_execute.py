"""The stage `execute` with an emulated arm and a played film."""

import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from rig import ARM, DRIVING, emulator, events, movement, standstill

from stringcast.data.artifacts import JOINTS, SPEEDS
from stringcast.hardware.camera import FilmingCamera, VideoFile
from stringcast.hardware.camera.playback import PlayedSource
from stringcast.hardware.serial.lab import open_lab
from stringcast.hardware.serial.wire import SerialWire
from stringcast.stages.execute.execute import execute
from stringcast.stages.execute.interfaces import HardwareError, Recording
from stringcast.stages.model.camera import Camera

CAMERA = Camera(64, 48, 50.0, (32.0, 24.0), 100.0)
LINK = {"baud": 1_000_000, "driving": DRIVING, "most_lost": 0.02}


@pytest.fixture
def port(tmp_path):
    with emulator(tmp_path / "events.jsonl") as port:
        yield port


@pytest.fixture
def film(tmp_path):
    """Return eight seconds of film at 100 Hz with encoded frame numbers."""
    path = tmp_path / "film.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    for number in range(800):
        bits = (
            np.array([number >> bit & 1 for bit in range(12)], np.uint8).reshape(3, 4)
            * 200
        )
        video.write(
            np.kron(bits, np.ones((16, 16), np.uint8))[..., None].repeat(3, axis=2)
        )
    video.release()
    return VideoFile(path, every=1)


def number_in(image):
    """Decode the number of a frame of `film`."""
    cells = image.reshape(3, 16, 4, 16).mean(axis=(1, 3)).ravel() > 100
    return int((cells * 2 ** np.arange(12)).sum())


def motion(duration=0.3):
    return SimpleNamespace(commands=movement(duration), duration=duration)


def test_trial_is_complete_and_on_one_clock(port, film):
    lab = open_lab(ARM, CAMERA, seed=0, trial=1, port=port, source=film, **LINK)
    trial = execute(motion(), lab.arm, lab.camera, before=0.1, after=0.1)
    t = trial.frames["t"].to_numpy()
    # a frame every 10 ms; busy machines miss one or two
    assert t[0] == pytest.approx(-0.1, abs=0.03)
    assert t[-1] == pytest.approx(0.4, abs=0.03)
    assert np.median(np.diff(t)) == pytest.approx(0.01, abs=1e-3)
    assert len(trial.images) == len(t) >= 45
    assert trial.ticks["t_due"].iloc[20] == pytest.approx(0.0, abs=1e-9)
    turned = trial.arm.iloc[-1][list(JOINTS)] - trial.arm.iloc[0][list(JOINTS)]
    # the arm keeps its speed until the next command
    late = float((trial.ticks["t_sent"] - trial.ticks["t_due"]).max())
    fastest = float(np.abs(motion().commands[list(SPEEDS)]).to_numpy().max())
    np.testing.assert_allclose(turned, [0.5, -0.4, 0.6], atol=0.03 + fastest * late)
    shown = np.array([number_in(image) for image in trial.images])
    np.testing.assert_array_equal(
        shown - shown[0], trial.frames["number"] - trial.frames["number"].iloc[0]
    )
    # late frames have true times
    np.testing.assert_allclose(np.diff(t), np.diff(shown) * 0.01, atol=1e-9)
    assert trial.link["frames_dropped"].iloc[0] == 0
    assert trial.link["valid"].iloc[0]


def test_camera_gets_the_start_time_of_the_movement(port, film, monkeypatch):
    """Pings and checks before the movement take varying times."""
    sent, told = [], []
    send = SerialWire.send

    def watched(self, speeds):
        if any(speeds):
            sent.append(time.monotonic())
        return send(self, speeds)

    class Watch(FilmingCamera):
        def __enter__(self):
            return self

        def start(self):
            sent.clear()

        def stop(self, moved_at):
            told.append(moved_at)
            return Recording(np.zeros(0), [])

    monkeypatch.setattr(SerialWire, "send", watched)
    lab = open_lab(ARM, CAMERA, seed=0, trial=1, port=port, source=film, **LINK)
    with pytest.raises(HardwareError, match="no frame came during the movement"):
        execute(motion(), lab.arm, Watch(CAMERA, film, 0.0), before=0.1, after=0.1)
    # less than a tick
    assert told[0] == pytest.approx(sent[0], abs=0.004)


def test_camera_failure_during_a_movement_gives_an_invalid_trial(tmp_path, film):
    """The film ends during the movement, as after pulling a cable."""
    images = film.images()[:30]

    class Short(PlayedSource):
        name = "short film"

        def images(self):
            return images

    log = tmp_path / "events.jsonl"
    with emulator(log) as port:
        lab = open_lab(ARM, CAMERA, seed=0, trial=1, port=port, source=Short(), **LINK)
        trial = execute(motion(), lab.arm, lab.camera, before=0.1, after=0.1)
        assert standstill(log, "moves") is not None
        assert events(log)[-1]["state"] == "idle"
        assert lab.arm.wire.link is None
    assert not trial.link["valid"].iloc[0]
    assert "the camera saw nothing after 0.1" in trial.link["reason"].iloc[0]
    assert 15 <= len(trial.images) <= 30
    assert lab.camera.film is None
