"""No room left, or no right to write, at any operation of a run or sweep.

There is one clear error with file and remedy, and nothing is half done. The result is
the same once there is room. Measured: a strike takes 2 s of a core; a run of one cast
has 190 operations, a sweep of two jobs 260.
"""

import pytest

from tests.faults.forked import struck_by


@pytest.mark.parametrize(
    "operation", ["run:20", pytest.param("sweep:58", marks=pytest.mark.long)]
)
def test_a_full_disk_is_told_and_a_run_or_sweep_goes_on_to_the_same_result(
    tmp_path, operation
):
    """The disk of the run is full; in the folder of the sweep one may not write."""
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
def test_a_full_disk_fails_every_kind_of_operation_once(tmp_path, name, places):
    (struck,) = struck_by(tmp_path, name).values()
    assert {"mkdir", "open", "write", "fsync", "rename"} <= {
        operation.split()[0] for operation in struck
    }
    assert [
        place for place in places if not any(place in operation for operation in struck)
    ] == []
