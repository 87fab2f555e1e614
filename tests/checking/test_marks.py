"""Marks with wrong arc lengths are found from the hanging string."""

import re

import numpy as np
import pytest

from stringcast.stages.check.finding import Severity
from tests.checking.test_check import Dirty, findings_in

SHIFT_M = 0.008


@pytest.fixture
def few_marks():
    """Keep the tip and two marks of the sample."""
    dirty = Dirty()
    places = np.sort(dirty.points["s"].unique())
    chosen = places[[1, 3, -1]]
    dirty.points = dirty.points[dirty.points["s"].isin(chosen)].reset_index(drop=True)
    return dirty, chosen


def mark_findings(dirty, folder):
    return [f for f in findings_in(dirty.write(folder)) if "hang as if" in f.statement]


def test_right_marks_give_no_warning(few_marks, tmp_path):
    dirty, _ = few_marks
    assert not mark_findings(dirty, tmp_path)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_wrong_mark_is_found_with_its_place(few_marks, tmp_path, sign):
    dirty, (_, place, _) = few_marks
    is_mark = dirty.points["s"] == place
    dirty.points.loc[is_mark, "s"] = place + sign * SHIFT_M
    (finding,) = mark_findings(dirty, tmp_path)
    assert finding.severity is Severity.WARNING
    stated, found = map(float, re.findall(r"at (0\.\d+) m", finding.statement))
    assert stated == pytest.approx(place + sign * SHIFT_M, abs=5e-4)
    assert found == pytest.approx(place, abs=1.5e-3)


@pytest.mark.parametrize("change", ["two trials", "moving", "another hand"])
def test_strings_that_do_not_show_marks_give_no_warning(few_marks, tmp_path, change):
    """They have too few shapes, do not hang, or do not fit this hand."""
    dirty, (_, place, _) = few_marks
    dirty.points.loc[dirty.points["s"] == place, "s"] = place + SHIFT_M
    if change == "two trials":
        first_two = sorted(dirty.points["trial"].unique())[:2]
        dirty.points = dirty.points[dirty.points["trial"].isin(first_two)]
        dirty.arm = dirty.arm[dirty.arm["trial"].isin(first_two)]
    elif change == "moving":
        dirty.about["initial"] = "moving"
    else:
        dirty.points["x"] += 0.01
    assert not mark_findings(dirty, tmp_path)


def test_a_whole_centre_line_is_not_checked(tmp_path):
    """Its arc lengths are measured in the picture."""
    dirty = Dirty()
    dirty.points["s"] *= 1 + 0.1 * np.sin(9 * dirty.points["s"])
    assert not mark_findings(dirty, tmp_path)


def test_marks_seen_in_alternate_frames_are_not_checked(tmp_path):
    """Two of six marks on a string of 1 m are seen in each frame.

    Interpolated places are tracked, which are named by numbers, not arc lengths.
    """
    dirty = Dirty().with_poses()
    longer = 1.0 / float(dirty.points["s"].max())
    dirty.points[["s", "x", "y"]] *= longer
    dirty.grasp[["x", "y"]] *= longer
    dirty.about["string"]["length"] *= longer
    marks = np.sort(dirty.points["s"].unique())[1:]
    frames = dirty.points[dirty.points["s"].isin(marks)].groupby(["trial", "t"])
    dirty.points = frames.sample(2, random_state=0).reset_index(drop=True)
    assert not mark_findings(dirty, tmp_path)
