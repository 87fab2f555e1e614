"""Import of files in the formats of other programs."""

import json
import pickle
import sys

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from stringcast.data.importers import deeplabcut_h5
from stringcast.data.importers.files import read_recordings
from stringcast.data.importers.gather import gather_tables
from stringcast.data.importers.reader import ColumnHints
from stringcast.data.lazy_module import LazyModule, MissingPackageError
from stringcast.data.schema import DataError

FRAMES = 5
HEADER = (
    "std_msgs/Header header\n{}\n"
    + "=" * 80
    + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    + "=" * 80
    + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
JOINT_STATE = HEADER.format(
    "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
)
POINT = (
    HEADER.format("geometry_msgs/Point point")
    + "=" * 80
    + "\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
)


def lerobot(folder, names):
    """Write a dataset of two episodes in LeRobot's layout, version 2.1."""
    features = {"observation.state": {"dtype": "float32", "shape": [3], "names": names}}
    features |= {"action": {"dtype": "float32", "shape": [3], "names": names}}
    features |= {
        "observation.image": {
            "dtype": "video",
            "shape": [480, 640, 3],
            "names": ["height", "width", "channel"],
        }
    }
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(
        json.dumps({"codebase_version": "v2.1", "fps": 30, "features": features})
    )
    for episode in range(2):
        state = [[0.1 * n, 10.0 * n, -0.5] for n in range(FRAMES)]
        table = {
            "observation.state": pa.array(state, pa.list_(pa.float32(), 3)),
            "action": pa.array(state),
        }
        table |= {
            "timestamp": np.arange(FRAMES) / 30,
            "episode_index": [episode] * FRAMES,
        }
        path = folder / "data" / "chunk-000" / f"episode_{episode:06d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(table), path)
    return folder


def test_lerobot_episodes_and_states_are_read(tmp_path):
    folder = lerobot(
        tmp_path / "set",
        {"motors": ["shoulder_pan.pos", "shoulder_lift.pos", "elbow_flex.pos"]},
    )
    track = pd.DataFrame(
        {
            "episode": np.repeat([0, 1], FRAMES),
            "t": [*np.arange(FRAMES) / 30] * 2,
            "tip_x": 0.1,
            "tip_y": 0.2,
        }
    )
    track.to_csv(tmp_path / "tracker.csv", index=False)
    files = read_recordings([folder, tmp_path / "tracker.csv"])
    names = {"q1": "shoulder_pan", "q2": "-shoulder_lift+90", "q3": "elbow_flex"}
    # LeRobot's default unit is per cent of the calibrated range, -100 to 100
    for hints in (ColumnHints(columns=[*names.items()]), ColumnHints()):
        with pytest.raises(DataError, match=r"set: .*use_degrees.*Give --deg"):
            gather_tables(files, hints)
    tables = gather_tables(files, ColumnHints(columns=[*names.items()], degrees=True))
    assert sorted(tables.motion["trial"].unique()) == ["t0", "t1"]
    one = tables.motion[tables.motion["trial"] == "t1"]
    np.testing.assert_allclose(one["q2"], np.radians(90 - 10.0 * np.arange(FRAMES)))
    np.testing.assert_allclose(one["t"], np.arange(FRAMES) / 30)
    unnamed = gather_tables(files, ColumnHints(degrees=True))
    np.testing.assert_allclose(unnamed.motion["q3"], np.radians(-0.5))


def test_ros_messages_are_read_by_topic(tmp_path):
    writer = pytest.importorskip(
        "mcap_ros2.writer", reason="needs: pip install mcap mcap-ros2-support"
    ).Writer
    with (tmp_path / "bag.mcap").open("wb") as file:
        made = writer(file)
        state = made.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        point = made.register_msgdef("geometry_msgs/msg/PointStamped", POINT)
        for n in range(FRAMES):
            header = {
                "stamp": {"sec": 1_700_000_000, "nanosec": n * 10_000_000},
                "frame_id": "",
            }
            # as UR's driver: not in the order of the arm, and changing
            named = [("elbow_joint", 0.3), ("wrist_1_joint", 0.4)]
            named.append(("shoulder_lift_joint", 0.1 * n))
            named = named[n % 2 :] + named[: n % 2]
            names, positions = zip(*named, strict=True)
            angles = {
                "name": names,
                "position": positions,
                "velocity": [],
                "effort": [],
            }
            made.write_message("/joint_states", state, {"header": header, **angles})
            made.write_message(
                "/string/tip",
                point,
                {"header": header, "point": {"x": 0.1 * n, "y": 9.0, "z": 0.5}},
            )
        made.finish()
    tables = gather_tables(
        read_recordings([tmp_path / "bag.mcap"]), ColumnHints(plane="x,z")
    )
    np.testing.assert_allclose(tables.motion["q1"], 0.1 * np.arange(FRAMES))
    np.testing.assert_allclose(tables.motion["q2"], 0.3)
    np.testing.assert_allclose(tables.motion["q3"], 0.4)
    np.testing.assert_allclose(
        tables.points[["x", "y"]], [[0.1 * n, 0.5] for n in range(FRAMES)]
    )
    np.testing.assert_allclose(
        tables.points["t"] - 1.7e9, 0.01 * np.arange(FRAMES), atol=1e-6
    )
    whole = (tmp_path / "bag.mcap").read_bytes()
    for size in (0, 3, len(whole) // 2):
        (tmp_path / "cut.mcap").write_bytes(whole[:size])
        with pytest.raises(
            DataError, match=r"cut.mcap: cannot be read as MCAP .*mcap recover"
        ):
            read_recordings([tmp_path / "cut.mcap"])


def test_json_messages_are_read_by_topic(tmp_path):
    writer = pytest.importorskip(
        "mcap.writer", reason="needs: pip install mcap mcap-ros2-support"
    ).Writer
    with (tmp_path / "foxglove.mcap").open("wb") as file:
        made = writer(file)
        made.start()
        schema = made.register_schema("tcp", "jsonschema", b"{}")
        for topic in ("/tcp", "/tip"):
            channel = made.register_channel(topic, "json", schema)
            for n in range(FRAMES):
                turned = (
                    {"orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
                    if topic == "/tcp"
                    else {}
                )
                pose = {"position": {"x": n, "y": 1, "z": 2}, **turned}
                made.add_message(
                    channel, n * 10**7, json.dumps({"pose": pose}).encode(), n * 10**7
                )
        made.finish()
    tables = gather_tables(
        read_recordings([tmp_path / "foxglove.mcap"]), ColumnHints(plane="x,z")
    )
    np.testing.assert_allclose(
        tables.motion[["x", "y", "theta"]], [[n, 2, 0] for n in range(FRAMES)]
    )
    np.testing.assert_allclose(tables.points["t"], 0.01 * np.arange(FRAMES))


def test_deeplabcut_hdf5_is_read_like_its_csv(tmp_path):
    for package in ("h5py", "tables"):
        pytest.importorskip(
            package, reason="needs: pip install h5py, and tables to write"
        )
    levels = [
        ("net", part, axis)
        for part in ("mid", "tip")
        for axis in ("x", "y", "likelihood")
    ]
    columns = pd.MultiIndex.from_tuples(levels, names=["scorer", "bodyparts", "coords"])
    frame = pd.DataFrame(np.arange(6.0 * FRAMES).reshape(FRAMES, 6), columns=columns)
    frame.to_hdf(tmp_path / "dlc.h5", key="df_with_missing", format="table", mode="w")
    frame.to_csv(tmp_path / "dlc.csv")
    one, other = (
        read_recordings([tmp_path / name])[0].table for name in ("dlc.h5", "dlc.csv")
    )
    pd.testing.assert_frame_equal(one[list(other)], other, check_dtype=False)


class Canary:
    """An object whose unpickling calls print."""

    def __reduce__(self):
        return print, ("called",)


@pytest.mark.parametrize(
    "names", [Canary(), [("net", Canary(), "x")], [("net", "tip")], {"a": 1}]
)
def test_reading_hdf5_names_runs_no_code(names, capsys):
    with pytest.raises((pickle.UnpicklingError, ValueError)):
        deeplabcut_h5._unpickle_names(pickle.dumps(names))
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("name", "reader", "module"),
    [
        ("bag.mcap", "mcap.mcap_decoder", "mcap_ros2.decoder"),
        ("dlc.h5", "deeplabcut_h5.h5py", "h5py"),
    ],
)
def test_missing_packages_are_named(tmp_path, name, reader, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr(f"stringcast.data.importers.{reader}", LazyModule(module))
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(
        MissingPackageError, match=r"pip install (mcap mcap-ros2-support|h5py)"
    ):
        read_recordings([tmp_path / name])
