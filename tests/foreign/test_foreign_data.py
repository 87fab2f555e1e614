"""Foreign measured data.

They cannot block, fill the memory, reach other folders or control the terminal.
"""

import io
import json
import os
import struct
import time
import zlib

import cv2
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from rich.console import Console

from stringcast.data import dataset, file_checks, store, table_files
from stringcast.data.artifacts import POINTS
from stringcast.data.images import ImageFiles, Video
from stringcast.data.metadata import read_metadata
from stringcast.data.schema import DataError
from stringcast.data.table_files import with_trial
from stringcast.pipeline.commands import check, index
from stringcast.stages.check import clocks, contents
from stringcast.stages.check.measured import CheckedDataset
from tests.store.test_dataset import CAMERA, T, grasp, points, shade, write_tables

needs_pipes = pytest.mark.skipif(
    not hasattr(os, "mkfifo"), reason="this system has no pipes in folders"
)
BOMB = "a: &a [1, 2]\n" + "".join(
    f"{b}: &{b} [{', '.join(['*' + a] * 9)}]\n"
    for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


def lens(**changed):
    """Return the text of a dataset.yaml with a lens."""
    known = {
        "focal": "[500, 500]",
        "centre": "[320, 240]",
        "distortion": "[0.1, 0, 0, 0]",
    } | changed
    return f"camera: {{lens: {{{', '.join(f'{name}: {value}' for name, value in known.items())}}}}}"


REFUSED = {
    "bomb": (BOMB, "stands for a list or a block"),
    "deep": ("string: " + "[" * 1500 + "]" * 1500, "too deep"),
    "deep blocks": ("".join(" " * i + "a:\n" for i in range(1300)), "too deep"),
    "resolver": ("name: ${oc.env:HOME}", r"name holds '\$\{'"),
    "resolver in a name": ("'${oc.env:HOME}': 1", r"holds '\$\{'"),
    "object": ("name: !!python/object/apply:os.getcwd []", "not valid YAML"),
    "large": ("# " + "x" * file_checks.MAX_TEXT_BYTES, "at most"),
    "true format": ("format: true", "format is True"),
    "true length": ("string: {length: true}", r"string\.length is True"),
    "long": (
        "string: {length: 1e300}",
        r"string\.length is '1e300'; it must be 1000\.0 or less",
    ),
    "wide": (
        "camera: {width: 10000000000}",
        r"camera\.width is 10000000000; it must be 1048576 or less",
    ),
    "true width": ("camera: {width: true}", r"camera\.width is True"),
    "list": ("[1, 2]", "must hold names and values"),
    "lens of one number": (
        "camera: {lens: 3}",
        r"camera\.lens is 3; it must hold names and values",
    ),
    "lens without focal": (
        "camera: {lens: {centre: [1, 2]}}",
        r"camera\.lens\.focal is missing",
    ),
    "focal": (
        lens(focal="[0, 500]"),
        r"camera\.lens\.focal\.0 is 0; it must be above 0",
    ),
    "infinite focal": (lens(focal="[.inf, 500]"), r"camera\.lens\.focal\.0 is inf"),
    "centre": (
        lens(centre="[1, 2, 3]"),
        r"camera\.lens\.centre is \[1, 2, 3\]; it must hold 2 values",
    ),
    "true distortion": (
        lens(distortion="[true, 0, 0, 0]"),
        r"camera\.lens\.distortion\.0 is True",
    ),
    "unknown of a lens": (lens(k3="1"), r"camera\.lens\.k3 is 1; there is no such key"),
    "distorted twice": (
        lens()[:-1] + ", distortion: 0.1}",
        "a lens has its own distortion",
    ),
    "tilt without lens": ("camera: {tilt: [0.1, 0]}", "needs camera.lens"),
    "twice": ("string: {length: 0.3}\nstring: {length: 3.0}", "string is given twice"),
    # Python cannot print these numbers
    "thousands of digits": (f"remark: 0x{'f' * 5000}", "a whole number of 5002 digits"),
    "hundreds of digits": (
        f"camera: {{width: {'9' * 400}}}",
        "a whole number of 400 digits",
    ),
    "set": ("trials: !!set {a, b}", "not valid YAML"),
    "bytes": ("name: !!binary AAAA", "not valid YAML"),
    "date": (
        "string: {length: 2024-01-01}",
        r"string\.length is '2024-01-01'; it must be a number",
    ),
    "long text": (
        f"string: {{length: {'x' * 10000}}}",
        r"string\.length is 'x{199}\.\.\.; it must be a number",
    ),
    "too many pixels": (
        "camera: {width: 100000, height: 100000}",
        "width x height is at most 67108864 pixels",
    ),
    "noise below an atom": (
        "noise: {point_sigma: 1e-300}",
        r"noise\.point_sigma is .*; it must be 1e-09 or more",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_dataset_yaml_is_refused(tmp_path, case):
    text, message = REFUSED[case]
    (tmp_path / "dataset.yaml").write_text(text)
    begun = time.process_time()
    with pytest.raises(DataError, match=rf"dataset\.yaml[\s\S]*{message}"):
        read_metadata(tmp_path)
    assert time.process_time() - begun < 5


def test_wrong_encoding_is_reported(tmp_path):
    (tmp_path / "dataset.yaml").write_bytes("string: {length: 0.3}".encode("utf-16"))
    with pytest.raises(
        DataError, match=r"dataset\.yaml: it is not text in UTF-8 .*Save it as UTF-8"
    ):
        read_metadata(tmp_path)
    (tmp_path / "dataset.yaml").write_bytes("string: {length: 0.3}".encode("utf-8-sig"))
    assert read_metadata(tmp_path) == {"string": {"length": 0.3}}


def test_aliases_of_scalars_are_accepted(tmp_path):
    (tmp_path / "dataset.yaml").write_text("camera: {width: &side 64, height: *side}")
    assert read_metadata(tmp_path)["camera"] == {"width": 64, "height": 64}


@pytest.mark.parametrize(
    "file", ["dataset.yaml", "grasp.csv", "points.parquet", "videos/a.mp4"]
)
@needs_pipes
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_pipes_and_devices_are_refused(tmp_path, file, kind):
    write_tables(
        tmp_path,
        {"string": {"length": 0.3}, "camera": CAMERA},
        grasp=grasp(),
        points=points(),
    )
    path = tmp_path / file
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(DataError, match=rf"{path.name}: it is no plain file"):
        dataset.read_dataset(tmp_path)


@pytest.mark.parametrize(
    "file", ["dataset.yaml", "grasp.csv", "points.csv", "videos/a.mp4"]
)
def test_links_out_of_the_folder_are_refused(tmp_path, file):
    folder = tmp_path / "data"
    write_tables(
        folder,
        {"string": {"length": 0.3}, "camera": CAMERA},
        grasp=grasp(),
        points=points(),
    )
    path, elsewhere = folder / file, tmp_path / "elsewhere"
    path.parent.mkdir(exist_ok=True)
    elsewhere.write_bytes(path.read_bytes() if path.exists() else b"")
    path.unlink(missing_ok=True)
    path.symlink_to(elsewhere)
    with pytest.raises(
        DataError,
        match=rf"{path.name}: it is a link that leaves the folder .*Put the file itself",
    ):
        dataset.read_dataset(folder)


def test_links_inside_the_folder_are_followed(tmp_path):
    write_tables(
        tmp_path / "data", {"string": {"length": 0.3}}, grasp=grasp(), points=points()
    )
    (tmp_path / "data" / "points.csv").rename(tmp_path / "data" / "tracked.csv")
    (tmp_path / "data" / "points.csv").symlink_to("tracked.csv")
    (tmp_path / "link").symlink_to("data")
    assert list(dataset.read_dataset(tmp_path / "link").trials) == ["a"]


def test_too_large_tables_are_refused_unread(tmp_path, monkeypatch):
    write_tables(tmp_path, {"string": {"length": 0.3}}, grasp=grasp())
    pd.concat([points()] * 20).to_parquet(tmp_path / "points.parquet")
    monkeypatch.setattr(file_checks, "MAX_TABLE_BYTES", 1000)
    monkeypatch.setattr(pq.ParquetFile, "read", lambda *_: pytest.fail("it was read"))
    with pytest.raises(
        DataError,
        match=r"points\.parquet: 1000 rows of .* columns would take .*Split it",
    ):
        dataset.read_dataset(tmp_path)


def stored(folder, **columns):
    """Store a dataset with additional or replaced columns of points."""
    write_tables(folder, {"string": {"length": 0.3}}, grasp=grasp())
    whole = {name: pa.array(values) for name, values in points().items()} | columns
    pq.write_table(pa.table(whole), folder / "points.parquet")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("x", [[0.1]] * len(T)),
        ("trial", [{"a": "b"}] * len(T)),
        ("sigma", [{"a": 1.0}] * len(T)),
    ],
)
def test_needed_columns_of_lists_are_refused(tmp_path, name, values):
    stored(tmp_path, **{name: pa.array(values)})
    with pytest.raises(
        DataError,
        match=rf"points\.parquet: column '{name}' holds (list|struct)<.*Store plain columns",
    ):
        dataset.read_dataset(tmp_path)


def test_unneeded_columns_of_lists_are_ignored(tmp_path):
    stored(tmp_path, remark=pa.array([[{"a": [1, 2]}]] * len(T)))
    assert len(dataset.read_dataset(tmp_path).trials["a"].points) == len(T)


def test_too_many_or_repeated_columns_are_refused(tmp_path, monkeypatch):
    write_tables(tmp_path, {"string": {"length": 0.3}}, grasp=grasp())
    names = [*points(), "x"]
    pq.write_table(
        pa.Table.from_arrays([pa.array(points()[n]) for n in names], names),
        tmp_path / "points.parquet",
    )
    with pytest.raises(
        DataError, match=r"points\.parquet: it has the column 'x' twice"
    ):
        dataset.read_dataset(tmp_path)
    monkeypatch.setattr(file_checks, "MAX_COLUMNS", 5)
    with pytest.raises(
        DataError, match=r"points\.parquet: it has 6 columns, at most 5 are read"
    ):
        dataset.read_dataset(tmp_path)


def test_too_long_first_lines_are_refused_unread(tmp_path):
    """Pandas takes over a minute for two million column names."""
    write_tables(tmp_path, {"string": {"length": 0.3}}, grasp=grasp())
    (tmp_path / "points.csv").write_bytes(b"trial,t,s,x,y," + b"a," * 100_000)
    with pytest.raises(DataError, match=r"points\.csv: its first line does not end"):
        dataset.read_dataset(tmp_path)


def test_too_many_trials_are_refused_unread(tmp_path):
    names = [f"t{k}" for k in range(table_files.MAX_TRIALS + 1)]
    many = pd.DataFrame({"trial": names, "t": 0.0, "x": 0.0, "y": 0.0, "theta": 0.0})
    write_tables(tmp_path, {"string": {"length": 0.3}}, grasp=many, points=points())
    with pytest.raises(
        DataError,
        match=r"grasp\.csv: it holds 4001 trials, at most 4000 are read\. Split it",
    ):
        dataset.read_dataset(tmp_path)


@pytest.mark.parametrize("table", ["grasp", "points"])
@pytest.mark.parametrize("last", [1e7, 1e18])
def test_too_long_time_spans_are_an_error(tmp_path, table, last):
    tables = {"grasp": grasp(), "points": points()}
    tables[table].loc[len(T) - 1, "t"] = last
    write_tables(tmp_path, {"string": {"length": 0.3}}, **tables)
    (found,) = clocks.check_duration(looked_at(tmp_path))
    assert (found.severity, found.file) == ("error", f"{table}.csv")
    assert f"times span {last:.4g} s" in found.statement


def test_impossible_times_are_dropped(tmp_path):
    write_tables(
        tmp_path, {"string": {"length": 0.3}}, grasp=grasp(), points=points(t=T * 1e300)
    )
    read = dataset.read_dataset(tmp_path)
    # all rows but that of t = 0
    assert read.row_counts["points.csv"].dropped == {"t is beyond 1e+19": len(T) - 1}
    assert not read.trials


def test_too_small_sigmas_are_dropped(tmp_path):
    """Their square underflows to zero."""
    write_tables(
        tmp_path,
        {"string": {"length": 0.3}},
        grasp=grasp(),
        points=points().assign(sigma=[1e-300] + [1e-3] * 49),
    )
    assert dataset.read_dataset(tmp_path).row_counts["points.csv"].dropped == {
        "sigma is below 1e-09 m": 1
    }


@pytest.mark.parametrize("way", ["absolute", "up", "link"])
def test_frames_outside_the_folder_are_refused(tmp_path, way):
    folder = tmp_path / "data"
    folder.mkdir()
    outside = tmp_path / "secret.png"
    outside.write_bytes(cv2.imencode(".png", shade(0))[1].tobytes())
    (folder / "link.png").symlink_to(outside)
    named = {"absolute": str(outside), "up": "../secret.png", "link": "link.png"}[way]
    frames = pd.DataFrame(
        {"trial": "a", "frame": np.arange(5), "t": T[::10], "file": named}
    )
    write_tables(
        folder,
        {"string": {"length": 0.3}, "camera": CAMERA},
        grasp=grasp(),
        frames=frames,
        points=points(),
    )
    with pytest.raises(
        DataError,
        match=rf"frames\.csv: the frame '{named}' .*lies outside the folder.*Copy it there",
    ):
        dataset.read_dataset(folder)


@pytest.mark.parametrize(
    "named",
    ["lost.png", "a\0b.png", "x" * 5000, None],
    ids=["lost", "zero byte", "too long", "none"],
)
def test_missing_frames_are_counted(tmp_path, named):
    frames = pd.DataFrame(
        {"trial": "a", "frame": np.arange(5), "t": T[::10], "file": named}
    )
    write_tables(
        tmp_path,
        {"string": {"length": 0.3}, "camera": CAMERA},
        grasp=grasp(),
        points=points(),
    )
    frames.to_parquet(tmp_path / "frames.parquet")
    found = dataset.read_dataset(tmp_path)
    assert not found.films
    assert found.row_counts["frames.parquet"].dropped == {"no file": 5}


@pytest.mark.parametrize("name", ["[/]", "[bold]", "<script>", "a b"])
def test_names_are_not_interpreted_as_markup(tmp_path, name):
    folder = tmp_path / "[bold]"
    write_tables(
        folder,
        {"name": "[/]", "string": {"length": 0.3}},
        grasp=grasp(name),
        points=points(name),
    )
    out = io.StringIO()
    check.print_overview(
        check.dataset_overview(check.read_measurements(folder, ())),
        Console(file=out, width=200),
    )
    assert name in out.getvalue()


def test_names_with_control_characters_are_refused(tmp_path):
    write_tables(tmp_path, {}, grasp=grasp("a\x1b[2J"), points=points("a\x1b[2J"))
    with pytest.raises(
        DataError,
        match=r"grasp\.csv: the trial 'a\\x1b\[2J' has a name that cannot be printed",
    ):
        dataset.read_dataset(tmp_path)


def looked_at(folder):
    read = dataset.read_dataset(folder)
    return CheckedDataset(read, None, None, 0.3)


def test_implausible_values_give_warnings(tmp_path):
    far = points()
    far.loc[3, "x"] = 1e308
    about_it = {
        "strng": {"length": 0.3},
        "trials": {"a": {"role": "heldout"}},
    }
    write_tables(tmp_path, about_it, grasp=grasp(), points=far)
    data = looked_at(tmp_path)
    assert data.data.row_counts["points.csv"].dropped == {"x is beyond 1e+09": 1}
    said = {
        f.field: f.statement
        for look in (contents.check_names, contents.check_roles)
        for f in look(data)
    }
    assert "'string' is one" in said["strng"]
    assert "'heldout' is no role" in said["trials.a.role"]


def test_own_files_can_be_read(tmp_path):
    known = {
        "format": 1,
        "string": {"length": 0.3},
        "camera": {"tilt": [0.0, 0.0], "origin_px": [0.0, 0.0]},
    }
    (tmp_path / "dataset.yaml").write_text(yaml.safe_dump(known))
    assert read_metadata(tmp_path) == known


def huge_png(side):
    """Return the header of a PNG of `side` x `side` pixels."""
    head = b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    chunks = ((13, head), (0, b"IDAT"), (0, b"IEND"))
    whole = [
        struct.pack(">I", size) + chunk + struct.pack(">I", zlib.crc32(chunk))
        for size, chunk in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(whole)


def test_frames_of_different_sizes_are_refused_by_name(tmp_path):
    for name, image in (("a.png", shade(0)), ("b.png", shade(1)[:16])):
        cv2.imwrite(str(tmp_path / name), image)
    images = ImageFiles(tmp_path, ("a.png", "b.png"))
    assert images.read(0).shape == (32, 48)
    with pytest.raises(
        DataError,
        match=r"b\.png: it has 48 x 16 pixels, the first frame of its trial has 48 x 32",
    ):
        images.read(1)


def test_decompression_bombs_are_refused_by_their_header(tmp_path, monkeypatch):
    monkeypatch.setattr(cv2, "imread", lambda *_: pytest.fail("it was unpacked"))
    # beyond our bound, and beyond the imaging library's own
    for side in (10_000, 60_000):
        (tmp_path / "a.png").write_bytes(huge_png(side))
        with pytest.raises(
            DataError, match=r"a\.png: .*(pixels, at most|exceeds limit)"
        ):
            ImageFiles(tmp_path, ("a.png",)).read(0)


@needs_pipes
def test_pipe_instead_of_a_picture_is_refused(tmp_path):
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(DataError, match="no plain file"):
        ImageFiles(tmp_path, ("a.png",)).read(0)


@pytest.mark.parametrize(
    "content",
    [b"#EXTM3U\n/etc/hostname\n", b"ffconcat version 1.0\nfile /etc/hostname\n", b""],
)
def test_playlist_is_not_accepted_as_video(tmp_path, monkeypatch, content):
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: pytest.fail("it was opened"))
    (tmp_path / "a.mp4").write_bytes(content)
    with pytest.raises(DataError, match=r"a\.mp4: no MP4"):
        len(Video(tmp_path / "a.mp4"))


@needs_pipes
def test_index_lists_foreign_content_as_damaged_or_as_text(tmp_path, capsys):
    made = {"[bold]": {}, "other": {"sentence": 1}, "piped": {}}
    for name, ended in made.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text(json.dumps(ended))
        settings = json.dumps({"mode": [], "name": "[/]\x1b[2J"})
        (tmp_path / name / "config.json").write_text(settings.replace('": [', '":  ['))
    (tmp_path / "piped" / "config.json").unlink()
    os.mkfifo(tmp_path / "piped" / "config.json")
    assert index.main([str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "\x1b[2J" not in shown
    found = index.list_runs(tmp_path).set_index("run")["state"]
    assert found.to_dict() == {"[bold]": "incomplete", "other": "damaged"}


def test_repeated_long_texts_are_held_once(tmp_path):
    """20 kB on the disk would become 100 MB with a copy for each row."""
    long_text = "x" * 2**18
    write_tables(tmp_path, {"string": {"length": 0.3}}, grasp=grasp())
    pd.concat([points()] * 8).assign(remark=long_text).to_parquet(
        tmp_path / "points.parquet"
    )
    assert (tmp_path / "points.parquet").stat().st_size < 2**18
    frame = store.read_table(with_trial(POINTS), tmp_path / "points.parquet")
    assert len(frame) == 400
    # one copy for each batch that is read
    assert len({id(text) for text in frame["remark"]}) < 10
    assert frame["trial"].tolist() == ["a"] * 400
