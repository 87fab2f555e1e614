"""Lost samples are found, and measured repetitions are kept."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from stringcast.data import dataset
from stringcast.data.lost_samples import (
    find_lost_points,
    fixed_position_mask,
    held_mask,
    zero_row_mask,
)
from stringcast.stages.check.finding import Severity
from tests.checking.test_check import Dirty, findings_in

COUNT = 400
EXTENT = 0.35  # [m] of moving points
T = np.arange(COUNT) / 200
RNG = np.random.default_rng(5)


def swing(noise=5e-4, step=0.0, rest=0):
    """Return positions (COUNT, 2) [m] of a point that rests, and then swings."""
    phase = 2 * np.pi * np.maximum(T - rest / 200, 0)
    xy = np.stack([0.15 * np.cos(phase), 0.1 * np.cos(2 * phase)], axis=1)
    xy = xy + noise * RNG.standard_normal(xy.shape)
    return np.round(xy / step) * step if step else xy


def held(xy, rows):
    xy = xy.copy()
    for row in rows:
        xy[row] = xy[row - 1]
    return xy


ALONE = np.arange(5, COUNT, 5)
TOGETHER = np.arange(150, 190)


@pytest.mark.parametrize("rows", [ALONE, TOGETHER], ids=["alone", "together"])
@pytest.mark.parametrize("step", [0.0, 1e-4])
def test_a_repeated_point_is_found(rows, step):
    mask = held_mask(held(swing(step=step), rows), EXTENT)
    assert mask[rows].mean() > 0.9
    assert mask.sum() <= len(rows) + 2


def test_a_point_that_is_repeated_to_the_end_is_found():
    rows = np.arange(300, COUNT)
    assert held_mask(held(swing(), rows), EXTENT)[rows].all()


def test_a_grasp_that_stops_within_three_samples_is_not_lost():
    """The grasp is computed from joints without noise: at rest it repeats exactly."""
    steps = np.array([15.0] * 40 + [9.0, 3.4, 0.27] + [0.0] * 40)
    x = 1e-3 * np.cumsum(steps)
    track = {"trial": "t1", "t": np.arange(len(x)) / 100, "x": x, "y": 0.3 * x}
    _, grasp = find_lost_points(pd.DataFrame(track | {"s": 0.0}))
    _, point = find_lost_points(pd.DataFrame(track | {"s": 0.1}))
    assert not grasp
    assert point


@pytest.mark.parametrize("step", [0.0, 1e-4, 1e-3, 8e-3])
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3, 4e-3])
@pytest.mark.parametrize("rest", [0, 300])
def test_quantised_or_resting_points_are_not_lost(step, noise, rest):
    """At most one in a hundred measured points is taken for a repeated one."""
    assert held_mask(swing(noise, step, rest), EXTENT).mean() < 0.01


def test_a_quantised_point_at_rest_with_outliers_is_not_lost():
    xy = swing(0.0, 8e-3, rest=COUNT)
    xy[RNG.choice(COUNT, 20, replace=False)] += 0.2
    assert held_mask(xy, EXTENT).mean() < 0.01


@pytest.mark.parametrize("place", [(0.0, 0.0), (-1.0, -1.0)])
@pytest.mark.parametrize("share", [0.01, 0.2, 0.7])
def test_a_fixed_position_is_found(place, share):
    xy = swing() + 0.5
    rows = RNG.random(COUNT) < share
    xy[rows] = place
    mask, named = fixed_position_mask(xy)
    assert (mask == rows).all()
    assert named == f"({place[0]:g}, {place[1]:g})"


@pytest.mark.parametrize("step", [0.0, 1e-3])
def test_one_run_at_an_impossible_position_is_found(step):
    xy = swing(step=step, rest=200)
    rows = np.arange(300, 303)
    xy[rows] = -9.999
    mask, named = fixed_position_mask(xy)
    assert list(np.flatnonzero(mask)) == list(rows)
    assert named == "(-9.999, -9.999)"


@pytest.mark.parametrize("step", [0.0, 1e-3, 8e-3])
def test_a_point_that_passes_or_rests_at_the_origin_is_not_lost(step):
    xy = swing(step=step)
    assert not fixed_position_mask(xy)[0].any()
    assert not fixed_position_mask(np.zeros_like(xy))[0].any()


def angles():
    """Return angles (COUNT, 3) [rad] of a hand that rests, and then moves."""
    phase = np.maximum(T - 0.5, 0)
    return np.stack([1.5 * phase, -phase, 0.7 * phase], axis=1)


@pytest.mark.parametrize("rows", [slice(0, None, 4), slice(10, 300, 97)])
def test_rows_of_zeros_are_found(rows):
    is_zero = np.zeros(COUNT, dtype=bool)
    is_zero[rows] = True
    values = 0.4 + angles()
    values[is_zero] = 0.0
    assert (zero_row_mask(values) == is_zero).all()


def test_a_hand_at_its_zero_pose_is_not_lost():
    assert not zero_row_mask(angles()).any()
    assert not zero_row_mask(angles()[::-1]).any()
    assert not zero_row_mask(np.zeros((COUNT, 3))).any()


@pytest.fixture
def dirty():
    return Dirty()


def statements(findings):
    return [f"{f.severity} {f.sentence}" for f in findings]


def test_lost_points_are_named_by_trial_count_and_duration_and_left_out(
    dirty, tmp_path
):
    rows = dirty.points[dirty.points["trial"] == "t03"].index
    lost = RNG.choice(rows, len(rows) // 5, replace=False)
    dirty.points.loc[lost, ["x", "y"]] = 0.0
    findings = findings_in(dirty.write(tmp_path))
    (sentence,) = statements(findings)
    assert sentence.startswith("warning points.csv x, y (trial t03)")
    assert f"t03: {len(lost)} of {len(rows)}, for up to 0.0" in sentence
    read = dataset.read_dataset(tmp_path).trials["t03"].points
    assert len(read) == len(rows) - len(lost)


def test_rows_of_zeros_are_an_error_and_the_command_leaves_them_out(dirty, tmp_path):
    clean = dirty.arm.copy()
    dirty.arm.loc[::4, ["q1", "q2", "q3"]] = 0.0
    (finding,) = findings_in(dirty.write(tmp_path))
    assert finding.severity is Severity.ERROR
    assert "t00: " in finding.statement
    assert "m/s" in finding.statement
    command = finding.remedy.partition(": ")[2].replace("python", sys.executable, 1)
    subprocess.run(["sh", "-c", command], check=True)
    assert all(f.severity is Severity.NOTE for f in findings_in(tmp_path))
    kept = pd.read_csv(tmp_path / "arm.csv")
    assert len(kept) == len(clean) - len(clean.loc[::4])


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (lambda t: t.astype(np.float32) + np.float32(1.7e9), "rows have the same"),
        (lambda t: np.floor(t / 0.1) * 0.1, "different ones, 0.1 s apart"),
    ],
    ids=["float32", "coarse"],
)
def test_useless_times_are_reported_and_no_clock_is_proposed(
    dirty, tmp_path, stamps, words
):
    here = dirty.points["trial"] == "t03"
    times = stamps(dirty.points.loc[here, "t"].to_numpy())
    dirty.points["t"] = dirty.points["t"].astype(float)
    dirty.points.loc[here, "t"] = times.astype(float)
    findings = [f for f in findings_in(dirty.write(tmp_path)) if "t03" in f.trials]
    assert [f.field for f in findings] == ["t"]
    assert words in findings[0].statement
    assert "--fps 200" in findings[0].remedy
    assert all("clock" not in f.remedy for f in findings)


@pytest.mark.parametrize("cut", [0.0, 0.1])
def test_angles_that_wrap_are_unwrapped_with_a_note(dirty, tmp_path, cut):
    clean = dirty.arm["q1"].copy()
    start = clean.iloc[60] - cut
    dirty.arm["q1"] = start + (clean - start) % (2 * np.pi)
    (finding,) = findings_in(dirty.write(tmp_path))
    assert (finding.severity, finding.field) == (Severity.NOTE, "q1")
    read = dataset.read_dataset(tmp_path).trials
    for name, trial in read.items():
        turned = trial.arm["q1"] - clean[dirty.arm["trial"] == name].to_numpy()
        assert np.ptp(turned) < 1e-9
