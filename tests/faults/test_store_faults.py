"""Nothing half-written is ever read as whole, wherever it stops."""

import os
import shutil

import numpy as np
import pandas as pd
import pytest

from data import store
from data.artifacts import Points
from data.schema import DataError


def points(value):
    return Points(
        pd.DataFrame(
            {"t": [0.0, 0.1], "s": [0.1, 0.1], "x": [value, value], "y": [0.0, 0.0], "sigma": 1e-3, "valid": True}
        ),
        pd.DataFrame(
            {
                "frame": [0],
                "t": [0.0],
                "valid": [True],
                "reason": [""],
                "tip_x": [value],
                "tip_y": [0.0],
                "tip_sigma": [1e-3],
                "length": [0.3],
            }
        ),
        pd.DataFrame({"frame": [0], "t": [0.0], "png": [b"\x89PNG"]}),
    )


def test_what_is_saved_comes_back_with_units_and_origin(tmp_path):
    store.save(points(1.5), tmp_path / "p", {"seed": 3, "config": {"a": 1}})
    back = store.load(Points, tmp_path / "p")
    pd.testing.assert_frame_equal(back.points, points(1.5).points, check_exact=True)
    assert back.masks["png"][0] == b"\x89PNG"
    assert store.origin_of(tmp_path / "p" / "points.parquet")["seed"] == 3
    import pyarrow.parquet as pq

    field = pq.read_schema(tmp_path / "p" / "points.parquet").field("x")
    assert field.metadata[b"unit"] == b"m"
    assert field.metadata[b"meaning"]


@pytest.mark.parametrize("operation", ["open", "fsync", "replace"])
def test_a_fault_at_every_operation_leaves_the_old_or_the_new(tmp_path, monkeypatch, operation):
    """Fail the n-th call for every n, until a save needs fewer calls than that."""
    real = getattr(os, operation)
    for n in range(200):
        folder = tmp_path / f"{operation}{n}" / "p"
        store.save(points(1.0), folder, {})
        count = iter(range(10**6))

        def failing(*args, n=n, count=count, **kwargs):
            if next(count) == n:
                raise OSError(28, "No space left on device")
            return real(*args, **kwargs)

        with monkeypatch.context() as patch:
            patch.setattr(os, operation, failing)
            try:
                store.save(points(2.0), folder, {})
                failed = False
            except DataError as error:
                failed = True
                assert "No space left" in str(error)
        if folder.exists():
            back = store.load(Points, folder)
            assert back.points["x"].nunique() == 1
            assert {back.points["x"][0], back.readings["tip_x"][0]} in ({1.0}, {2.0})
        else:
            assert operation == "replace"  # killed between two renames: redone, never half
        assert not list(folder.parent.glob(".*.part"))
        if not failed:
            assert n > 0
            return
    pytest.fail("the fault was never reached past")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_truncated_and_missing_files_are_named(tmp_path, share):
    store.save(points(1.0), tmp_path / "p", {})
    file = tmp_path / "p" / "points.parquet"
    whole = file.read_bytes()
    file.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(DataError, match=r"points\.parquet.*not a whole Parquet file"):
        store.load(Points, tmp_path / "p")
    file.unlink()
    with pytest.raises(DataError, match="missing"):
        store.load(Points, tmp_path / "p")
    shutil.rmtree(tmp_path / "p")
    with pytest.raises(DataError, match="there is no points"):
        store.load(Points, tmp_path / "p")


def test_a_column_of_the_wrong_kind_is_named(tmp_path):
    bad = points(1.0)
    bad.points["x"] = ["left", "right"]
    with pytest.raises(DataError, match=r"column 'x' must be float \[m\].*'left'"):
        store.save(bad, tmp_path / "p", {})
    assert not (tmp_path / "p").exists()


def test_a_place_that_cannot_be_written_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        store.write_text(tmp_path / "file" / "x", "1")
    with pytest.raises(DataError, match="cannot be written"):
        store.save(points(1.0), tmp_path / "file" / "p", {})


def test_images_are_kept_to_the_bit_and_missing_ones_are_named(tmp_path):
    images = [np.random.default_rng(i).integers(0, 255, (8, 9)).astype(np.uint8) for i in range(3)]
    store.write_images(images, tmp_path / "images")
    back = store.ImageFolder(tmp_path / "images", 4)
    assert all(np.array_equal(a, back[i]) for i, a in enumerate(images))
    with pytest.raises(DataError, match=r"000003\.png"):
        back[3]
