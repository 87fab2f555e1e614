"""Import of robot logs and tracker tables as a dataset."""

import json
import re
from dataclasses import replace
from math import pi

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml
from conftest import ROOT

from stringcast.data import dataset
from stringcast.data.importers.columns import ColumnMeaning, column_meaning
from stringcast.data.importers.files import read_recordings
from stringcast.data.importers.gather import gather_tables
from stringcast.data.importers.reader import ColumnHints
from stringcast.data.schema import DataError
from stringcast.pipeline.commands.dataset_import import (
    convert_recordings,
    write_dataset,
)
from stringcast.pipeline.commands.import_ import column_table
from stringcast.pipeline.commands.import_corrections import option_words
from stringcast.pipeline.commands.import_options import (
    argument_parser,
    equivalent_command,
    expand_patterns,
    read_bench_hints,
    read_clock,
    read_column_hints,
)
from stringcast.pipeline.commands.imported_measurements import (
    BenchHints,
    measurements_of_tables,
)
from stringcast.pipeline.settings.composition import UserError
from stringcast.stages.check.consistency.corrections.joints import JointConvention
from stringcast.stages.check.consistency.record import arm_poses
from tests.importing.test_kinds_of_files import read, write

SAMPLE = ROOT / "data" / "sample"
BENCH = ("--links", "0.25,0.20,0.135", "--base", "0.2,0.2", "--length", "304mm")
COLUMNS = {
    "timestamp_ms": ColumnMeaning("time", "timestamp", "", "ms"),
    "ts_ms": ColumnMeaning("time", "ts", "", "ms"),
    "elapsed_s": ColumnMeaning("time", "elapsed", "", "s"),
    "Time (Seconds)": ColumnMeaning("time", "time", "", "seconds"),
    "joint1_deg": ColumnMeaning("joint", "1", "", "deg"),
    "actual_q_0": ColumnMeaning("joint", "0", "", ""),
    "Joint 2 Angle [°]": ColumnMeaning("joint", "2", "", "°"),
    "th3": ColumnMeaning("joint", "3", "", ""),
    "field.position2": ColumnMeaning("joint", "2", "", ""),
    "Gelenk 2 [°]": ColumnMeaning("joint", "2", "", "°"),
    "tip_position_2": ColumnMeaning("other"),
    "phi_2_rad": ColumnMeaning("joint", "2", "", "rad"),
    "joint1_velocity": ColumnMeaning("other"),
    "joint1_deg/s": ColumnMeaning("other"),
    "target_q_0": ColumnMeaning("other"),
    "tcp_x": ColumnMeaning("hand", "tcp", "x", ""),
    "TCP yaw [deg]": ColumnMeaning("hand", "tcp", "angle", "deg"),
    "hand_orientation_w": ColumnMeaning("hand", "hand", "qw"),
    "pose.orientation.x": ColumnMeaning("hand", "", "qx"),
    "tip_x_mm": ColumnMeaning("point", "tip", "x", "mm"),
    "tip_x_mm_s": ColumnMeaning("other"),
    "marker 7 Y [cm]": ColumnMeaning("point", "marker 7", "y", "cm"),
    "tipX": ColumnMeaning("point", "tip", "x", ""),
    "u": ColumnMeaning("point", "", "x", "px"),
    "tip_likelihood": ColumnMeaning("point", "tip", "likelihood", ""),
    "s_mm": ColumnMeaning("arc", "", "", "mm"),
    "episode_index": ColumnMeaning("trial"),
    "ms": ColumnMeaning("time", "ms", "", "ms"),
    "marker_id": ColumnMeaning("label"),
    "motor_temperature": ColumnMeaning("other"),
}


@pytest.mark.parametrize("column", COLUMNS)
def test_column_names_give_the_meaning_of_columns(column):
    assert column_meaning(column) == COLUMNS[column]


@pytest.fixture(scope="module")
def sample():
    """Return joint angles and tip positions of two trials, times from 0."""
    arm, points = (
        pd.read_parquet(SAMPLE / f"{name}.parquet") for name in ("arm", "points")
    )
    tips = points[points["s"] == points["s"].max()]
    begun = {name: arm[arm["trial"] == name]["t"].min() for name in ("t00", "t03")}
    return [
        tuple(
            table[table["trial"] == name]
            .assign(t=lambda f, t0=t0: f["t"] - t0)
            .drop(columns="trial")
            .reset_index(drop=True)
            for table in (arm, tips)
        )
        for name, t0 in begun.items()
    ]


def logs(folder, sample, clock=81.0, **how):
    """Write robot logs (ms, degrees) and tracker tables (s, mm); return their paths."""
    for number, (arm, tips) in enumerate(sample, 8):
        robot = pd.DataFrame(
            {"timestamp_ms": (arm["t"] + clock) * 1e3, "joint1_current": 0.2}
        )
        robot[[f"joint{j}_deg" for j in (1, 2, 3)]] = np.degrees(
            arm[["q1", "q2", "q3"]]
        )
        robot.to_csv(folder / f"robot_{number:02d}.csv", index=False, **how)
        track = pd.DataFrame(
            {
                "time_s": tips["t"],
                "tip_x_mm": tips["x"] * 1e3,
                "tip_y_mm": tips["y"] * 1e3,
            }
        )
        track.to_csv(folder / f"tracker_{number:02d}.csv", index=False, **how)
    return sorted(folder.glob("robot_*.csv")), sorted(folder.glob("tracker_*.csv"))


def test_robot_and_tracker_logs_become_a_dataset(
    sample, called, tmp_path, undrawn_trial
):
    """Column names give the units; the motion gives the clock offset of 81 s."""
    robots, trackers = logs(tmp_path, sample)
    result = called("import", *robots, *trackers, "--to", tmp_path / "mine", *BENCH)
    assert result.returncode == 0, result.stderr
    assert "Taken as --clock fit" in result.stdout
    assert re.search(r"95 % interval \+8[01]\.\d+ to \+8[01]\.", result.stdout)
    assert re.search(r"robot_\* \(2\) +joint2_deg +q2 \[deg\], by name", result.stdout)
    assert re.search(r"joint1_current +left out", result.stdout)
    assert "Usable: 2 trials" in result.stdout
    data = dataset.read_dataset(tmp_path / "mine")
    assert list(data.trials) == ["t08", "t09"]
    for (arm, tips), trial in zip(sample, data.trials.values(), strict=True):
        shift = trial.arm["t"].iloc[0]
        np.testing.assert_allclose(trial.arm["q2"], arm["q2"], atol=1e-9)
        np.testing.assert_allclose(
            trial.points[["x", "y"]], tips[["x", "y"]], atol=1e-9
        )
        # tolerance: one frame, as the tip reaches 20 m/s
        assert np.abs(trial.points["t"] - shift - tips["t"]).max() < 0.006
        assert set(trial.points["s"]) == {0.304}
    again = called("import", *robots, *trackers, "--to", tmp_path / "mine", *BENCH)
    assert (again.returncode, "rm -r" in again.stderr) == (2, True)


def test_import_of_the_tutorial_prints_what_its_page_shows(
    called, tmp_path, undrawn_trial
):
    page = (ROOT / "data/tutorial/README.md").read_text(encoding="utf-8")
    words = (
        re.search(r"pipeline import (.*)", page)[1]
        .replace("--to mine", f"--to {tmp_path / 'mine'}")
        .split()
    )
    files = [
        str(file) for word in words if "*" in word for file in sorted(ROOT.glob(word))
    ]
    assert len(files) == 10
    result = called("import", *files, *(word for word in words if "*" not in word))
    printed = re.search(r"```\n(file .*?)```", page, re.S)[1].splitlines()
    printed_lines = [line.rstrip() for line in result.stdout.splitlines()]
    assert [
        line
        for line in printed
        if line not in (*printed_lines, "...", "What was understood, drawn: mine.png")
    ] == []


@pytest.mark.parametrize(
    "names",
    [{"x": "tip_x", "y": "tip_y"}, {"x": "X", "y": "Y"}],
    ids=["point in headings", "point in a column"],
)
def test_other_units_and_directions_are_detected_and_reported(
    sample, called, tmp_path, undrawn_trial, names
):
    """The files are in millimetres and degrees, with y down."""
    for number, (arm, tips) in enumerate(sample):
        angles = np.degrees(arm[["q1", "q2", "q3"]]).assign(t=arm["t"])
        angles.to_csv(tmp_path / f"arm{number}.csv", index=False)
        columns = {"x": tips["x"] * 1e3, "y": -tips["y"] * 1e3}
        places = pd.DataFrame({"t": tips["t"], **columns}).rename(columns=names)
        if "X" in names.values():
            places["marker"] = "tip"
        places.to_csv(tmp_path / f"tip{number}.csv", index=False, sep=";", decimal=",")
    files = sorted(tmp_path.glob("*.csv"))
    result = called("import", *files, "--to", tmp_path / "mine", *BENCH)
    assert result.returncode == 0, result.stdout + result.stderr
    assert (
        "--unit=tip0.csv=mm" in result.stdout or "--unit tip0.csv=mm" in result.stdout
    )
    assert "--y-down" in result.stdout
    assert "which no joint does in radians" in result.stdout.replace("\n", " ")
    stored = dataset.read_dataset(tmp_path / "mine").trials["t0"]
    np.testing.assert_allclose(stored.points["y"], sample[0][1]["y"], atol=1e-9)
    np.testing.assert_allclose(stored.arm["q1"], sample[0][0]["q1"], atol=1e-9)


@pytest.mark.parametrize("together", [False, True], ids=["own file", "one file"])
def test_y_down_is_corrected_unless_hand_and_points_share_a_file(
    sample, called, tmp_path, undrawn_trial, together
):
    """In one file, the option would also flip y of the hand."""
    angles = sample[0][0][["q1", "q2", "q3"]].to_numpy()
    x, y, theta = arm_poses(angles, (0.25, 0.2, 0.135), (0.2, 0.2)).T
    hand = pd.DataFrame(
        {"t": sample[0][0]["t"], "tcp_x": x, "tcp_y": y, "tcp_yaw": theta}
    )
    tip = pd.DataFrame(
        {
            "t": sample[0][1]["t"],
            "tip_x": sample[0][1]["x"],
            "tip_y": -sample[0][1]["y"],
        }
    )
    if together:
        hand = hand.merge(tip, on="t")
    else:
        tip.to_csv(tmp_path / "tip_1.csv", index=False)
    hand.to_csv(tmp_path / "hand_1.csv", index=False)
    files = sorted(tmp_path.glob("*.csv"))
    result = called("import", *files, "--to", tmp_path / "mine", "--length", "304mm")
    if together:
        assert result.returncode == 2
        assert "y points down, not up" in result.stderr
        assert "Multiply y by -1" in result.stderr
    else:
        assert result.returncode == 0, result.stderr
        assert "Taken as --y-down" in result.stdout


def test_trials_in_different_frames_of_reference_are_refused(sample, called, tmp_path):
    robots, trackers = logs(tmp_path, sample, clock=0.0)
    # opposite shifts of two trials cannot be an error of the arm's base
    for path, shift in zip(trackers, (700, -700), strict=True):
        pd.read_csv(path).assign(tip_x_mm=lambda f, d=shift: f["tip_x_mm"] + d).to_csv(
            path, index=False
        )
    result = called("import", *robots, *trackers, "--to", tmp_path / "mine", *BENCH)
    assert result.returncode == 2
    assert "was not written" in result.stderr
    assert (result.stdout + result.stderr).count("one frame of reference") == 1
    assert not (tmp_path / "mine").exists()
    # the drawing shows the fault
    assert (tmp_path / "mine.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("changes", "file", "field", "statement", "remedy"),
    [
        ({"--base": "0.2,0.5"}, "", "arm.base", "the arm stands elsewhere", "--base="),
        ({"--links": "0.25,0.2"}, "robot_08.csv", "", "gives 2 lengths", "--links"),
        ({"--map": "q1=gear"}, "", "--map q1=gear", "no file has such", "There are"),
    ],
    ids=["correction", "file", "option"],
)
def test_json_findings_name_file_field_and_remedy(
    sample, called, tmp_path, changes, file, field, statement, remedy
):
    robots, trackers = logs(tmp_path, sample, clock=0.0)
    options = dict(zip(BENCH[::2], BENCH[1::2], strict=True)) | changes
    words = [word for pair in options.items() for word in pair]
    result = called(
        "import", *robots, *trackers, "--json", "--to", tmp_path / "m", *words
    )
    assert result.returncode == 1, result.stderr
    overview = json.loads(result.stdout)
    (finding,) = overview["findings"]
    assert not overview["usable"]
    assert finding["field"] == field
    assert file in finding["file"]
    assert statement in finding["statement"]
    assert remedy in finding["remedy"]


def test_clock_uncertainty_is_stored_in_the_dataset(sample, tmp_path):
    robots, trackers = logs(tmp_path, sample, clock=0.0)
    recordings = read_recordings([*robots, *trackers])
    for text, clock in (("0.1", None), ("0.1,0.002", {"low": -0.002, "high": 0.002})):
        words = ["a.csv", *BENCH, f"--clock={text}"]
        options = argument_parser().parse_args(words)
        tables = gather_tables(recordings, read_column_hints(options))
        imported = convert_recordings(tables, read_bench_hints(options))
        assert imported.points["t"].min() == pytest.approx(0.1)
        assert imported.metadata.get("clock") == clock
    with pytest.raises(UserError, match="neither seconds nor fit"):
        read_clock("0.1,soon")


@pytest.mark.parametrize(
    ("words", "geometry"), [([], None), (["--geometry-measured"], "measured")]
)
def test_measured_geometry_is_recorded_in_the_dataset(
    sample, tmp_path, words, geometry
):
    robots, trackers = logs(tmp_path, sample, clock=0.0)
    options = argument_parser().parse_args(["a.csv", *BENCH, *words])
    recordings = read_recordings([*robots, *trackers])
    tables = gather_tables(recordings, read_column_hints(options))
    imported = convert_recordings(tables, read_bench_hints(options))
    assert imported.metadata.get("geometry") == geometry
    assert "--geometry-measured" in equivalent_command(options) or not words


def test_json_output_holds_command_and_folder(sample, called, tmp_path, undrawn_trial):
    robots, trackers = logs(tmp_path, sample, clock=0.0)
    folder = tmp_path / "mine"
    result = called("import", *robots, *trackers, "--json", "--to", folder, *BENCH)
    overview = json.loads(result.stdout)
    assert result.returncode == 0
    assert overview["usable"]
    assert overview["folder"] == str(folder)
    assert f"--to {folder}" in overview["command"]
    assert (folder / "dataset.yaml").exists()


def test_answer_no_on_a_terminal_writes_nothing(sample, called, tmp_path, monkeypatch):
    robots, trackers = logs(tmp_path, sample)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda words: "n")
    result = called("import", *robots, *trackers, "--to", tmp_path / "mine", *BENCH)
    assert (result.returncode, "Nothing was written" in result.stderr) == (2, True)
    assert not (tmp_path / "mine").exists()


def test_patterns_are_expanded_and_brackets_in_names_kept(tmp_path):
    names = ("robot_2.csv", "robot_1.csv", "other.csv", "film[1].csv")
    for name in names:
        (tmp_path / name).touch()
    given = [tmp_path / name for name in ("film[1].csv", "robot_*.csv", "none_*.csv")]
    want = ["film[1].csv", "robot_1.csv", "robot_2.csv", "none_*.csv"]
    assert [file.name for file in expand_patterns(given)] == want


def test_dataset_holds_the_film_and_its_camera(sample, tmp_path):
    writer = cv2.VideoWriter(
        str(tmp_path / "film.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30, (64, 48)
    )
    for _ in range(3):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    robots, _ = logs(tmp_path, sample[:1])
    bench = BenchHints(length=0.3, links=(0.25, 0.2, 0.135))
    recordings = read_recordings([*robots, tmp_path / "film.mp4"])
    hints = ColumnHints(fps=200.0, px_per_m=100.0, origin_px=(32.0, 24.0))
    tables = gather_tables(recordings, hints)
    write_dataset(convert_recordings(tables, bench), tmp_path / "mine", robots, "")
    assert (tmp_path / "mine" / "videos" / "t00.mp4").read_bytes() == (
        tmp_path / "film.mp4"
    ).read_bytes()
    camera = yaml.safe_load((tmp_path / "mine" / "dataset.yaml").read_text())["camera"]
    assert (camera["width"], camera["height"], camera["fps"]) == (64, 48, 200.0)
    with pytest.raises(DataError, match=r"--fps 240 --px-per-m 340 --origin-px"):
        convert_recordings(gather_tables(recordings, ColumnHints()), bench)


T = np.arange(5) / 100
JOINTS = {f"q{j}": np.linspace(0, j, 5) for j in (1, 2, 3)}


def test_column_map_of_the_user_overrides_guessed_names(tmp_path):
    log = write(
        tmp_path,
        "log.csv",
        Zeit=T,
        A_deg=[0.0, 1, 2, 3, 4],
        B_deg=0.5,
        C_deg=0.25,
        joint7=1.0,
        X=1.0,
        Y=2.0,
    )
    tables = read(
        log,
        columns=[
            ("t", "Zeit"),
            ("q1", "-A_deg+90"),
            ("q2", "B_deg"),
            ("q3", "C"),
            ("tip.x", "X"),
            ("tip.y", "Y"),
        ],
    )
    np.testing.assert_allclose(tables.motion["q1"], np.radians(90 - np.arange(5)))
    assert tables.joints == ["q1", "q2", "q3"]
    assert set(tables.points["point"]) == {"tip"}
    with pytest.raises(DataError, match=r"no file has such a column. There are .*Zeit"):
        read(log, columns=[("t", "Zeitt")])
    with pytest.raises(DataError, match="'q' is no name of ours"):
        read(log, columns=[("q", "A_deg")])


def test_each_file_may_have_another_name_for_its_times(tmp_path):
    """Within one file, the last mapping of a name replaces earlier ones."""
    arm = write(tmp_path, "arm_1.csv", Zeit=T, **JOINTS)
    track = write(tmp_path, "track_1.csv", Uhr=T, X=1.0, Y=2.0, height=3.0)
    names = [("t", "Zeit"), ("t", "Uhr"), ("tip.x", "X"), ("tip.y", "Y")]
    tables = read(arm, track, columns=names)
    np.testing.assert_allclose(tables.motion["t"], T)
    np.testing.assert_allclose(tables.points["t"], T)
    corrected = read(arm, track, columns=[*names, ("tip.y", "height")])
    np.testing.assert_allclose(corrected.points["y"], 3.0)


def test_units_are_guessed_from_values_where_names_are_silent(tmp_path):
    """The step gives the unit of times, the range that of angles.

    Dates become seconds. Points with low likelihood become invalid.
    """
    arm = write(
        tmp_path,
        "arm.csv",
        stamp=T * 1e9 + 1.7e18,
        J1=[0.0, 90, 100, 100, 100],
        J2=[0.0, 1, 1, 1, 1],
        J3=0.0,
    )
    dates = pd.Timestamp("2026-01-31 12:00") + pd.to_timedelta(T, unit="s")
    tip = write(
        tmp_path,
        "tip.csv",
        time=dates,
        tip_x=0.1,
        tip_y=0.2,
        tip_likelihood=[1, 0.9, 0.1, 1, 1],
    )
    tables = read(arm, tip)
    assert tables.motion["t"].diff().iloc[1:].round(6).eq(0.01).all()
    assert tables.motion["q1"].max() == pytest.approx(100 * pi / 180)
    assert tables.motion["q2"].max() == pytest.approx(pi / 180)
    assert tables.points["t"].iloc[0] == pd.Timestamp("2026-01-31 12:00").timestamp()
    assert tables.points["valid"].tolist() == [True, True, False, True, True]


def test_deeplabcut_and_optitrack_are_recognised_by_their_header(tmp_path):
    (tmp_path / "dlc.csv").write_text(
        "scorer,net,net,net,net,net,net\nbodyparts,mid,mid,mid,tip,tip,tip\ncoords,x,y,likelihood,x,y,likelihood\n"
        + "".join(f"{n},100,{200 + n},0.99,110,260,0.2\n" for n in range(5))
    )
    arm = write(tmp_path, "arm.csv", t=T, **JOINTS)
    printed_lines = {"fps": 200.0, "px_per_m": 100.0, "origin_px": (50.0, 250.0)}
    points = read(arm, tmp_path / "dlc.csv", **printed_lines).points
    mid = points[points["point"] == "mid"]
    np.testing.assert_allclose(mid[["t", "x", "y"]].iloc[1], (0.005, 0.5, 0.49))
    assert not points[points["point"] == "tip"]["valid"].any()
    with pytest.raises(DataError, match="--fps 200"):
        read(arm, tmp_path / "dlc.csv")
    with pytest.raises(DataError, match="--px-per-m 340"):
        read(arm, tmp_path / "dlc.csv", fps=200.0)
    half = np.sqrt(0.5)
    (tmp_path / "take.csv").write_text(
        "Format Version,1.23,Take Name,a,Rotation Type,Quaternion,Length Units,Millimeters\n\n"
        ",,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker\n"
        ",,flange,flange,flange,flange,flange,flange,flange,set:tip,set:tip,set:tip\n"
        ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Position,Position,Position\n"
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z\n"
        + "".join(
            f"{n},{n / 100},0,0,{half},{half},100,200,3,{110 + n},50,3\n"
            for n in range(5)
        )
    )
    with pytest.raises(DataError, match="--plane x,z"):
        read(tmp_path / "take.csv")
    tables = read(tmp_path / "take.csv", plane="x,y")
    np.testing.assert_allclose(
        tables.motion[["x", "y", "theta"]].iloc[0], (0.1, 0.2, pi / 2)
    )
    np.testing.assert_allclose(tables.points[["x", "y"]].iloc[4], (0.114, 0.05))
    turned = read(tmp_path / "take.csv", plane="-y,x").motion.iloc[0]
    np.testing.assert_allclose(turned[["x", "y"]].astype(float), (-0.2, 0.1))
    # what pointed up now points left
    assert np.cos(turned["theta"] - pi) == pytest.approx(1)


def test_hanging_string_gives_arc_lengths_and_two_joints_give_poses(tmp_path):
    """Two links of 0.3 m point right; points hang 0.1, 0.2 and 0.3 m below the hand."""
    arm = write(tmp_path, "arm.csv", t=T, q1=0.0, q2=0.0)
    hung = {
        f"p{n}_{axis}": 0.6 if axis == "x" else -depth
        for n, depth in ((3, 0.3), (1, 0.1), (2, 0.2))
        for axis in "xy"
    }
    imported = convert_recordings(
        read(arm, write(tmp_path, "track.csv", t=T, **hung)),
        BenchHints(links=(0.3, 0.3)),
    )
    assert imported.hand_table.name == "grasp"
    np.testing.assert_allclose(
        imported.hand_rows[["x", "y", "theta"]].iloc[0], (0.6, 0, 0), atol=1e-12
    )
    arc_lengths = sorted(imported.points["s"].unique())
    np.testing.assert_allclose(arc_lengths, [0.1, 0.2, 0.3], atol=1e-4)
    assert imported.metadata["string"]["length"] == pytest.approx(0.3, abs=2e-4)
    assert any("give it with --length" in note for note in imported.notes)
    with pytest.raises(
        DataError,
        match=r"angles of 2 joints, .* gives 3 lengths.*--links 0.25,0.20 ",
    ):
        convert_recordings(
            read(arm, tmp_path / "track.csv"), BenchHints(links=(0.3, 0.3, 0.1))
        )


def test_equal_columns_of_two_kinds_of_files_get_separate_rows(tmp_path):
    """Hand and string both have x; several files of one kind share a row."""
    files = []
    for number in (1, 2):
        hand = {"t": T, "x": 0.1, "y": 0.2, "theta": 0.0}
        files.append(write(tmp_path, f"grasp_{number}.csv", **hand))
        points = {"t": T, "s": 0.3, "x": 0.1, "y": -0.1}
        files.append(write(tmp_path, f"points_{number}.csv", **points))
    table = column_table(read(*files))
    cells = [list(map(str, column.cells)) for column in table.columns]
    rows = [row for row in zip(*cells, strict=True) if row[1] == "y"]
    assert [row[0] for row in rows] == ["grasp_* (2)", "points_* (2)"]
    assert [row[3] for row in rows] == ["0.2 m", "-0.1 m"]


def test_rows_without_points_or_hand_direction_are_dropped(tmp_path):
    """Points that the tracker does not rate are kept."""
    t = np.arange(10) / 100
    arm = write(tmp_path, "arm.csv", t=t, tcp_x=0.1, tcp_y=0.2, tcp_yaw=0.0)
    tables = read(arm, write(tmp_path, "track.csv", t=t, tip_x=0.1, tip_y=-0.1))
    points = tables.points.assign(valid=[False, False, True, *[None] * 7])
    motion = tables.motion.assign(theta=[np.nan, *[0.0] * 9])
    known = replace(tables, points=points, motion=motion)
    (recording,) = measurements_of_tables(known, BenchHints()).recordings
    np.testing.assert_allclose(recording.t, t[1:])
    np.testing.assert_allclose(recording.tracks[0].t, t[2:])


def test_points_that_contradict_the_stated_length_are_refused(tmp_path):
    """Either the last point is not the tip, or x of one trial is mirrored."""
    arm = [
        write(tmp_path, f"arm_{number}.csv", t=T, tcp_x=0.1, tcp_y=0.2, tcp_yaw=0.0)
        for number in (1, 2)
    ]

    def track(number, x, end):
        hung = {"mid_x": x, "mid_y": 0.1, "end_x": x, "end_y": 0.2 - end}
        return write(tmp_path, f"track_{number}.csv", t=T, **hung)

    bench = BenchHints(length=0.3)
    right = convert_recordings(read(arm[0], track(1, 0.1, 0.3)), bench)
    assert sorted(right.points["s"].unique()) == pytest.approx([0.1, 0.3], abs=1e-3)
    with pytest.raises(DataError, match=r"last point is the string's end.*--at tip"):
        convert_recordings(read(arm[0], track(1, 0.1, 0.25)), bench)
    mirrored = read(*arm, track(1, 0.1, 0.3), track(2, -0.1, 0.3))
    farthest = r"trial t2: the hand rests at \(0.100, 0.200\) m, mid at \(-0.100, 0.100"
    with pytest.raises(DataError, match=farthest):
        convert_recordings(mirrored, bench)


def test_clock_fit_needs_a_trial_with_hand_and_string(tmp_path):
    """In the only trial with a hand, the string was seen in two frames."""
    files = [
        write(tmp_path, f"arm_{number}.csv", t=T, tcp_x=0.1, tcp_y=0.2, tcp_yaw=0.0)
        for number in (1, 3)
    ]
    for number, count in ((1, 2), (2, len(T))):
        columns = {"t": T[:count], "tip_x": 0.1, "tip_y": -0.1}
        files.append(write(tmp_path, f"track_{number}.csv", **columns))
    with pytest.raises(DataError, match=r"no trial has both .*--clock=-0\.35"):
        convert_recordings(read(*files), BenchHints(length=0.3, fit_clock=True))


WRONG = {
    "no columns": (
        {"a.csv": "t,foo\n0,1\n"},
        "no columns say how the hand moved.*There are a.csv: t, foo",
    ),
    "no names": (
        {"a.csv": "0.0,1.0,2.0\n0.1,1.0,2.0\n"},
        "names no columns.*time_s,joint1_deg",
    ),
    "no times": (
        {"a.csv": "q1,q2,q3\n1,2,3\n"},
        "no column holds times.*--map t=<column>.*--fps",
    ),
    "no string": (
        {"a.csv": "t,q1,q2,q3\n0,1,2,3\n"},
        "no column says where the string was",
    ),
    "no number": ({"a.csv": "t,q1,q2,q3\n0,x,y,z\n"}, "column 'q1' holds no number"),
    "strangers": (
        {
            "r_a.csv": "t,q1\n0,1\n",
            "r_b.csv": "t,q1\n0,1\n",
            "t_c.csv": "t,x,y\n0,1,1\n",
            "t_d.csv": "t,x,y\n0,1,1\n",
        },
        "in the trials a, b, the string in c, d. Give files of one trial the same ending",
    ),
    "ending": ({"a.xlsx": "x"}, "no such file is read. Export it as one of .csv"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_missing_information_is_named_with_the_option_that_gives_it(tmp_path, kind):
    files, message = WRONG[kind]
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(DataError, match=message):
        read(*sorted(tmp_path.iterdir()))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.csv", "--length", "thirty"], "'thirty' is no length"),
        (["a.csv", "--base", "1,2,3"], "are not two numbers"),
        (["a.csv", "--links", "250,200,135"], "250 would be metres. Write 250mm"),
        (["a.csv", "--origin-px", "250"], "Write such as 251.5,387.5"),
        ([], "import: it needs: files. Try: python -m pipeline import --help"),
    ],
)
def test_wrong_options_are_refused_in_one_line(words, message):
    with pytest.raises(UserError, match=message) as refused:
        argument_parser().parse_args(words)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("heading", ["q{} [°]", "joint{}_rad"])
def test_map_options_give_joints_other_signs_and_zeros(tmp_path, heading):
    """The options give the angles that the correction predicts."""
    rng = np.random.default_rng(0)
    names = [heading.format(number) for number in (1, 2, 3)]
    angles = rng.uniform(-1.0, 1.0, (len(T), 3))
    unit = 1.0 if "rad" in heading else np.pi / 180
    arm = write(
        tmp_path, "arm.csv", t=T, **dict(zip(names, angles.T / unit, strict=True))
    )
    tip = write(tmp_path, "tip.csv", t=T, tip_x=T, tip_y=T)
    options = argument_parser().parse_args([str(arm), str(tip)])
    tables = gather_tables(read_recordings([arm, tip]), read_column_hints(options))
    correction = JointConvention(
        field="", statement="", signs=(1, -1, -1), zeros=(-90, 0, 180)
    )
    options.map = option_words(correction, tables, options)[1::2]
    motion = read(arm, tip, columns=read_column_hints(options).columns).motion
    right = angles * (1, -1, -1) + np.radians((-90, 0, 180))
    np.testing.assert_allclose(motion[["q1", "q2", "q3"]], right, atol=1e-6)
