"""File faults that users in the field reported are named or corrected.

Each test also reads a file of the same kind without the fault.
"""

import numpy as np
import pandas as pd
import pytest

from stringcast.data.importers.files import read_recordings
from stringcast.data.importers.gather import gather_tables
from stringcast.data.importers.mcap import _message_row
from stringcast.data.importers.reader import ColumnHints
from stringcast.data.schema import DataError

COUNT = 40
T = np.arange(COUNT) / 200
TURN = np.linspace(0.0, 1.0, COUNT)


def write(folder, name, **columns):
    path = folder / name
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def read(*files, **hints):
    return gather_tables(read_recordings(files), ColumnHints(**hints))


@pytest.fixture
def arm(tmp_path):
    return write(tmp_path, "arm.csv", t=T, q1=TURN, q2=-TURN, q3=0.5 * TURN)


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (
            (T + 1.7e9).astype(np.float32),
            r"all 40 rows have the same \(stored as float",
        ),
        (np.floor(T / 0.1) * 0.1, "40 rows have 2 different ones, 0.1 apart"),
        (np.round(T, 2), "40 rows have 21 different ones, 0.01 apart"),
    ],
    ids=["float32", "coarse", "hundredths"],
)
def test_too_coarse_time_stamps_ask_for_the_frame_rate(arm, tmp_path, stamps, words):
    tip = write(tmp_path, "tip.csv", time=stamps, tip_x=TURN, tip_y=-TURN)
    with pytest.raises(DataError, match=rf"tip\.csv: .*{words}.* --fps 200"):
        read(arm, tip)
    counted = read(arm, tip, fps=200.0).points
    np.testing.assert_allclose(counted["t"], T, atol=1e-9)


def test_points_of_a_frame_and_trials_may_share_stamps(arm, tmp_path):
    """Three points of a frame have its stamp; both trials begin at 0."""
    columns = {"trial": np.repeat(["1", "2"], COUNT), "q1": 0.1, "q2": 0.2, "q3": 0.3}
    arms = write(tmp_path, "arms.csv", t=np.tile(T, 2), **columns)
    long = write(
        tmp_path,
        "string.csv",
        trial=np.repeat(["1", "2"], COUNT * 3),
        t=np.tile(np.repeat(T, 3), 2),
        s=np.tile([0.1, 0.2, 0.3], 2 * COUNT),
        x=0.1,
        y=0.2,
    )
    points = read(arms, long).points
    np.testing.assert_allclose(points["t"].unique(), T)


def test_frame_numbers_account_for_missing_frames(arm, tmp_path):
    """SLEAP writes no row for a frame without detections."""
    seen = np.delete(np.arange(COUNT), [3, 4, 5, 20])
    columns = {"tip.x": TURN[seen], "tip.y": 0.0, "tip.score": 0.9}
    sleap = write(tmp_path, "sleap.csv", track="", frame_idx=seen, **columns)
    points = read(arm, sleap, fps=200.0).points
    np.testing.assert_allclose(points["t"], seen / 200)

    other = write(tmp_path, "other.csv", picture=seen, **columns)
    with pytest.raises(DataError, match=r"'picture' increases .*--map 'frame=picture'"):
        read(arm, other, fps=200.0)
    points = read(arm, other, fps=200.0, columns=[("frame", "picture")]).points
    np.testing.assert_allclose(points["t"], seen / 200)


def test_column_that_counts_all_rows_needs_no_mapping(arm, tmp_path):
    tip = write(tmp_path, "tip.csv", row=np.arange(COUNT), tip_x=TURN, tip_y=0.0)
    np.testing.assert_allclose(read(arm, tip, fps=200.0).points["t"], T)


def test_joints_named_by_body_part_are_put_in_order(tmp_path):
    tip = write(tmp_path, "tip.csv", t=T, tip_x=TURN, tip_y=0.0)
    columns = {"elbow_joint": 0.3, "wrist_1_joint": 0.4, "shoulder_lift_joint": 0.2}
    motion = read(write(tmp_path, "ur.csv", t=T, **columns), tip).motion
    assert list(motion[["q1", "q2", "q3"]].iloc[0]) == [0.2, 0.3, 0.4]

    columns = {"left_joint1": 0.1, "right_joint1": 0.2, "left_joint2": 0.3}
    with pytest.raises(DataError, match=r"both seem to be joint 1.*--map"):
        read(write(tmp_path, "two.csv", t=T, **columns), tip)


@pytest.mark.parametrize("turned", [False, True])
def test_joints_of_a_message_are_matched_by_name(turned):
    """The order of names may change within a bag."""
    names, position = ["elbow_joint", "shoulder_lift_joint"], [0.3, 0.2]
    if turned:
        names, position = names[::-1], position[::-1]
    row = _message_row("/joint_states", {"name": names, "position": position}, 0)
    assert row["joint elbow_joint [rad]"] == 0.3
    assert row["joint shoulder_lift_joint [rad]"] == 0.2


def test_trial_names_stay_text(tmp_path):
    """NA is a valid name; 1 and 01 are different trials."""
    names = np.repeat(["NA", "1", "01"], COUNT)
    clock = np.tile(T, 3)
    arms = write(tmp_path, "arm.csv", trial=names, t=clock, q1=0.1, q2=0.2, q3=0.3)
    tips = write(tmp_path, "tip.csv", trial=names, t=clock, tip_x=0.1, tip_y=0.2)
    tables = read(arms, tips)
    assert set(tables.motion["trial"]) == {"NA", "t1", "t01"}
    assert set(tables.points["trial"]) == {"NA", "t1", "t01"}


def test_trial_number_1_and_1_0_are_the_same_trial(tmp_path):
    arms = write(tmp_path, "arm.csv", trial=[1.0] * COUNT, t=T, q1=0.1, q2=0.2, q3=0.3)
    tips = write(tmp_path, "tip.csv", trial=[1] * COUNT, t=T, tip_x=0.1, tip_y=0.2)
    tables = read(arms, tips)
    assert set(tables.motion["trial"]) == set(tables.points["trial"]) == {"t1"}


def test_zero_rows_are_counted_and_skipped_on_request(tmp_path):
    tip = write(tmp_path, "tip.csv", t=T, tip_x=TURN, tip_y=0.0)
    angles = {"q1": 1 + TURN, "q2": -1 - TURN, "q3": TURN}
    clean = read(write(tmp_path, "arm.csv", t=T, **angles), tip)
    assert (clean.zero_rows, len(clean.motion)) == ({}, COUNT)
    for values in angles.values():
        values[5::10] = 0.0
    arm = write(tmp_path, "arm.csv", t=T, **angles)
    assert read(arm, tip).zero_rows == {arm: COUNT // 10}
    skipped = read(arm, tip, skip_zeros=True)
    assert len(skipped.motion) == COUNT - COUNT // 10


def test_empty_files_are_named(arm, tmp_path):
    (tmp_path / "tip.csv").write_text("")
    with pytest.raises(DataError, match=r"tip\.csv: it is empty. Export it again"):
        read(arm, tmp_path / "tip.csv")


MOTIVE = "Format Version,1.23,Rotation Type,Quaternion,Length Units,Meters\n\n"


def motive(folder, bodies, markers):
    """Write Motive's CSV from positions (COUNT, 3) of bodies and markers by name."""
    kinds, names, quantities, axes = ["", ""], ["", ""], ["", ""], ["Frame", "Time"]
    columns = [np.arange(COUNT), T]
    for name, places in bodies.items():
        kinds += ["Rigid Body"] * 7
        names += [name] * 7
        quantities += ["Rotation"] * 4 + ["Position"] * 3
        axes += ["X", "Y", "Z", "W", "X", "Y", "Z"]
        columns += [np.zeros(COUNT)] * 3 + [np.ones(COUNT), *places.T]
    for name, places in markers.items():
        kinds += ["Marker"] * 3
        names += [name] * 3
        quantities += ["Position"] * 3
        axes += ["X", "Y", "Z"]
        columns += [*places.T]
    lines = [",".join(words) for words in (kinds, names, quantities, axes)]
    for row in zip(*columns, strict=True):
        lines.append(",".join("" if np.isnan(cell) else str(cell) for cell in row))
    path = folder / "take.csv"
    path.write_text(MOTIVE + "\n".join(lines) + "\n")
    return path


def moving_places(x):
    """Return positions (COUNT, 3) that move to the right from x."""
    return np.stack([x + TURN, np.zeros(COUNT), np.zeros(COUNT)], axis=1)


def cut(places, rows):
    """Split a track: NaN inside some rows, and NaN outside them."""
    inside = np.zeros(COUNT, dtype=bool)
    inside[rows] = True
    outer = np.where(inside[:, None], np.nan, places)
    return outer, np.where(inside[:, None], places, np.nan)


def test_marker_that_reappears_unlabelled_is_recognised(tmp_path):
    tip, back = cut(moving_places(0.0), slice(20, 30))
    take = motive(
        tmp_path,
        {"flange": moving_places(1.0)},
        {"mid": moving_places(0.5), "tip": tip, "Unlabeled 7": back},
    )
    tables = read(take, plane="x,y")
    points = tables.points.pivot(index="t", columns="point", values="x")
    assert list(points) == ["mid", "tip"]
    np.testing.assert_allclose(points["tip"], moving_places(0.0)[:, 0])
    assert "is taken for tip" in tables.notes[0]


def test_reflections_are_not_taken_for_points(tmp_path):
    _, glint = cut(moving_places(3.0), slice(10, 14))
    markers = {
        "mid": moving_places(0.5),
        "tip": moving_places(0.0),
        "Unlabeled 8": glint,
    }
    tables = read(
        motive(tmp_path, {"flange": moving_places(1.0)}, markers), plane="x,y"
    )
    assert set(tables.points["point"]) == {"mid", "tip"}
    assert "a reflection?" in tables.notes[0]
    clean = {"mid": moving_places(0.5), "tip": moving_places(0.0)}
    tables = read(motive(tmp_path, {"flange": moving_places(1.0)}, clean), plane="x,y")
    assert tables.notes == []


def test_several_bodies_require_the_hand_option(tmp_path):
    bodies = {"flange": moving_places(1.0), "table": moving_places(9.0)}
    take = motive(tmp_path, bodies, {"tip": moving_places(0.0)})
    with pytest.raises(DataError, match=r"flange, table.*--hand 'flange'"):
        read(take, plane="x,y")
    motion = read(take, plane="x,y", hand="flange").motion
    np.testing.assert_allclose(motion["x"], moving_places(1.0)[:, 0])
    with pytest.raises(DataError, match=r"--hand gripper: .*has the bodies"):
        read(take, plane="x,y", hand="gripper")


def test_equal_marker_names_are_distinguished_by_set_or_refused(tmp_path):
    body = {"flange": moving_places(1.0)}
    markers = {"left:tip": moving_places(0.0), "right:tip": moving_places(0.5)}
    points = read(motive(tmp_path, body, markers), plane="x,y").points
    assert set(points["point"]) == {"left tip", "right tip"}
    path = motive(tmp_path, body, markers)
    path.write_text(path.read_text().replace("right:tip", "left:tip"))
    with pytest.raises(DataError, match=r"the same name.*in Motive"):
        read(path, plane="x,y")


@pytest.mark.parametrize(
    ("order", "is_restart"),
    [
        (np.r_[0:20, 0:20], True),
        (np.r_[20:40, 0:20], False),  # blocks in another order
        (np.r_[0:20, 21, 20, 22:40], False),  # a late packet
        (np.r_[39:-1:-1], False),
    ],
    ids=["restart", "blocks", "packet", "reverse"],
)
def test_restarted_clock_is_refused_and_unordered_rows_accepted(
    arm, tmp_path, order, is_restart
):
    tip = write(tmp_path, "tip.csv", time_s=T[order], tip_x=TURN, tip_y=-TURN)
    if is_restart:
        with pytest.raises(DataError, match=r"goes back from 0\.095 to 0 in row 21"):
            read(arm, tip)
    else:
        assert len(read(arm, tip).points) == COUNT


def test_positions_in_metres_are_preferred_to_pixels(arm, tmp_path):
    places = {"x": TURN, "y": -TURN, "u": 300 + TURN, "v": 200 + TURN}
    for order in (["x", "y", "u", "v"], ["u", "v", "x", "y"]):
        columns = {name: places[name] for name in order}
        tip = write(tmp_path, "tip.csv", t=T, **columns)
        np.testing.assert_array_equal(read(arm, tip).points["y"], -TURN)
    pixels = write(tmp_path, "pixels.csv", t=T, u=places["u"], v=places["v"])
    with pytest.raises(DataError, match="positions are in pixels"):
        read(arm, pixels)


@pytest.mark.parametrize(
    ("first", "second", "trials"),
    [
        ("drive_black", "release_black", {"drive", "release"}),
        ("runA_x", "runB_x", {"A", "B"}),
        ("take07", "take17", {"t07", "t17"}),
        ("film_1DLC_resnet", "film_2DLC_resnet", {"t1", "t2"}),
    ],
)
def test_trial_names_are_cut_at_whole_words(tmp_path, first, second, trials):
    files = []
    for name in (first, second):
        angles = {"q1": TURN, "q2": TURN, "q3": TURN}
        files.append(write(tmp_path, f"{name}_arm.csv", t=T, **angles))
        files.append(write(tmp_path, f"{name}_tip.csv", t=T, tip_x=TURN, tip_y=TURN))
    assert set(read(*files).points["trial"]) == trials


def test_implausible_time_units_are_refused(arm, tmp_path):
    wrong = write(tmp_path, "wrong.csv", time_s=1e3 * T, tip_x=TURN, tip_y=-TURN)
    with pytest.raises(DataError, match=r"rows are 5 s apart.* call the column t_ms"):
        read(arm, wrong)
    right = write(tmp_path, "right.csv", time_ms=1e3 * T, tip_x=TURN, tip_y=-TURN)
    np.testing.assert_allclose(read(arm, right).points["t"], T)


def test_encoder_counts_in_one_joint_alone_are_refused(arm, tmp_path):
    tip = write(tmp_path, "tip.csv", t=T, tip_x=TURN, tip_y=-TURN)
    angles = {"j1_deg": 40 * TURN, "j2_deg": -60 * TURN}
    mixed = write(tmp_path, "mixed.csv", t=T, **angles, j3_deg=2048 + 500 * TURN)
    with pytest.raises(DataError, match=r"'j3_deg' reaches 24\d\d degrees"):
        read(mixed, tip)
    counts = {f"j{n}_deg": 2048 + 500 * TURN for n in (1, 2, 3)}
    read(write(tmp_path, "counts.csv", t=T, **counts), tip)


def test_rows_of_a_named_point_are_read_as_its_own_series(arm, tmp_path):
    """A table with one row per point names it in a column, and shares times."""
    x = np.stack([TURN, 2 * TURN], axis=1).ravel()
    columns = {"time": np.repeat(T, 2), "x": x, "y": -x}
    names = np.tile(["mid", "tip"], COUNT)
    long = write(tmp_path, "long.csv", marker=names, **columns)
    points = read(arm, long).points
    for name, factor in (("mid", 1.0), ("tip", 2.0)):
        rows = points[points["point"] == name]
        np.testing.assert_allclose(rows["t"], T)
        np.testing.assert_allclose(rows["x"], factor * TURN)

    other = write(tmp_path, "other.csv", Punkt=names, **columns)
    for fps in (None, 200.0):
        with pytest.raises(DataError, match=r"2 rows share .*--map 'point=Punkt'"):
            read(arm, other, fps=fps)
    mapped = read(arm, other, columns=[("point", "Punkt")]).points
    pd.testing.assert_frame_equal(mapped, points)


def test_rows_of_a_frame_are_counted_once_at_a_frame_rate(arm, tmp_path):
    """Without times, each series of a trial and point has its own count."""
    trials = np.repeat(["1", "2"], COUNT)
    columns = {"trial": np.repeat(trials, 2), "marker": np.tile([1, 2], 2 * COUNT)}
    long = write(tmp_path, "long.csv", x=0.1, y=0.2, **columns)
    arms = write(tmp_path, "arms.csv", t=[*T, *T], trial=trials, q1=0.1, q2=0.2)
    points = read(arms, long, fps=200.0).points
    assert {*points["point"]} == {"1", "2"}
    for _, rows in points.groupby(["trial", "point"]):
        np.testing.assert_allclose(rows["t"], T)


def test_a_unit_of_time_or_datetime_names_the_times(tmp_path):
    motion = {"q1": TURN, "q2": -TURN, "q3": 0.0}
    arm = write(tmp_path, "arm.csv", ms=(1e3 * T).round().astype(int), **motion)
    stamps = pd.Timestamp("2026-01-31T12:00:00") + pd.to_timedelta(T, unit="s")
    tip = write(tmp_path, "tip.csv", datetime=stamps, tip_x=TURN, tip_y=0.0)
    tables = read(arm, tip)
    np.testing.assert_allclose(tables.motion["t"], T)
    np.testing.assert_allclose(np.diff(tables.points["t"]), 1 / 200, atol=1e-6)


def test_two_coordinates_are_in_the_plane_of_three_of_another_body(tmp_path):
    """A plane is stated for the tracker; x and y of the hand are mapped, or alone."""
    tip = {"tip_x": TURN, "tip_y": 0.5, "tip_z": -TURN}
    track = write(tmp_path, "track.csv", t=T, **tip)
    hand = {"tcp_x": TURN, "tcp_z": 2 * TURN, "tcp_pitch": 0.1}
    names = [("x", "tcp_x"), ("y", "tcp_z"), ("theta", "tcp_pitch")]
    mapped = write(tmp_path, "hand.csv", t=T, **hand)
    flat = write(tmp_path, "flat.csv", t=T, x=TURN, y=2 * TURN, theta=0.1)
    for arm, columns in ((mapped, names), (flat, [])):
        tables = read(arm, track, plane="x,z", columns=columns)
        np.testing.assert_allclose(tables.motion["y"], 2 * TURN)
        np.testing.assert_allclose(tables.points["y"], -TURN)

    camera = write(tmp_path, "camera.csv", t=T, tip_x=TURN, tip_y=TURN)
    hand = write(tmp_path, "pose.csv", t=T, tcp_x=0.1, tcp_y=0.2, tcp_z=0.3, tcp_yaw=0)
    tables = read(hand, camera, plane="x,z", y_is_down=True)
    np.testing.assert_allclose(tables.motion["y"], 0.3)
    np.testing.assert_allclose(tables.points["y"], -TURN)


@pytest.mark.parametrize(
    ("whole", "fraction", "parts"),
    [
        ("header.stamp.secs", "header.stamp.nsecs", 1e9),
        ("sec", "nanosec", 1e9),
        ("time_s", "time_us", 1e6),
    ],
)
def test_seconds_and_fractions_in_two_columns_are_joined(
    tmp_path, whole, fraction, parts
):
    second, rest = np.divmod(T + 1.7e9 + 0.9, 1.0)
    stamps = {whole: second.astype(int), fraction: np.round(rest * parts).astype(int)}
    arm = write(tmp_path, "arm.csv", **stamps, q1=TURN, q2=TURN, q3=TURN)
    tip = write(tmp_path, "tip.csv", time=T, tip_x=TURN, tip_y=TURN)
    times = read(arm, tip).motion["t"]
    np.testing.assert_allclose(times - 1.7e9 - 0.9, T, atol=2e-6)


def test_columns_of_whole_and_precise_times_stay_apart(tmp_path):
    """Times in two units are no parts of one stamp."""
    columns = {"time_s": T, "time_ns": (1e9 * T).astype(int)}
    arm = write(tmp_path, "arm.csv", **columns, q1=TURN, q2=TURN, q3=TURN)
    tip = write(tmp_path, "tip.csv", time=T, tip_x=TURN, tip_y=TURN)
    np.testing.assert_allclose(read(arm, tip).motion["t"], T, atol=1e-9)


@pytest.mark.parametrize("mark", [".", ","])
def test_times_of_day_are_read_beyond_midnight(arm, tmp_path, mark):
    start = pd.Timestamp("2026-01-01T23:59:59.95")
    texts = []
    for t in T:
        moment = start + pd.Timedelta(seconds=t)
        texts.append(moment.strftime("%H:%M:%S.%f").replace(".", mark))
    tip = write(tmp_path, "tip.csv", Zeit=texts, tip_x=0.1, tip_y=T)
    times = read(arm, tip).points["t"]
    np.testing.assert_allclose(times - 86399.95, T, atol=1e-6)


def test_properties_above_the_names_of_columns_are_skipped(arm, tmp_path):
    """As in exports of Qualisys: name and value in each line."""
    path = tmp_path / "tip.tsv"
    properties = ["NO_OF_FRAMES\t40", "FREQUENCY\t200", "MARKER_NAMES\ttip"]
    heading = "Frame\tTime\ttip X\ttip Y\ttip Z"
    rows = []
    for frame, (t, x) in enumerate(zip(T, TURN, strict=True)):
        rows.append(f"{frame}\t{t:.4f}\t{x:.6f}\t0.0\t{-x:.6f}")
    path.write_text("\n".join([*properties, heading, *rows]))
    points = read(arm, path, plane="x,z").points
    np.testing.assert_allclose(points[["x", "y"]], np.c_[TURN, -TURN], atol=1e-6)


@pytest.mark.parametrize("encoding", ["utf-16", "cp1252"])
def test_text_as_windows_saves_it_is_read(tmp_path, encoding):
    columns = {f"q{n} [°]": np.degrees(TURN) for n in (1, 2, 3)}
    pd.DataFrame({"t": T, **columns}).to_csv(
        tmp_path / "arm.txt", sep="\t", index=False, encoding=encoding
    )
    tip = write(tmp_path, "tip.csv", t=T, tip_x=TURN, tip_y=TURN)
    motion = read(tmp_path / "arm.txt", tip).motion
    np.testing.assert_allclose(motion["q2"], TURN, atol=1e-6)


def test_quoted_numbers_may_have_decimal_commas(arm, tmp_path):
    texts = {"t": T, "tip_x": TURN, "tip_y": -TURN}
    for name, numbers in texts.items():
        texts[name] = [f"{number:.6f}".replace(".", ",") for number in numbers]
    points = read(arm, write(tmp_path, "tip.csv", **texts)).points
    np.testing.assert_allclose(points["x"], TURN, atol=1e-6)


@pytest.mark.parametrize(
    ("trials", "is_read"), [(("1", "2"), True), (("1", "3"), True), (("3", "4"), False)]
)
def test_leading_zeros_do_not_separate_trials(tmp_path, trials, is_read):
    arms = [
        write(tmp_path, f"arm_{name}.csv", t=T, q1=TURN, q2=TURN, q3=TURN)
        for name in ("01", "02")
    ]
    names = np.repeat(trials, COUNT)
    columns = {"trial": names, "t": np.tile(T, 2), "tip_x": 0.1, "tip_y": 0.2}
    tips = write(tmp_path, "tips.csv", **columns)
    if not is_read:
        with pytest.raises(DataError, match="t01, t02, the string in t3, t4"):
            read(*arms, tips)
        return
    points = read(*arms, tips).points
    assert "t01" in {*points["trial"]}


@pytest.mark.parametrize(("mark", "separator"), [("%", ","), ("# ", " "), ("# ", ",")])
def test_heading_of_ros_or_numpy_begins_like_a_comment(tmp_path, mark, separator):
    """Other comments above it, and in tables with a plain heading, are skipped."""
    rows = "\n".join(separator.join([f"{t:.4f}", *["0.1"] * 3]) for t in T)
    names = separator.join(["time", "q1", "q2", "q3"])
    tip = write(tmp_path, "tip.csv", t=T, tip_x=TURN, tip_y=TURN)
    for text in (
        f"{mark}log\n{mark}{names}\n{rows}",
        f"{mark}a,b,c,d\n{names}\n{rows}",
    ):
        path = tmp_path / "arm.txt"
        path.write_text(text)
        motion = read(path, tip).motion
        np.testing.assert_allclose(motion["t"], T)
        assert (motion["q3"] == 0.1).all()


@pytest.mark.parametrize("name", [None, "stamp"])
def test_times_in_the_index_of_a_parquet_file_are_read(tmp_path, name):
    stamps = pd.Timestamp("2026-01-31") + pd.to_timedelta(T, unit="s")
    table = pd.DataFrame({"q1": TURN, "q2": TURN, "q3": TURN}, stamps.rename(name))
    table.to_parquet(tmp_path / "arm.parquet")
    tip = write(tmp_path, "tip.csv", time=T, tip_x=TURN, tip_y=TURN)
    times = read(tmp_path / "arm.parquet", tip).motion["t"]
    np.testing.assert_allclose(times - times[0], T, atol=1e-6)


@pytest.mark.parametrize("body", ["pose.", "hand_"])
def test_a_pose_message_is_the_motion_of_the_hand(tmp_path, body):
    columns = {f"{body}position.{axis}": (1 + n) * T for n, axis in enumerate("xyz")}
    quaternion = {"x": 0 * T, "y": 0 * T, "z": np.sin(TURN / 2), "w": np.cos(TURN / 2)}
    for axis, values in quaternion.items():
        columns[f"{body}orientation.{axis}"] = values
    hand = write(tmp_path, "hand.csv", t=T, **columns)
    tip = write(tmp_path, "tip.csv", t=T, tip_x=T, tip_y=T)
    motion = read(hand, tip, plane="x,y").motion
    np.testing.assert_allclose(motion[["x", "y"]], np.stack([T, 2 * T], axis=1))
    np.testing.assert_allclose(motion["theta"], TURN, atol=1e-12)
