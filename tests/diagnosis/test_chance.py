"""What the best of many effects gains on noise alone, and what a string that hangs still is worth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from stringcast.stages.diagnose.chance import by_chance
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.single_effects.prepared import RESTING, awake
from stringcast.stages.inference.forward import Case

FRAMES, ALONG = 2000, 5
TIMES = np.arange(FRAMES) * 0.05 + 0.01  # each in a piece of time of its own


def evidence(times=TIMES, points=None):
    frame, s = np.repeat(np.arange(len(times)), ALONG), np.tile(np.linspace(0.1, 0.3, ALONG), len(times))
    points = np.zeros((len(frame), 2)) if points is None else points
    model = SimpleNamespace(string=SimpleNamespace(length=0.3))
    return Evidence((Case("t0", model, None, times, frame, s, points, np.ones(len(frame))),), (10, 14))


def probes(count, size, rng):
    directions, _ = np.linalg.qr(rng.standard_normal((size, count)))
    return {f"effect{k}": [SimpleNamespace(direction=d)] for k, d in enumerate(directions.T)}


@pytest.mark.parametrize("count", [1, 100])
def test_the_price_of_asking_many_is_that_of_the_largest_of_as_many_chances(count):
    rng = np.random.default_rng(0)
    residual = rng.standard_normal(2 * FRAMES * ALONG)
    found = by_chance(evidence(), SimpleNamespace(residual=residual), probes(count, len(residual), rng), 1)
    assert found == pytest.approx(chi2.ppf(0.99 ** (1 / count), 1) / 2, rel=0.25)


def test_errors_that_go_on_for_a_while_cost_more():
    """Twenty frames in each piece of time, all with the error of the first: twenty times the gain by chance."""
    rng = np.random.default_rng(2)
    close = TIMES / 20
    alone = rng.standard_normal((FRAMES // 20, 1, 2 * ALONG))
    residual = np.repeat(alone, 20, axis=1).ravel()
    # an effect that changes slowly too
    directions = np.repeat(rng.standard_normal((30, FRAMES // 20, 1, 2 * ALONG)), 20, axis=2).reshape(30, -1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    asked = {f"effect{k}": [SimpleNamespace(direction=d)] for k, d in enumerate(directions)}
    found = by_chance(evidence(close), SimpleNamespace(residual=residual), asked, 1)
    assert found == pytest.approx(20 * chi2.ppf(0.99 ** (1 / 30), 1) / 2, rel=0.25)


def test_what_hangs_still_is_looked_at_once():
    times = np.arange(0, 10, 0.01)
    swing = 0.1 * np.exp(-times) * np.cos(9 * times)  # within 3 mm of rest from about 3.5 s on
    points = np.stack([np.outer(swing, np.linspace(0.1, 1, ALONG)), np.zeros((len(times), ALONG))], axis=-1)
    ready = evidence(times, points.reshape(-1, 2)).cases[0]
    last = times[np.flatnonzero(np.abs(swing) > 0.003)[-1]]
    kept = awake(ready)
    assert kept.times[-1] == pytest.approx(last + RESTING, abs=0.011)
    assert len(kept.points) == ALONG * len(kept.times)
    # the rest that counts is that at the end, wherever the string was for most of the time
    before = replace(ready, points=ready.points + 0.1 * (ready.times[ready.frame] < 6.0)[:, None])
    assert awake(before).times[-1] == pytest.approx(6.0 + RESTING, abs=0.011)
    # a string that still moves at the end is left as it is, one that never moves is looked at shortly
    assert len(awake(replace(ready, points=ready.points * 1e3)).times) == len(times)
    assert awake(replace(ready, points=ready.points * 1e-3)).times[-1] == pytest.approx(RESTING, abs=0.011)
