"""Artifacts are stored bit by bit, with units, origin and content hash."""

import hashlib
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from stringcast.data import disk, store
from stringcast.data.artifacts import Points, Trial
from stringcast.data.images import CachedImages, Images, RecentImages
from stringcast.data.schema import DataError

AWKWARD = [0.1, -0.0, np.inf, -np.inf, np.nan, 5e-324, 1 / 3, np.nextafter(1.0, 2.0)]


@pytest.fixture
def points():
    return Points(
        pd.DataFrame(
            {
                "t": AWKWARD,
                "s": 0.1,
                "x": AWKWARD[::-1],
                "y": 0.0,
                "valid": [True, False] * 4,
                "held": 3,
            }
        ),
        pd.DataFrame(
            {
                "frame": [2**53 + 1],
                "t": 0.0,
                "valid": False,
                "reason": "Δ, 'quoted'",
                "tip_x": np.nan,
                "tip_y": 0.0,
            }
            | {"tip_sigma": 1e-3, "length": 0.3}
        ),
        pd.DataFrame({"frame": [0], "t": [0.0], "png": [b"\x89PNG\0\xff"]}),
    )


def test_artifacts_are_read_bit_by_bit(points, tmp_path):
    store.save(points, tmp_path / "p", {})
    back = store.load(Points, tmp_path / "p")
    for name in Points.TABLES:
        pd.testing.assert_frame_equal(
            getattr(back, name), Points.TABLES[name].check(getattr(points, name))
        )
    assert np.array_equal(np.signbit(back.points["t"]), np.signbit(points.points["t"]))
    assert back.readings["frame"][0] == 2**53 + 1  # no conversion to floating point
    assert list(back.points["held"]) == [3] * 8  # unknown columns are kept


def test_files_hold_units_meanings_and_origin(points, tmp_path):
    made = {"seed": 3, "config": {"a": [1.5, None]}}
    store.save(points, tmp_path / "p", made)
    assert store.read_origin(tmp_path / "p" / "points.parquet") == made
    for name, table in Points.TABLES.items():
        schema = pq.read_schema(tmp_path / "p" / f"{name}.parquet")
        for column in table.columns:
            if column.name in schema.names:
                assert (
                    schema.field(column.name).metadata[b"unit"].decode() == column.unit
                )
                assert schema.field(column.name).metadata[b"meaning"]


def test_equal_content_has_equal_bytes_and_hash(points, tmp_path):
    for name in "ab":
        store.save(points, tmp_path / name, {"seed": 1})
    assert (tmp_path / "a/points.parquet").read_bytes() == (
        tmp_path / "b/points.parquet"
    ).read_bytes()
    store.save(points, tmp_path / "c", {"seed": 2})
    hashes = {name: store.content_hash(tmp_path / name) for name in "abc"}
    assert len(set(hashes.values())) == 1, (
        "a hash of the content must not depend on who made it"
    )
    points.points.loc[6, "x"] = np.nextafter(points.points["x"][6], 1)
    store.save(points, tmp_path / "a", {"seed": 1})
    assert store.content_hash(tmp_path / "a") != hashes["b"]
    renamed = replace(points, points=points.points.rename(columns={"held": "kept"}))
    store.save(renamed, tmp_path / "c", {"seed": 1})
    assert store.content_hash(tmp_path / "c") != store.content_hash(tmp_path / "a")


def test_hash_in_chunks_equals_hash_of_the_whole_file(points, tmp_path, monkeypatch):
    """Stored origins hold hashes of whole files."""
    store.save(points, tmp_path / "a", {"seed": 1})
    (tmp_path / "a" / "film.mp4").write_bytes(bytes(range(256)) * 9)
    folder = hashlib.sha256()
    for file in sorted((tmp_path / "a").rglob("*")):
        content = file.read_bytes()
        if file.suffix == ".parquet":
            pages = content[: -int.from_bytes(content[-8:-4], "little") - 8]
            content = (
                pq.read_schema(file).remove_metadata().serialize().to_pybytes() + pages
            )
        whole = hashlib.sha256(content).hexdigest()
        folder.update(f"{file.name}\0{whole}\0".encode())
    monkeypatch.setattr(
        Path, "read_bytes", lambda path: pytest.fail(f"{path} was read whole")
    )
    for size in (7, 256, 2**20):
        monkeypatch.setattr(store, "CHUNK_BYTES", size)
        assert store.content_hash(tmp_path / "a") == folder.hexdigest()


@pytest.mark.skipif(
    not Path("/proc/self/fd").exists(), reason="only Linux names an open file"
)
def test_files_are_synced_before_the_rename(points, tmp_path, monkeypatch):
    """A power cut must not leave incomplete files."""
    done = []
    true_sync, true_rename = os.fsync, os.replace
    monkeypatch.setattr(
        os,
        "fsync",
        lambda handle: (
            done.append(os.readlink(f"/proc/self/fd/{handle}")),
            true_sync(handle),
        )[1],
    )
    monkeypatch.setattr(
        os, "replace", lambda a, b: (done.append("rename"), true_rename(a, b))[1]
    )
    store.save(points, tmp_path / "p", {})
    before = done[: done.index("rename")]
    assert {Path(name).name for name in before} >= {
        "masks.parquet",
        "points.parquet",
        "readings.parquet",
    }
    aside = str(Path(before[0]).parent)
    assert aside in before
    assert str(tmp_path) in done[done.index("rename") :]


def test_saving_again_replaces_the_folder(points, tmp_path):
    store.save(points, tmp_path / "p", {})
    (tmp_path / "p" / "stray.txt").write_text("of the old one")
    store.save(points, tmp_path / "p", {})
    assert sorted(f.name for f in (tmp_path / "p").iterdir()) == [
        "masks.parquet",
        "points.parquet",
        "readings.parquet",
    ]


def test_images_are_read_lazily_in_table_order(tmp_path):
    images = [np.full((4, 5), level, np.uint8) for level in (10, 20, 30)]
    frames = pd.DataFrame(
        {
            "frame": [0, 1, 2],
            "t": [0.0, 0.1, 0.2],
            "file": ["i/b.png", "i/a.png", "i/c.png"],
        }
    )
    empty = {name: table.empty() for name, table in Trial.TABLES.items()}
    store.save(
        Trial(**(empty | {"frames": frames, "images": images})), tmp_path / "t", {}
    )
    back = store.load(Trial, tmp_path / "t").images
    assert [int(image[0, 0]) for image in back] == [10, 20, 30]
    assert int(back[-1][0, 0]) == 30
    assert [int(image[0, 0]) for image in back[::2]] == [10, 30]
    with pytest.raises(IndexError):
        back[3]


def test_recent_images_are_cached_within_the_limit(monkeypatch):
    """With a limit of two images, the two used last are cached."""
    pictures = [np.full((4, 5), i, np.uint8) for i in range(3)]
    read = []

    class Files(Images):
        def __len__(self):
            return len(pictures)

        def read(self, index):
            read.append(index)
            return pictures[index]

    held = CachedImages(Files())
    assert [int(image[0, 0]) for _ in range(3) for image in held] == [0, 1, 2] * 3
    assert held[-1] is pictures[2]
    assert sorted(read) == [0, 0, 1, 2]  # the first read of image 0 was for its size

    monkeypatch.setattr("stringcast.data.images.CACHE_BYTES", 2 * pictures[0].nbytes)
    read.clear()
    held = CachedImages(Files())
    for index in (0, 1, 0, 1, 2, 1, 0):
        assert held[index] is pictures[index]
    assert read == [0, 0, 1, 2, 0]


def test_recent_images_are_returned_from_memory_once():
    class Files(Images):
        def __len__(self):
            return 3

        def read(self, index):
            return np.full((2, 2), 10 + index)

    fresh = RecentImages(Files(), [np.full((2, 2), i) for i in range(3)])
    assert [int(image[0, 0]) for image in fresh] == [0, 1, 2]
    assert [int(image[0, 0]) for image in fresh[1:]] == [11, 12]


def test_only_complete_copy_is_never_removed(tmp_path, monkeypatch):
    """A kill between two renames leaves only the old copy under a temporary name."""
    path, kept = tmp_path / "a.txt", tmp_path / ".a.txt.0123abcd.replaced"
    kept.write_text("the only one")

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr(store.disk, "write", full)
        with pytest.raises(DataError, match="Free space"):
            store.write_text(path, "new")
    assert kept.read_text() == "the only one"
    store.write_text(path, "new")
    assert [file.name for file in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("name", ["arm.csv", "dataset.yaml"])
def test_hash_of_other_files_covers_all_bytes(tmp_path, name):
    hashes = []
    for folder, content in (
        ("a", b"t,q1\n0,1\n"),
        ("b", b"t,q1\n0,1\n"),
        ("c", b"t,q1\n0,2\n"),
    ):
        disk.make_folder(tmp_path / folder)
        disk.write(tmp_path / folder / name, content)
        hashes.append(store.content_hash(tmp_path / folder / name))
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes")
def test_pipe_instead_of_a_table_is_refused(tmp_path):
    os.mkfifo(tmp_path / "fit.parquet")
    with pytest.raises(DataError, match=r"fit\.parquet"):
        store.read_origin(tmp_path / "fit.parquet")


def test_folders_are_made_and_removed_recursively(tmp_path):
    disk.make_folder(tmp_path / "a" / "b")
    disk.make_folder(tmp_path / "a" / "b")
    disk.write(tmp_path / "a" / "b" / "c", b"d")
    disk.remove(tmp_path / "a")
    disk.remove(tmp_path / "a")
    assert list(tmp_path.iterdir()) == []


def test_lock_is_exclusive(tmp_path):
    with (
        disk.hold_lock(tmp_path / "lock"),
        pytest.raises(BlockingIOError),
        disk.hold_lock(tmp_path / "lock"),
    ):
        pass
    with disk.hold_lock(tmp_path / "lock"):
        pass


@pytest.mark.parametrize("again", [False, True])
def test_lock_on_a_removed_file_is_repeated(tmp_path, monkeypatch, again):
    """The previous holder removed the file; a third process may have made it again."""
    path = tmp_path / "lock"

    def late(file):
        path.rename(tmp_path / "gone")
        if again:
            path.write_bytes(b"")

    monkeypatch.setattr(disk, "lock_file", late)
    with pytest.raises(BlockingIOError, match="removed"), disk.hold_lock(path):
        pass
