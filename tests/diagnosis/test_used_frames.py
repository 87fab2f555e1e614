"""The frames of a trial that are used: without final rest and superfluous ones."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ordinary

from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.diagnose.trials.used_frames import (
    FRAMES_PER_SPLINE,
    KEPT_REST_S,
    thin_frames,
    trim_trailing_rest,
    warn_of_long_trials,
)
from stringcast.stages.inference.basis import highest_frequency
from stringcast.stages.inference.prepared_trial import PreparedTrial

S = np.linspace(0.1, 0.3, 5)


@pytest.fixture(scope="module")
def model(arm):
    return with_second_order_mesh(ordinary(arm))


def make_trial(model, frame, s, points, times):
    """Make a trial with points (n, 2) [m]; only their times and places matter."""
    return PreparedTrial(
        "t", model, None, times, frame, s, points, np.full(len(s), 1e-3)
    )


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.9, ""), (2.0, ""), (10.0, "up to 3 Hz"), (4.0, "8 Hz")]
)
def test_the_resolved_frequency_of_a_long_trial_is_logged(
    model, caplog, seconds, words
):
    """Splines resolve 30 Hz in a trial of a second, and less in a longer one."""
    times = np.arange(0, seconds, 1 / 240)
    frame = np.zeros(1, dtype=int)
    trial = make_trial(model, frame, S[:1], np.zeros((1, 2)), times)
    warn_of_long_trials([trial])
    assert bool(caplog.text) == bool(words)
    assert words in caplog.text
    assert highest_frequency(times) == pytest.approx(31.5 / max(seconds, 0.94), rel=0.1)


@pytest.mark.parametrize(
    ("seconds", "rate_hz", "step"), [(0.9, 240, 1), (4.0, 240, 3), (10.0, 30, 1)]
)
def test_a_film_is_thinned_to_what_its_splines_need(model, seconds, rate_hz, step):
    """In a film of a second all frames are used, in a longer one fewer."""
    times = np.arange(0, seconds, 1 / rate_hz)
    frame = np.repeat(np.arange(len(times)), 5)
    points = np.stack([times[frame], np.tile(S, len(times))], axis=-1)
    trial = make_trial(model, frame, np.tile(S, len(times)), points, times)
    trial = replace(trial, growth=times)
    thinned = thin_frames(trial)
    assert thinned.times.tolist() == times[::step].tolist()
    assert thinned.growth.tolist() == thinned.times.tolist()
    assert thinned.points.tolist() == points[frame % step == 0].tolist()
    assert thinned.points[:, 0].tolist() == thinned.point_times.tolist()
    assert step == 1 or len(thinned.times) >= 64 * FRAMES_PER_SPLINE


@pytest.fixture(scope="module")
def damped_swing():
    """Compute times [s] and tip displacements [m] of a swing, still after 3.5 s."""
    times = np.arange(0, 10, 0.01)
    return times, 0.1 * np.exp(-times) * np.cos(9 * times)


@pytest.fixture(scope="module")
def swinging_trial(model, damped_swing):
    times, swing = damped_swing
    x = np.outer(swing, np.linspace(0.1, 1, 5)).ravel()
    points = np.stack([x, np.zeros(len(x))], axis=-1)
    frame = np.repeat(np.arange(len(times)), 5)
    return make_trial(model, frame, np.tile(S, len(times)), points, times=times)


def test_rest_at_the_end_is_trimmed(swinging_trial, damped_swing):
    times, swing = damped_swing
    last = times[np.flatnonzero(np.abs(swing) > 0.003)[-1]]
    trimmed = trim_trailing_rest(swinging_trial)
    assert trimmed.times[-1] == pytest.approx(last + KEPT_REST_S, abs=0.011)
    assert len(trimmed.points) == 5 * len(trimmed.times)


def test_earlier_rest_at_another_place_is_kept(swinging_trial):
    """The rest position is that at the end of the trial.

    Here the string rests at another place before.
    """
    trial = swinging_trial
    is_early = trial.times[trial.frame] < 6.0
    moved = replace(trial, points=trial.points + 0.1 * is_early[:, None])
    end = trim_trailing_rest(moved).times[-1]
    assert end == pytest.approx(6.0 + KEPT_REST_S, abs=0.011)


@pytest.mark.parametrize(("factor", "end"), [(1e3, 9.99), (1e-3, KEPT_REST_S)])
def test_a_moving_trial_is_kept_and_a_resting_one_trimmed(swinging_trial, factor, end):
    scaled = replace(swinging_trial, points=swinging_trial.points * factor)
    trimmed = trim_trailing_rest(scaled)
    assert trimmed.times[-1] == pytest.approx(end, abs=0.011)
