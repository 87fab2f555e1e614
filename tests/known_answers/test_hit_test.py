"""Whether the tip entered the box.

Its path between frames counts, except in gaps.
"""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stringcast.data.artifacts import MASKS, POINTS, Points
from stringcast.data.schema import DataError
from stringcast.stages.hit_test import check_reach, hit_test
from stringcast.stages.model.box import Box
from stringcast.stages.model.target import Target

BOX = Target(0.5, 0.5, 0.02, 0.04)


def readings_of_tip(t, x, y, points=None):
    readings = pd.DataFrame({"t": t, "tip_x": x, "tip_y": y, "valid": np.isfinite(x)})
    return Points(POINTS.empty() if points is None else points, readings, MASKS.empty())


def test_a_tip_that_flies_through_between_two_frames_hits():
    t = np.arange(0, 0.1, 0.005) + 0.0005
    verdict = hit_test(
        readings_of_tip(t, 0.5 + 20 * (t - 0.0505), 0.5 + 0 * t), BOX, (), 0.1
    )
    assert verdict.hit
    assert verdict.t == pytest.approx(0.0505, abs=5e-4)
    assert verdict.distance < 0.006


@pytest.mark.parametrize(
    ("dx", "dy", "hit"),
    [(0.0095, 0, True), (0.0105, 0, False), (0, 0.0195, True), (0, 0.021, False)],
)
def test_the_box_is_0_02_by_0_04(dx, dy, hit):
    t = np.arange(0, 0.1, 0.005)
    verdict = hit_test(
        readings_of_tip(t, 0.5 + dx + 0 * t, 0.5 + dy + 0 * t), BOX, (), 0.1
    )
    assert verdict.hit == hit
    assert verdict.distance == pytest.approx(np.hypot(dx, dy), abs=1e-9)


def test_only_readings_during_the_movement_count():
    t = np.arange(-0.2, 0.4, 0.005)
    inside = np.where((t < -0.05) | (t > 0.25), 0.5, 0.8)
    assert not hit_test(readings_of_tip(t, inside, 0.5 + 0 * t), BOX, (), 0.2).hit


def test_a_gap_in_the_readings_is_not_interpolated():
    t = np.arange(0, 0.1, 0.005)
    x = 0.3 + 4 * t
    x[(x > 0.4) & (x < 0.6)] = np.nan
    verdict = hit_test(readings_of_tip(t, x, 0.5 + 0 * t), BOX, (), 0.1)
    assert not verdict.hit
    assert verdict.distance > 0.09
    assert not hit_test(readings_of_tip(t[:1], x[:1], t[:1]), BOX, (), 0.1).hit


def test_a_tip_read_only_outside_the_movement_has_no_distance():
    t = np.array([0.3, 0.305, 0.31])
    verdict = hit_test(readings_of_tip(t, t, t), BOX, (), 0.2)
    assert not verdict.hit
    assert np.isnan(verdict.distance)


def test_a_slow_camera_can_detect_a_hit():
    t = np.arange(0, 1, 1 / 30)
    assert hit_test(readings_of_tip(t, 0.3 + 0.4 * t, 0.5 + 0 * t), BOX, (), 1.0).hit


def test_a_string_that_touches_an_obstacle_first_has_not_hit():
    """A string that touches an obstacle on its way has not hit.

    A straight string of three points sweeps to the right. A wall stands where it passes
    at t = 0.05.
    """
    t = np.arange(0, 0.1, 0.005)
    x = 0.5 + 4 * (t - 0.08)
    rows = [
        {"t": a, "s": s, "x": b, "y": 0.5 - s}
        for a, b in zip(t, x, strict=True)
        for s in (0.0, 0.1, 0.2)
    ]
    wall = Box(0.38, 0.35, 0.021, 0.02)  # the wall is between two points of the string
    struck = hit_test(
        readings_of_tip(t, x, 0.5 + 0 * t, pd.DataFrame(rows)), BOX, (wall,), 0.1
    )
    assert (struck.hit, struck.touched) == (False, 1)
    behind = hit_test(
        readings_of_tip(t, x, 0.5 + 0 * t, pd.DataFrame(rows)),
        BOX,
        (Box(0.57, 0.35, 0.021, 0.02),),
        0.1,
    )
    assert (behind.hit, behind.touched) == (True, 1)  # only after the hit
    assert hit_test(
        readings_of_tip(t, x, 0.5 + 0 * t, pd.DataFrame(rows)), BOX, (), 0.1
    ).hit


def crossing(moment):
    """Return the test of a tip that enters the box between two fine times, 94 and 95.

    The string touches an obstacle at a given moment.
    """
    t = np.arange(201) * 0.0005
    rows = pd.DataFrame(
        [{"t": moment(t), "s": s, "x": 0.2 + s, "y": 0.0} for s in (0.0, 0.1)]
    )
    return hit_test(
        readings_of_tip(t, 0.301 + 4 * t, 0.5 + 0 * t, rows),
        BOX,
        (Box(0.25, 0.0, 0.02, 0.02),),
        0.1,
    )


@pytest.mark.parametrize(
    ("moment", "hit", "touched"),
    [
        (lambda t: t[95], False, 1),  # a touch at the time of entry is not a clear hit
        (lambda t: t[96], True, 1),
        (lambda t: -0.0005, True, 0),  # times before the movement do not count
        (lambda t: 0.0, False, 1),
        (lambda t: 0.1, True, 1),  # the last time of the movement counts
        (lambda t: 0.1005, True, 0),
    ],
)
def test_an_obstacle_counts_from_the_start_to_the_moment_of_entry(moment, hit, touched):
    verdict = crossing(moment)
    assert (verdict.hit, verdict.touched) == (hit, touched)


def flight(angle, speed):
    """Return readings of a tip that flies through the centre of the box at 0.05 s."""
    t = np.arange(0, 0.1, 0.005)
    way = speed * (t - 0.05)
    return readings_of_tip(t, 0.5 + way * np.cos(angle), 0.5 + way * np.sin(angle))


@pytest.mark.parametrize("angle", [-3.0, -1.2, 0.0, 2.0, 3.1])
def test_speed_and_direction_of_a_straight_flight(angle):
    verdict = hit_test(flight(angle, 8.0), BOX, (), 0.1)
    assert verdict.speed == pytest.approx(8.0)
    assert verdict.direction == pytest.approx(angle)


@pytest.mark.parametrize(
    ("wanted", "hit"),
    [
        ({"direction": 3.1}, True),
        ({"direction": -3.1}, True),  # less than the tolerance away, across pi
        ({"direction": 2.6}, False),
        ({"speed": 9.5}, True),
        ({"speed": 10.5}, False),
        ({"direction": 3.1, "speed": 10.5}, False),
    ],
)
def test_the_tip_must_arrive_with_the_required_direction_and_speed(wanted, hit):
    target = replace(BOX, **wanted)
    verdict = hit_test(flight(3.1, 8.0), target, (), 0.1)
    assert verdict.hit == hit
    assert verdict.entered
    beside = replace(target, x=target.x + 1.0)
    assert not hit_test(flight(3.1, 8.0), beside, (), 0.1).entered


def test_the_reported_passage_is_the_one_that_hits():
    """The tip passes the centre upwards, and 5 mm from it downwards."""
    t = np.arange(0, 0.2, 0.002)
    up = t < 0.1
    x = np.where(up, 0.5, 0.505)
    y = np.where(up, 0.5 + 4 * (t - 0.05), 0.5 - 4 * (t - 0.15))
    any_way = hit_test(readings_of_tip(t, x, y), BOX, (), 0.2)
    downwards = hit_test(
        readings_of_tip(t, x, y), replace(BOX, direction=-np.pi / 2), (), 0.2
    )
    assert any_way.hit
    assert downwards.hit
    assert any_way.t == pytest.approx(0.05, abs=1e-3)
    assert downwards.t == pytest.approx(0.15, abs=1e-3)


@pytest.mark.parametrize(("x", "y"), [(-3.0, 0.2), (2.0, 0.7), (0.1, 9.0)])
def test_the_proposed_alternative_target_is_reachable(arm, x, y):
    with pytest.raises(DataError, match="out of reach") as refusal:
        check_reach(replace(BOX, x=x, y=y), arm, 0.3)
    proposed = re.search(r"target\.x=(\S+) target\.y=(\S+)\. ", str(refusal.value))
    nearer = replace(BOX, x=float(proposed[1]), y=float(proposed[2]))
    check_reach(nearer, arm, 0.3)
    assert nearer.distance_to_centre(np.array([x, y])) < np.hypot(
        *(np.array([x, y]) - arm.base)
    )
