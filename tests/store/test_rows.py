"""Unusable rows are dropped and counted; CSV equals Parquet."""

import numpy as np
import pandas as pd
import pytest
import yaml

from stringcast.data import dataset
from stringcast.data.artifacts import ARM, POINTS
from stringcast.data.metadata import read_metadata
from stringcast.data.schema import DataError
from stringcast.data.store import write_table
from stringcast.data.table_files import read_rows, with_trial

T = np.arange(40) * 0.01
NOISE = np.random.default_rng(1).standard_normal((120, 2)) / 30


def arm():
    return pd.DataFrame(
        {"trial": "a", "t": T, "q1": np.sin(T), "q2": 0.1 * T, "q3": -T}
    )


def points():
    t, s = np.repeat(T, 3), np.tile([0.1, 0.2, 0.3], len(T))
    return pd.DataFrame(
        {
            "trial": "a",
            "t": t,
            "s": s,
            "x": NOISE[:, 0],
            "y": NOISE[:, 1] - s,
            "sigma": 1e-3,
            "held": False,
        }
    )


@pytest.fixture
def read_changed(tmp_path):
    """Return a function that writes a changed dataset as CSV and reads it."""

    def read(seen=None, moved=None, text=lambda text: text):
        (arm() if moved is None else moved).to_csv(tmp_path / "arm.csv", index=False)
        written = text((points() if seen is None else seen).to_csv(index=False))
        content = written if isinstance(written, bytes) else written.encode()
        (tmp_path / "points.csv").write_bytes(content)
        return dataset.read_dataset(tmp_path)

    return read


def with_value(column, value, rows=(3, 7)):
    seen = points()
    seen[column] = seen[column].astype(object)
    seen.loc[list(rows), column] = value
    return seen


@pytest.mark.parametrize(
    ("column", "value", "reason"),
    [
        ("trial", None, "no trial"),
        ("t", np.nan, "t is not a finite number"),
        ("x", np.inf, "x is not a finite number"),
        ("y", "lost", "y is not a finite number"),
        ("s", -0.05, "s is below 0"),
        ("sigma", 0.0, "sigma is not a number above 0"),
        ("sigma", np.nan, "sigma is not a number above 0"),
    ],
)
def test_unusable_rows_are_dropped_and_counted(read_changed, column, value, reason):
    read = read_changed(with_value(column, value))
    assert read.row_counts["points.csv"].dropped == {reason: 2}
    expected = points().drop(index=[3, 7]).drop(columns="trial").reset_index(drop=True)
    pd.testing.assert_frame_equal(read.trials["a"].points, expected)


def test_clean_rows_and_unknown_columns_are_kept(read_changed):
    read = read_changed()
    assert read.row_counts["points.csv"].dropped == {}
    assert read.row_counts["points.csv"].unordered == 0
    pd.testing.assert_frame_equal(
        read.trials["a"].points, points().drop(columns="trial")
    )


def test_duplicates_and_contradictions_are_distinguished(
    read_changed,
):
    again = points().iloc[[4]].assign(x=9.0)
    read = read_changed(pd.concat([points(), points().iloc[:2], again]))
    assert read.row_counts["points.csv"].dropped == {
        "a row twice": 2,
        "another value at the same trial, t, s; the first is kept": 1,
    }
    shuffled = read_changed(points().sample(frac=1, random_state=2))
    assert shuffled.row_counts["points.csv"].unordered > 20
    ordered = shuffled.trials["a"].points.sort_values(["t", "s"]).reset_index(drop=True)
    pd.testing.assert_frame_equal(ordered, points().drop(columns="trial"))
    by_place = read_changed(points().sort_values(["s", "t"]))
    assert by_place.row_counts["points.csv"].unordered == 0


def test_csv_equals_parquet(read_changed, tmp_path):
    read_changed()
    (tmp_path / "parquet").mkdir()
    for table, frame in ((ARM, arm()), (POINTS, points())):
        write_table(
            with_trial(table), frame, tmp_path / "parquet" / f"{table.name}.parquet", {}
        )
    one, other = (
        dataset.read_dataset(folder).trials["a"]
        for folder in (tmp_path, tmp_path / "parquet")
    )
    pd.testing.assert_frame_equal(one.points, other.points, check_exact=True)
    pd.testing.assert_frame_equal(one.arm, other.arm, check_exact=True)


def test_numeric_trial_names_keep_zeros_and_match_numbers(read_changed):
    read = read_changed(points().assign(trial="007"), arm().assign(trial="007"))
    assert list(read.trials) == ["007"]


def test_missing_valid_is_false(read_changed):
    seen = points().assign(valid=True)
    seen["valid"] = seen["valid"].astype(object)
    seen.loc[[1, 2], "valid"] = None
    assert (~read_changed(seen).trials["a"].points["valid"]).sum() == 2
    with pytest.raises(
        DataError,
        match=r"points\.csv: column 'valid' must be bool .*give true or false",
    ):
        read_changed(points().assign(valid="yes"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (lambda text: "", r"points\.csv: cannot be read as CSV \(No columns"),
        (
            lambda text: text.replace(",", ";"),
            r"points\.csv: it has one column, .*Separate columns by commas",
        ),
        (lambda text: text.encode("utf-16"), r"points\.csv: cannot be read as CSV"),
        (
            lambda text: text + "a,b,c,d,e,f,g,h,i,j\n",
            r"points\.csv: cannot be read as CSV",
        ),
        (
            lambda text: (
                text.replace("0.1,", "'0.1',")
                .replace("0.2,", "x,")
                .replace("0.3,", "x,")
            ),
            "column 's' must be float",
        ),
        (
            lambda text: text.replace(",y,", ",why,"),
            r"points\.csv: table 'points' has no column 'y'; it has trial",
        ),
    ],
)
def test_unreadable_files_are_named_with_a_remedy(read_changed, text, words):
    with pytest.raises(DataError, match=words):
        read_changed(text=text)


def test_spaces_and_byte_order_mark_are_ignored(read_changed):
    spaced = read_changed(
        text=lambda text: b"\xef\xbb\xbf" + text.replace(",", ", ").encode()
    )
    pd.testing.assert_frame_equal(
        spaced.trials["a"].points, points().drop(columns="trial")
    )


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (
            {"string": {"length": "300 mm"}},
            "string.length is '300 mm'; it must be a number, without a unit",
        ),
        ({"string": {"length": -1}}, "string.length is -1; it must be above 0"),
        ({"string": {"length": None}}, "string.length is None; it must be a number"),
        ({"noise": {"point_sigma": "small"}}, "noise.point_sigma is 'small'"),
        ({"camera": {"fps": 0}}, "camera.fps is 0; it must be above 0"),
        ({"camera": {"fps": 1e12}}, r"camera.fps is 1000000000000.0; .* 100000.0 or"),
        (
            {"camera": {"origin_px": [1]}},
            "camera.origin_px is .1.*it must hold 2 values",
        ),
        ({"arm": {"links": [0.3, 0.2]}}, "arm.links is .*it must hold 3 values"),
        ({"arm": [1]}, "arm is .1.; it must hold names and values"),
        (
            {"trials": {"a": "held_out"}},
            "trials.a is 'held_out'; it must hold names and values",
        ),
        ({"format": 2}, "format is 2; this version reads 1"),
        (
            {"string": {"length": 0.4, "tip_mass": 0.03}},
            ".* needs the string's own mass",
        ),
        (
            {"string": {"length": 0.4, "mass": 0.4, "tip_mass": -1}},
            "string.tip_mass is -1; it must be 0",
        ),
    ],
)
def test_faults_in_dataset_yaml_are_named(tmp_path, said, words):
    (tmp_path / "dataset.yaml").write_text(yaml.safe_dump(said))
    with pytest.raises(DataError, match=rf"dataset\.yaml: {words}"):
        read_metadata(tmp_path)


def test_unknown_keys_are_kept(tmp_path):
    said = {
        "format": 1,
        "string": {"length": 0.3, "colour": "red"},
        "trials": {1: {"note": "x"}},
        "lab": "ours",
    }
    (tmp_path / "dataset.yaml").write_text(yaml.safe_dump(said))
    assert read_metadata(tmp_path) == said | {"trials": {"1": {"note": "x"}}}


def test_error_for_a_folder_of_runs_names_the_newest(tmp_path):
    """`outputs` holds runs by date and time."""
    for run in ("2026-11-28/10-00-00-a", "2026-11-29/09-00-00-b"):
        (tmp_path / run).mkdir(parents=True)
        (tmp_path / run / "dataset.yaml").touch()
    with pytest.raises(
        DataError, match=r"lies in .*29.09-00-00-b\. Name that folder\.$"
    ):
        read_rows(ARM, tmp_path)
