"""Files found by fuzzing that caused a traceback or a warning."""

import numpy as np
import pytest

from stringcast.data.importers.files import read_recordings
from stringcast.data.importers.gather import gather_tables
from stringcast.data.importers.reader import ColumnHints
from stringcast.data.schema import DataError
from stringcast.data.store import read_origin
from tests.pipeline.test_readme_commands import ROOT

HEADING = "trial,t [s],q1,q2,q3,tip.x [m],tip.y [m]"


def import_motion(folder, *rows, heading=HEADING):
    """Return the motion in a table of these rows."""
    file = folder / "arm.csv"
    file.write_text("\n".join([heading, *rows]))
    return gather_tables(read_recordings([file]), ColumnHints()).motion


def rows_with(first_angle, trial="a"):
    return [f"{trial},{0.01 * n:.2f},{first_angle},0.2,0.3,0.5,0.6" for n in range(5)]


def test_infinite_angle_is_dropped(tmp_path):
    rows = rows_with(0.1)
    rows[2] = "a,0.02,-inf,0.2,0.3,0.5,0.6"
    angles = import_motion(tmp_path, *rows)["q1"].to_numpy()
    np.testing.assert_array_equal(angles, [0.1, 0.1, np.nan, 0.1, 0.1])


@pytest.mark.parametrize("angle", ["-inf", "nan", "0/0"])
def test_column_without_a_finite_number_is_named(tmp_path, angle):
    with pytest.raises(DataError, match="'q1' holds no number"):
        import_motion(tmp_path, *rows_with(angle))


def test_infinite_times_are_refused(tmp_path):
    rows = [row.replace(f"a,0.0{n}", "a,-inf") for n, row in enumerate(rows_with(0.1))]
    with pytest.raises(DataError, match=r"column 't \[s\]' holds neither numbers"):
        import_motion(tmp_path, *rows)


def test_values_without_a_column_are_reported(tmp_path):
    rows = [f"{row},9" for row in rows_with(0.1)]
    with pytest.raises(DataError, match="rows hold 8 values, its first line names 7"):
        import_motion(tmp_path, *rows)


def test_rows_may_end_with_a_comma(tmp_path, recwarn):
    rows = [f"{row}," for row in rows_with(0.1)]
    assert list(import_motion(tmp_path, *rows)["q1"]) == [0.1] * 5
    assert not recwarn.list


def test_booleans_are_read_as_numbers(tmp_path):
    assert import_motion(tmp_path, *rows_with("true"))["q1"].tolist() == [1.0] * 5


def test_rows_without_a_trial_are_counted(tmp_path):
    rows = [*rows_with(0.1), ",0.05,0.1,0.2,0.3,0.5,0.6"]
    with pytest.raises(DataError, match="1 of 6 rows name no trial in column 'trial'"):
        import_motion(tmp_path, *rows)
    assert set(import_motion(tmp_path, *rows_with(0.1))["trial"]) == {"a"}


def test_table_without_rows_gives_an_error(tmp_path):
    with pytest.raises(DataError, match="has no rows"):
        import_motion(tmp_path, heading="t [s],q1,q2,q3,tip.x [m],tip.y [m]")


def test_damaged_numbers_in_a_footer_give_an_error(tmp_path):
    """A part of pyarrow raises OSError for them."""
    whole = (ROOT / "data/sample/points.parquet").read_bytes()
    start = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    for place in range(start, start + 40):
        damaged = whole[:place] + b"\xff" * 8 + whole[place + 8 :]
        (tmp_path / "points.parquet").write_bytes(damaged)
        try:
            read_origin(tmp_path / "points.parquet")
        except DataError as error:
            assert "points.parquet" in str(error)
