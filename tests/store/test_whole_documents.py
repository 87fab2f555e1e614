"""Stored documents round-trip, and truncated copies give one clear error."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from stringcast.data.artifacts import ARM
from stringcast.data.file_checks import mark_yaml_end, read_json, read_yaml
from stringcast.data.metadata import read_metadata
from stringcast.data.schema import DataError
from stringcast.data.store import read_origin, read_table, write_table, write_text
from stringcast.pipeline.api.known import KnownString
from stringcast.pipeline.commands.dataset_import import ImportedDataset, write_dataset
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.settings_from_runs import (
    read_extended_model,
    read_measured_camera,
)
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.calibrate.tables import camera_settings
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.lens import Lens

COUNT = 40
NAMES = st.text(st.characters(codec="utf-8", exclude_characters="$"), max_size=20)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
LEAVES = st.none() | st.booleans() | st.integers(-(2**53), 2**53) | NUMBERS | NAMES
DOCUMENTS = st.dictionaries(
    NAMES, LEAVES | st.lists(LEAVES, max_size=3), min_size=1, max_size=5
)
MODEL = {
    "effects": ["arm_lag", "wind"],
    "string": {"length": 0.304, "points": 21},
    "parameter_values": {
        "wind.along_x": {"value": 0.06, "low": 0.06, "high": 0.06},
        "string.mass": 1e-3,
    },
}
METADATA = {
    "format": 1,
    "string": {"length": 0.3},
    "trials": {"a": {"role": "held_out"}},
}
CAMERA = {"width": 64, "height": 48, "px_per_m": 100.0, "origin_px": [32.0, 24.0]}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("documents")


@given(DOCUMENTS)
@settings(deadline=None, max_examples=60)
def test_json_and_yaml_round_trip(place, values):
    write_text(place / "run.json", json.dumps(values))
    assert read_json(place / "run.json") == values
    text = mark_yaml_end(yaml.safe_dump(values, sort_keys=False))
    (place / "some.yaml").write_text(text, encoding="utf-8", newline="")
    assert read_yaml(place / "some.yaml") == values


VALUES = st.floats(-1e6, 1e6)


@given(
    st.dictionaries(
        st.sampled_from(["wind.along_x", "string.mass", "arm_lag.time"]),
        st.tuples(VALUES, VALUES, VALUES).map(sorted),
    )
)
@settings(deadline=None, max_examples=60)
def test_extended_model_round_trips(place, ranges):
    known = {}
    for name, (low, value, high) in ranges.items():
        known[name] = {"value": value, "low": low, "high": high}
    saved = KnownString({**MODEL, "parameter_values": known})
    saved.save(place)
    assert KnownString.load(place).settings == saved.settings


POSITIVE = st.floats(1e-6, 1e6)
LENGTHS = st.floats(0.01, 20.0)  # [m]; import refuses others
SECONDS = st.floats(-1e11, 1e11)
TRIAL_NAMES = st.sampled_from(["t1", "null", "1e3", "01", "on", "Straße 7"])
CLOCKS = st.fixed_dictionaries(
    {
        "low": st.floats(-1e3, -1e-6),
        "high": st.floats(1e-6, 1e3),
        "added": SECONDS | st.dictionaries(TRIAL_NAMES, SECONDS, min_size=1),
    }
)


@given(
    st.fixed_dictionaries(
        {"format": st.just(1), "string": st.fixed_dictionaries({"length": LENGTHS})},
        optional={
            "arm": st.fixed_dictionaries(
                {
                    "links": st.lists(LENGTHS, min_size=3, max_size=3),
                    "base": st.lists(VALUES, min_size=2, max_size=2),
                }
            ),
            "clock": CLOCKS,
            "initial": st.just("moving"),
        },
    )
)
@settings(deadline=None, max_examples=25)
def test_imported_description_round_trips(place, metadata):
    rows = pd.DataFrame({"trial": ["a"], "t": 0.0, "q1": 0.1, "q2": 0.2, "q3": 0.3})
    points = pd.DataFrame()
    imported = ImportedDataset(ARM, rows, points, {}, metadata, [])
    folder = place / "imported"
    shutil.rmtree(folder, ignore_errors=True)
    write_dataset(imported, folder, (), "")
    assert read_metadata(folder) == metadata | {"imported": {}}


@given(
    st.builds(
        Camera,
        width=st.integers(16, 4000),
        height=st.integers(16, 4000),
        px_per_m=POSITIVE,
        origin_px=st.tuples(VALUES, VALUES),
        fps=st.floats(1, 1e5),
        exposure=st.floats(0, 1e-2),
        rotation=st.floats(-3, 3),
        tilt=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
        lens=st.builds(
            Lens,
            st.tuples(POSITIVE, POSITIVE),
            st.tuples(VALUES, VALUES),
            st.tuples(*[st.floats(-1, 1)] * 4),
        ),
    )
)
@settings(deadline=None, max_examples=25)
def test_calibrated_camera_round_trips(place, camera):
    text = camera_settings(camera)
    (place / "camera.yaml").write_text(text)
    read = build_dataclass(Camera, read_measured_camera(place), "camera", "conf/camera")
    assert camera_settings(read) == text  # written to ten digits
    assert read.origin_px == pytest.approx(camera.origin_px, rel=1e-9)
    assert read.lens.focal == pytest.approx(camera.lens.focal, rel=1e-9)


@given(st.lists(NUMBERS, min_size=1, max_size=10), NAMES)
@settings(deadline=None, max_examples=30)
def test_table_and_footer_round_trip(place, numbers, step):
    frame = pd.DataFrame({"t": numbers, "q1": 0.1, "q2": 0.2, "q3": 0.3})
    write_table(ARM, frame, place / "arm.parquet", {"step": step})
    pd.testing.assert_frame_equal(read_table(ARM, place / "arm.parquet"), frame)
    assert read_origin(place / "arm.parquet") == {"step": step}


def write_model(folder):
    KnownString(MODEL).save(folder)


def write_metadata(folder):
    text = mark_yaml_end(yaml.safe_dump(METADATA, sort_keys=False))
    write_text(folder / "dataset.yaml", text)


def write_camera(folder):
    write_text(folder / "camera.yaml", mark_yaml_end(yaml.safe_dump(CAMERA)))


def write_json(name):
    def write(folder):
        text = json.dumps(
            {"verdict": {"kind": "none"}, "values": [1.5, None]}, indent=2
        )
        write_text(folder / name, text)

    return write


def write_arm(folder):
    t = np.arange(COUNT) / 200
    frame = pd.DataFrame({"t": t, "q1": t, "q2": t, "q3": t})
    write_table(ARM, frame, folder / "arm.parquet", {"step": "execute"})


DOCUMENT_KINDS = {
    "extended.yaml": (write_model, read_extended_model),
    "dataset.yaml": (write_metadata, read_metadata),
    "camera.yaml": (write_camera, read_measured_camera),
    "run.json": (write_json("run.json"), None),
    "config.json": (write_json("config.json"), None),
    "diagnosis.json": (write_json("diagnosis.json"), None),
}


@pytest.mark.parametrize("name", DOCUMENT_KINDS)
def test_truncated_documents_give_one_clear_error(tmp_path, name):
    write, read = DOCUMENT_KINDS[name]
    write(tmp_path)
    path = tmp_path / name
    whole = path.read_bytes()
    read_whole = read or (lambda folder: read_json(folder / name))
    assert read_whole(tmp_path)
    for length in range(len(whole.rstrip())):
        path.write_bytes(whole[:length])
        with pytest.raises((DataError, UserError)) as refused:
            read_whole(tmp_path)
        message = str(refused.value)
        assert name in message
        assert "\n" not in message
        assert "estore" in message or "orrect" in message, message


@pytest.mark.parametrize("read", [lambda path: read_table(ARM, path), read_origin])
def test_truncated_tables_give_one_clear_error(tmp_path, read):
    write_arm(tmp_path)
    path = tmp_path / "arm.parquet"
    whole = path.read_bytes()
    for length in {*range(0, len(whole), 37), *range(len(whole) - 12, len(whole))}:
        path.write_bytes(whole[:length])
        with pytest.raises(DataError, match=r"arm\.parquet: .*Restore"):
            read(path)


def test_foreign_files_need_no_end_mark(tmp_path):
    (tmp_path / "dataset.yaml").write_text("format: 1\nstring: {length: 0.3}\n")
    assert read_metadata(tmp_path)["string"] == {"length": 0.3}
    write_metadata(tmp_path)
    with (tmp_path / "dataset.yaml").open("a") as file:
        file.write("arm: {links: [0.25, 0.2, 0.135], base: [0, 0]}\n")
    assert read_metadata(tmp_path)["arm"]["base"] == [0, 0]
