"""Incomplete writes are never read as artifacts."""

import errno
import os
import time
from itertools import count
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stringcast.data import disk, store
from stringcast.data.artifacts import Points, Trial
from stringcast.data.schema import DataError
from tests.faults.toy import Killed

OPERATIONS = ("make_folder", "write", "sync_folder", "rename")


def points(value):
    """Make an artifact of three tables, each of which holds `value`."""
    return Points(
        pd.DataFrame(
            {
                "t": [0.0, 0.1],
                "s": 0.1,
                "x": value,
                "y": 0.0,
                "sigma": 1e-3,
                "valid": True,
            }
        ),
        pd.DataFrame(
            {
                "frame": [0],
                "t": 0.0,
                "valid": True,
                "reason": "",
                "tip_x": value,
                "tip_y": 0.0,
                "tip_sigma": 1e-3,
            }
            | {"length": 0.3}
        ),
        pd.DataFrame({"frame": [0], "t": [0.0], "png": [repr(value).encode()]}),
    )


def value_of(folder):
    """Return the value of a stored artifact; assert that its tables agree."""
    back = store.load(Points, folder)
    (value,) = {
        *back.points["x"],
        *back.readings["tip_x"],
        *(float(png) for png in back.masks["png"]),
    }
    return value


def trial(frames=3):
    """Make a trial with images of noise."""
    images = [
        np.random.default_rng(i).integers(0, 255, (8, 9)).astype(np.uint8)
        for i in range(frames)
    ]
    files = [f"images/{i:06d}.png" for i in range(frames)]
    link = {"valid": True, "reason": "", "ticks": 1, "missed": 0}
    return Trial(
        pd.DataFrame({"t": [0.0, 0.1], "q1": 0.0, "q2": 0.1, "q3": 0.2}),
        pd.DataFrame(columns=[c.name for c in Trial.TABLES["ticks"].columns]),
        pd.DataFrame(
            {"frame": range(frames), "t": np.arange(frames) / 10, "file": files}
        ),
        pd.DataFrame(
            [link | dict.fromkeys(("jitter_p50", "jitter_p99", "jitter_max"), 0.0)]
        ),
        images,
    )


def fail_at(patch, n, error):
    """Let the n-th file operation fail, every second write halfway.

    After a kill, all operations fail. Returns the performed operations.
    """
    done = []

    def wrapped(name, real):
        def operation(path, *rest):
            done.append(name)
            dead = isinstance(error, Killed) and len(done) - 1 > n
            if len(done) - 1 != n and not dead:
                return real(path, *rest)
            if name == "write" and n % 2 and not dead:
                path.write_bytes(rest[0][: len(rest[0]) // 2])
            raise error

        return operation

    for name in OPERATIONS:
        patch.setattr(disk, name, wrapped(name, getattr(disk, name)))
    if isinstance(error, Killed):
        patch.setattr(disk, "remove", lambda path: None)
    return done


def faults(monkeypatch, error, write):
    """Call write(n) with the n-th operation failing, for every n until none fails.

    Yields n, the operation and the exception.
    """
    for n in range(40):
        stopped = None
        with monkeypatch.context() as patch:
            done = fail_at(patch, n, error)
            try:
                write(n)
            except (DataError, Killed) as raised:
                stopped = raised
        if stopped is None:
            assert n > 3, "the fault was never reached"
            return
        yield n, done[n], stopped
    pytest.fail("the fault was never reached past")


def test_full_disk_leaves_the_old_or_the_new_artifact_only(tmp_path, monkeypatch):
    for n in range(40):
        store.save(points(1.0), tmp_path / str(n) / "p", {})
    full = OSError(errno.ENOSPC, "No space left on device")
    for n, _, stopped in faults(
        monkeypatch,
        full,
        lambda n: store.save(points(2.0), tmp_path / str(n) / "p", {}),
    ):
        assert "No space left" in str(stopped)
        assert "Free space" in str(stopped)
        assert value_of(tmp_path / str(n) / "p") in (1.0, 2.0)
        assert [f.name for f in (tmp_path / str(n)).iterdir()] == ["p"]


def test_kill_leaves_complete_artifacts_and_the_next_save_cleans_up(
    tmp_path, monkeypatch
):
    for n in range(40):
        store.save(points(1.0), tmp_path / str(n) / "p", {})
    for n, operation, _ in faults(
        monkeypatch,
        Killed(),
        lambda n: store.save(points(2.0), tmp_path / str(n) / "p", {}),
    ):
        place = tmp_path / str(n) / "p"
        if place.exists():
            assert value_of(place) in (1.0, 2.0)
        else:
            # between the two renames of a replacement the old artifact is whole under
            # another name
            assert operation == "rename"
            assert value_of(next(place.parent.glob(".p.*.replaced"))) == 1.0
        store.save(points(3.0), place, {})
        assert value_of(place) == 3.0
        assert [f.name for f in place.parent.iterdir()] == ["p"]


def test_failed_first_save_leaves_nothing(tmp_path, monkeypatch):
    fault = OSError(errno.EIO, "Input/output error")
    for n, operation, _ in faults(
        monkeypatch, fault, lambda n: store.save(trial(), tmp_path / str(n) / "t", {})
    ):
        left = (
            [f.name for f in (tmp_path / str(n)).iterdir()]
            if (tmp_path / str(n)).exists()
            else []
        )
        assert left == [] or (
            operation == "sync_folder"
            and len(store.load(Trial, tmp_path / str(n) / "t").images) == 3
        )


def test_tables_and_texts_are_replaced_atomically(tmp_path, monkeypatch):
    store.write_text(tmp_path / "run.json", "old")
    for _, _, _ in faults(
        monkeypatch, Killed(), lambda n: store.write_text(tmp_path / "run.json", "new")
    ):
        assert (tmp_path / "run.json").read_text() in ("old", "new")


def save_until_killed(folder, output):
    """Save one artifact after another, and write the number of each to a pipe."""
    for number in count(1):
        store.save(points(float(number)), folder / str(number % 3), {})
        os.write(output, b"%d\n" % number)


def test_randomly_killed_processes_keep_finished_artifacts(
    tmp_path,
):
    moments = np.random.default_rng(5).uniform(0.0, 0.05, 4)
    for moment in moments:
        reader, output = os.pipe()
        writer = get_context("fork").Process(
            target=save_until_killed, args=(tmp_path, output)
        )
        writer.start()
        os.close(output)
        with open(reader) as said:
            assert said.readline() == "1\n"  # the writer has begun
            time.sleep(moment)
            writer.kill()
            finished = int((["1", *said.read().split()])[-1])
        writer.join()
        # the artifact after these may have replaced the third
        for number in range(max(finished - 1, 1), finished + 1):
            assert value_of(tmp_path / str(number % 3)) >= number


def test_flipped_bit_is_detected(tmp_path):
    values = np.random.default_rng(1).normal(size=500)
    store.write_table(
        Points.TABLES["points"],
        pd.DataFrame(dict.fromkeys("tsxy", values)),
        tmp_path / "f",
        {},
    )
    whole = bytearray((tmp_path / "f").read_bytes())
    for place in range(200, 4000, 371):
        (tmp_path / "f").write_bytes(
            bytes(b ^ (i == place) for i, b in enumerate(whole))
        )
        with pytest.raises(DataError, match="not a whole Parquet file"):
            store.read_table(Points.TABLES["points"], tmp_path / "f")


def test_missing_and_foreign_files_are_named(tmp_path):
    store.save(points(1.0), tmp_path / "p", {})
    file = tmp_path / "p" / "points.parquet"
    file.write_bytes((tmp_path / "p" / "masks.parquet").read_bytes())
    with pytest.raises(DataError, match="holds the table 'masks', not 'points'"):
        store.load(Points, tmp_path / "p")
    pd.DataFrame({"speed": [1.0]}).to_parquet(file)
    with pytest.raises(
        DataError, match="has no column 't', 's', 'x', 'y'; it has speed"
    ):
        store.load(Points, tmp_path / "p")
    file.unlink()
    with pytest.raises(DataError, match="the file is missing"):
        store.load(Points, tmp_path / "p")
    with pytest.raises(DataError, match="there is no points here"):
        store.load(Points, tmp_path / "elsewhere")


def test_missing_and_damaged_images_are_named(tmp_path):
    store.save(trial(), tmp_path / "t", {})
    file = tmp_path / "t" / "images" / "000001.png"
    file.write_bytes(file.read_bytes()[:-20])
    back = store.load(Trial, tmp_path / "t")
    assert np.array_equal(back.images[0], trial().images[0])
    with pytest.raises(
        DataError, match=r"000001\.png: the frame is missing or damaged"
    ):
        back.images[1]
    file.unlink()
    with pytest.raises(DataError, match=r"000001\.png: the frame is missing"):
        store.load(Trial, tmp_path / "t")


@pytest.mark.parametrize(
    ("column", "wrong", "words"),
    [
        ("x", ["left", "right"], r"column 'x' must be float \[m\].*'left'"),
        ("valid", ["yes", "no"], r"column 'valid' must be bool.*'yes'"),
    ],
)
def test_wrong_column_type_is_named_and_nothing_written(tmp_path, column, wrong, words):
    bad = points(1.0)
    bad.points[column] = wrong
    with pytest.raises(DataError, match=words):
        store.save(bad, tmp_path / "p", {})
    assert not list(tmp_path.iterdir())


def test_unwritable_place_gives_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(
        DataError,
        match=r"file/p: cannot be written \(.*\)\. Look at the disk, or choose another folder",
    ):
        store.save(points(1.0), tmp_path / "file" / "p", {})
    with pytest.raises(DataError, match="cannot be written"):
        store.save(points(1.0), Path("/proc/nowhere/p"), {})
