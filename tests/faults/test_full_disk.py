"""A full disk, or missing write permission, at any operation of a run or sweep.

There is one clear error with file and remedy, and no incomplete file. The continued run
has the same result. A test takes 2 s; a run of one cast has 190 operations, a sweep of
two jobs 260.
"""

import pytest

from tests.faults.forked import struck_by


@pytest.mark.parametrize(
    "operation", ["run:20", pytest.param("sweep:58", marks=pytest.mark.long)]
)
def test_full_disk_is_reported_and_the_run_continues_to_the_same_result(
    tmp_path, operation
):
    """The disk of the run is full; the folder of the sweep is write-protected."""
    (struck,) = struck_by(tmp_path, operation).values()
    assert len(struck) == 1


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "places"),
    [
        (
            "run",
            (
                "config.json",
                "run.log",
                "images",
                "points.parquet",
                "dataset.yaml",
                "report.html",
                "run.json",
            ),
        ),
        (
            "sweep",
            ("ledger", "multirun.yaml", "iterations", "sweep.parquet", "report.html"),
        ),
    ],
)
def test_full_disk_test_covers_all_kinds_of_operations(tmp_path, name, places):
    (struck,) = struck_by(tmp_path, name).values()
    assert {"mkdir", "open", "write", "fsync", "rename"} <= {
        operation.split()[0] for operation in struck
    }
    assert [
        place for place in places if not any(place in operation for operation in struck)
    ] == []
