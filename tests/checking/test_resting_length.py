"""The stated length is compared with that of the string at rest."""

import json

import pandas as pd
import pytest

from stringcast.pipeline.commands.check import read_measurements
from stringcast.stages.check.rest_shape import check_resting_length
from tests.importing.mistakes import simulated_bench


@pytest.fixture(scope="module")
def bench():
    return simulated_bench()


def write_dataset(folder, bench, length, places, **metadata):
    """Write the casts as a dataset with stated arc lengths [m] of the points."""
    arm, points = [], []
    for number, (t, joints) in enumerate(bench.hands):
        trial = pd.DataFrame(joints, columns=["q1", "q2", "q3"])
        arm.append(trial.assign(trial=f"t{number}", t=t - bench.clock))
        for name, (times, xy) in bench.points[number].items():
            if name in places:
                rows = pd.DataFrame(xy, columns=["x", "y"])
                points.append(rows.assign(trial=f"t{number}", t=times, s=places[name]))
    pd.concat(arm).to_csv(folder / "arm.csv", index=False)
    pd.concat(points).to_csv(folder / "points.csv", index=False)
    metadata |= {
        "format": 1,
        "string": {"length": length},
        "arm": {"links": list(bench.links), "base": list(bench.base)},
    }
    (folder / "dataset.yaml").write_text(json.dumps(metadata))
    return read_measurements(folder, [])


@pytest.mark.parametrize("error", [-0.015, -0.01, 0.01, 0.015])
def test_a_length_wrong_by_a_centimetre_is_found_with_the_right_one(
    bench, tmp_path, error
):
    length = bench.length + error
    dataset = write_dataset(tmp_path, bench, length, {"mid": 0.16, "tip": length})
    (finding,) = check_resting_length(dataset)
    assert finding.field == "string.length"
    found = float(finding.statement.split()[-2])
    assert found == pytest.approx(bench.length, abs=0.003)


def test_a_tip_that_rests_farther_away_than_the_string_is_long_is_found(
    bench, tmp_path
):
    dataset = write_dataset(tmp_path, bench, 0.31, {"tip": 0.31})
    (finding,) = check_resting_length(dataset)
    assert finding.field == "string.length"
    found = float(finding.statement.split(" m from the grasp")[0].split()[-1])
    assert 0.3131 < found < bench.length + 0.001


@pytest.mark.parametrize(
    ("length", "places", "metadata"),
    [
        (0.32, {"mid": 0.16, "tip": 0.32}, {}),
        # the last point is not the end of the string
        (0.34, {"mid": 0.16, "tip": 0.32}, {}),
        (0.33, {"mid": 0.16, "tip": 0.33}, {"geometry": "measured"}),
        # one point does not distinguish length and stiffness
        (0.32, {"tip": 0.32}, {}),
        (0.33, {"tip": 0.33}, {}),
    ],
    ids=["right", "no end", "measured", "one point, right", "one point"],
)
def test_a_right_or_undetermined_length_is_accepted(
    bench, tmp_path, length, places, metadata
):
    dataset = write_dataset(tmp_path, bench, length, places, **metadata)
    assert [*check_resting_length(dataset)] == []
