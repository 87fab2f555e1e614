"""Films with an uneven frame rate, as from phones."""

import struct

import cv2
import numpy as np
import pytest

from stringcast.data.images import Video

PARENTS = (b"moov", b"trak", b"mdia", b"minf", b"stbl")


def write_film(path, steps):
    """Write an MP4 at 30 frames a second; each frame is shown for some steps."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30, (64, 48))
    for number in range(len(steps)):
        writer.write(np.full((48, 64, 3), 10 * number, np.uint8))
    writer.release()
    data = bytearray(path.read_bytes())
    # table of durations, one entry per frame
    at = data.index(b"stts") - 4
    (size,) = struct.unpack(">I", data[at : at + 4])
    (step,) = struct.unpack(">I", data[at + 20 : at + 24])
    table = b"stts" + struct.pack(">II", 0, len(steps))
    for count in steps:
        table += struct.pack(">II", 1, count * step)
    table = struct.pack(">I", len(table) + 4) + table
    for name in PARENTS:
        start = data.index(name) - 4
        (old,) = struct.unpack(">I", data[start : start + 4])
        data[start : start + 4] = struct.pack(">I", old + len(table) - size)
    data[at : at + size] = table
    # an edit list would cut the film at its former duration
    path.write_bytes(bytes(data).replace(b"edts", b"free"))


@pytest.mark.parametrize("fps", [30.0, 240.0])
def test_frame_times_follow_the_files_display_times(tmp_path, fps):
    steps = [1, 1, 3, 1, 1, 1, 2, 1, 1, 1]
    write_film(tmp_path / "film.mp4", steps)
    begins = np.cumsum([0, *steps[:-1]])
    times = Video(tmp_path / "film.mp4").frame_times(fps)
    np.testing.assert_allclose(times, begins / fps, atol=1e-4 * 30 / fps)


def test_even_frames_have_exactly_the_stated_rate(tmp_path):
    write_film(tmp_path / "film.mp4", [1] * 10)
    times = Video(tmp_path / "film.mp4").frame_times(29.97)
    assert (times == np.arange(10) / 29.97).all()
