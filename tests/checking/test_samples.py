"""Properties of a track's samples are noted; right tracks have no notes."""

import re

import numpy as np
import pytest

from stringcast.stages.check import measured
from stringcast.stages.check.finding import Severity
from stringcast.stages.check.samples import grid_step
from tests.checking.test_check import Dirty, findings_in, read_checked

RNG = np.random.default_rng(7)


@pytest.fixture
def dirty():
    return Dirty()


def write_samples(folder):
    folder.mkdir()
    return folder


def outliers(dirty):
    rows = RNG.random(len(dirty.points)) < 0.05
    dirty.points.loc[rows, ["x", "y"]] += RNG.normal(0, 0.2, (rows.sum(), 2))


def coarse(dirty):
    dirty.points[["x", "y"]] = np.round(dirty.points[["x", "y"]] / 0.008) * 0.008


def smoothed(dirty):
    dirty.about["noise"] = {"point_sigma": 3e-3}
    places = dirty.points.groupby(["trial", "s"])
    for axis in ("x", "y"):
        dirty.points[axis] = places[axis].transform(
            lambda track: track.rolling(5, center=True, min_periods=1).mean()
        )


def smoothed_unstated(dirty):
    smoothed(dirty)
    del dirty.about["noise"]


NOTED = {
    outliers: ("x, y", r"positions \(\d\.\d%\) jump away and back at once, by up to 0"),
    coarse: ("x, y", "in steps of 0.008 m; their noise is at least 0.0023 m"),
    smoothed: ("noise.point_sigma", "a lower bound: the track seems smoothed; the"),
    smoothed_unstated: ("sigma", "the track seems smoothed, and its noise is larger"),
}


def test_gross_outliers_do_not_change_rest_onset_or_fall(dirty, tmp_path):
    clean = read_checked(dirty.write(write_samples(tmp_path / "clean")))
    frames = dirty.points.groupby(["trial", "t"]).ngroup()
    is_out = np.isin(frames, RNG.choice(frames.max() + 1, frames.max() // 20))
    dirty.points.loc[is_out, ["x", "y"]] += 3.0
    spoilt = read_checked(dirty.write(write_samples(tmp_path / "spoilt")))
    for before, after in zip(clean.with_points(), spoilt.with_points(), strict=True):
        assert after.string_onset == pytest.approx(before.string_onset, abs=0.016)
    statements = [finding.statement for finding in findings_in(tmp_path / "spoilt")]
    assert any("jump away and back" in words for words in statements)
    assert not any("to fall with" in words for words in statements)
    assert not any("from the grasp" in words for words in statements)


def test_a_tip_hidden_for_half_of_the_time_does_not_seem_to_fall(dirty, tmp_path):
    times = dirty.points.groupby("trial")["t"]
    middle = (times.transform("min") + times.transform("max")) / 2
    is_tip = dirty.points["s"] == dirty.points["s"].max()
    dirty.points = dirty.points[~(is_tip & (dirty.points["t"] > middle))]
    statements = [finding.statement for finding in findings_in(dirty.write(tmp_path))]
    assert not any("to fall with" in words for words in statements)


@pytest.mark.parametrize("spoil", NOTED, ids=lambda spoil: spoil.__name__)
def test_findings_without_action_are_notes(dirty, tmp_path, spoil):
    spoil(dirty)
    field, words = NOTED[spoil]
    (finding,) = findings_in(dirty.write(tmp_path))
    assert (finding.severity, finding.field) == (Severity.NOTE, field)
    assert re.search(words, finding.statement), finding.statement


def rounded(dirty):
    """Round to a tenth of a millimetre, as in a tracker's CSV."""
    dirty.points[["x", "y"]] = np.round(dirty.points[["x", "y"]], 4)


def jittered(dirty):
    """Add the jitter of a computer's clock to the times."""
    dirty.about["camera"] = {"fps": 200}
    times = np.sort(dirty.points["t"].unique())
    moved = times + RNG.normal(0, 5e-4, len(times))
    dirty.points["t"] = moved[np.searchsorted(times, dirty.points["t"])]


def dropped(dirty):
    """Drop random frames of a camera with the stated rate."""
    dirty.about["camera"] = {"fps": 200}
    times = dirty.points["t"].unique()
    kept = times[RNG.random(len(times)) > 0.3]
    dirty.points = dirty.points[dirty.points["t"].isin(kept)]


def state_noise(dirty):
    dirty.about["noise"] = {"point_sigma": 7e-4}


@pytest.mark.parametrize(
    "change",
    [rounded, jittered, dropped, state_noise],
    ids=lambda change: change.__name__,
)
def test_usual_data_have_no_notes(dirty, tmp_path, change):
    change(dirty)
    assert findings_in(dirty.write(tmp_path)) == []


def test_dropped_frames_do_not_enlarge_the_noise(dirty, tmp_path):
    dropped(dirty)
    for trial in read_checked(dirty.write(tmp_path)).trials:
        assert 0.5e-3 < trial.noise < 1e-3  # with all frames: 0.66 to 0.69 mm


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_scatter_of_uneven_frames_is_that_of_the_noise(share):
    t = np.arange(2000) / 200
    t = t[RNG.random(len(t)) >= share]
    xy = np.stack([np.sin(3 * t), np.cos(2 * t)], axis=1)
    xy += 1e-3 * RNG.standard_normal(xy.shape)
    scatter = measured.scatter_of_track(t, xy)
    assert np.std(scatter) == pytest.approx(1e-3, rel=0.1)


def test_a_grid_is_distinguished_from_numbers_with_many_digits():
    values = RNG.random(500)
    assert grid_step(values) == 0
    assert grid_step(np.round(values / 0.03) * 0.03) == pytest.approx(0.03)
    assert grid_step(np.zeros(500)) == 0


def test_each_position_written_for_lost_points_is_reported(dirty, tmp_path):
    """A tracker may write different positions for each point that it loses."""
    s = dirty.points["s"]
    is_lost = RNG.random(len(s)) < 0.05
    dirty.points.loc[is_lost & (s == s.max()), ["x", "y"]] = -0.001
    dirty.points.loc[is_lost & (s < s.max()), ["x", "y"]] = 0.0
    findings = findings_in(dirty.write(write_samples(tmp_path / "lost")))
    statements = " ".join(found.statement for found in findings)
    assert "the tracker wrote (0, 0)" in statements
    assert "the tracker wrote (-0.001, -0.001)" in statements
