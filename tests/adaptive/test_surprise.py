"""The test of a trial against its predictions: calibrated, and it sees what matters."""

import numpy as np
import pandas as pd
import pytest

from stringcast.data.artifacts import (
    MASKS,
    POINTS,
    PREDICTED_TIPS,
    READINGS,
    Motion,
    Points,
    outcome_without_target,
)
from stringcast.stages.surprise.surprise import ALARM_P_VALUE, measure_surprise

DRAWS = 100
DURATION_S = 0.5
NOISE_M = 0.7e-3
FRAME_TIMES = np.arange(0, DURATION_S, 0.01)


def tip_paths(rng, count):
    """Return paths (count, F, 2) [m] that differ by some mm, more towards the end."""
    share = FRAME_TIMES / DURATION_S
    shape = np.stack([np.sin(3 * share), np.cos(3 * share)], axis=-1)
    amount = rng.normal(0, 4e-3, (count, 1, 2))
    delay = rng.normal(0, 3e-3, (count, 1, 1))
    return shape * (1 + delay * share[:, None]) + amount * share[:, None] ** 2


def predicted(paths):
    columns = {
        "draw": np.repeat(np.arange(len(paths)), len(FRAME_TIMES)),
        "t": np.tile(FRAME_TIMES, len(paths)),
        "x": paths[..., 0].ravel(),
        "y": paths[..., 1].ravel(),
    }
    empty = [Motion.TABLES[name].empty() for name in list(Motion.TABLES)[:4]]
    tips = PREDICTED_TIPS.check(pd.DataFrame(columns))
    return Motion(*empty, outcome_without_target(DURATION_S, 1), tips)


def read(path, rng):
    noisy = path + rng.normal(0, NOISE_M, path.shape)
    readings = {
        "frame": np.arange(len(path)),
        "t": FRAME_TIMES,
        "valid": True,
        "reason": "",
        "tip_x": noisy[:, 0],
        "tip_y": noisy[:, 1],
        "tip_sigma": NOISE_M,
        "length": 0.3,
    }
    return Points(POINTS.empty(), READINGS.check(pd.DataFrame(readings)), MASKS.empty())


def surprises(offset_m, trials):
    """Return the surprises of trials whose tip is off at the end by an offset [m]."""
    rng = np.random.default_rng(0)
    motion = predicted(tip_paths(rng, DRAWS))
    offset = offset_m * (FRAME_TIMES / DURATION_S)[:, None] * [1.0, 0.0]
    paths = tip_paths(rng, trials) + offset
    return [measure_surprise(motion, read(path, rng), rng) for path in paths]


def test_p_values_of_trials_of_the_posterior_are_spread_evenly():
    trials = 200
    found = surprises(0.0, trials)
    assert np.mean([s.p_value <= 0.5 for s in found]) == pytest.approx(0.5, abs=0.15)
    expected = ALARM_P_VALUE * trials
    alarms = sum(surprise.is_surprising for surprise in found)
    assert alarms <= expected + 3 * np.sqrt(expected)


def test_a_tip_that_is_off_by_more_than_the_box_is_a_surprise():
    assert sum(surprise.is_surprising for surprise in surprises(0.02, 40)) >= 38


def test_nothing_is_said_without_predictions_or_readings():
    rng = np.random.default_rng(0)
    paths = tip_paths(rng, DRAWS)
    points = read(paths[0], rng)
    unread = Points(
        points.points, points.readings.assign(valid=False, reason="dark"), points.masks
    )
    for motion, seen in ((predicted(paths[:10]), points), (predicted(paths), unread)):
        surprise = measure_surprise(motion, seen, rng)
        assert np.isnan(surprise.p_value)
        assert not surprise.is_surprising
