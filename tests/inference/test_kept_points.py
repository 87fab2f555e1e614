"""Simulated points are the same whether or not they were simulated recently."""

from dataclasses import replace

import numpy as np
import pytest

from stringcast.stages.inference import batch, kept_points
from stringcast.stages.inference.kept_points import KeptPoints
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.state import StringState
from tests.conftest import implicit_string

CANDIDATES = np.random.default_rng(0).uniform(size=(5, 2))


@pytest.fixture
def model(arm, camera):
    return Model(implicit_string(8, 1e-3, 0.3), arm, camera)


@pytest.fixture
def trial(model):
    times = np.array([1.0, 1.1])
    frame = np.array([0, 0, 1])
    s = np.array([0.1, 0.3, 0.3])
    return PreparedTrial("t", model, None, times, frame, s, np.ones((3, 2)), np.ones(3))


@pytest.fixture
def simulated(monkeypatch):
    """Return a list of the candidates in each simulation, with fake simulations."""
    batches = []

    def simulate(model, trials, values):
        batches.append(values.tolist())
        return [np.tile(values[:, :1, None], (1, len(t.s), 2)) for t in trials]

    monkeypatch.setattr(batch, "_simulate_points", simulate)
    monkeypatch.setattr(batch, "_KEPT_POINTS", KeptPoints())
    return batches


def test_only_candidates_that_are_new_are_simulated(model, trial, simulated):
    first = batch.measured_points(model, [trial, trial], CANDIDATES[:3])
    again = batch.measured_points(model, [trial, trial], CANDIDATES[::-1])
    assert simulated == [CANDIDATES[:3].tolist(), CANDIDATES[:2:-1].tolist()]
    for one, other in zip(first, again, strict=True):
        assert one.tolist() == other[:1:-1].tolist()
        assert other[:, 0, 0].tolist() == CANDIDATES[::-1, 0].tolist()


def test_a_trial_with_other_readings_is_not_simulated_again(model, trial, simulated):
    batch.normalised_residuals(model, [trial], CANDIDATES)
    other = replace(trial, points=2 * trial.points, sigma=0.5 * trial.sigma)
    (residuals,) = batch.normalised_residuals(model, [other], CANDIDATES)
    assert len(simulated) == 1
    expected = np.repeat((CANDIDATES[:, :1] - 2.0) / 0.5, 6, axis=1)
    assert residuals == pytest.approx(expected)


@pytest.mark.parametrize(
    "change",
    [
        {"times": np.array([1.0, 1.2])},
        {"frame": np.array([0, 1, 1])},
        {"s": np.array([0.1, 0.2, 0.3])},
        {"turn": 1.0},
        {"initial_state": StringState(1.0, *np.zeros((3, 2)))},
    ],
)
def test_another_motion_or_place_is_simulated(model, trial, simulated, change):
    batch.measured_points(model, [trial], CANDIDATES)
    batch.measured_points(model, [replace(trial, **change)], CANDIDATES)
    assert len(simulated) == 2


def test_points_of_another_model_are_simulated_again(model, trial, simulated):
    batch.measured_points(model, [trial], CANDIDATES)
    batch.measured_points(
        model.with_effects(*find_effects(["wind"])), [trial], CANDIDATES
    )
    finer = replace(model, string=replace(model.string, points=16))
    batch.measured_points(finer, [replace(trial, model=finer)], CANDIDATES)
    assert len(simulated) == 3


def test_a_redefined_effect_is_simulated_again(model, trial, simulated):
    """A notebook changes a law under the same name."""
    (effect,) = find_effects(["wind"])
    again = type(effect.__name__, (effect,), {"__module__": effect.__module__})
    again.__qualname__ = effect.__qualname__
    batch.measured_points(model.with_effects(effect), [trial], CANDIDATES)
    batch.measured_points(model.with_effects(again), [trial], CANDIDATES)
    assert len(simulated) == 2


def test_the_number_of_kept_points_is_limited(model, trial, simulated, monkeypatch):
    monkeypatch.setattr(kept_points, "MAX_KEPT_NUMBERS", 3 * 6)
    batch.measured_points(model, [trial], CANDIDATES)
    batch.measured_points(model, [trial], CANDIDATES[2:])
    assert len(simulated) == 1
    batch.measured_points(model, [trial], CANDIDATES[:1])
    assert len(simulated) == 2


def test_only_the_trial_that_changed_is_simulated(model, trial, simulated, monkeypatch):
    """The initial state of one of two trials is refined."""
    fake = batch._simulate_points
    turns = []

    def simulate(model, trials, values):
        turns.append([trial.turn for trial in trials])
        return fake(model, trials, values)

    monkeypatch.setattr(batch, "_simulate_points", simulate)
    other = replace(trial, turn=0.5)
    first, _ = batch.measured_points(model, [trial, other], CANDIDATES)
    changed = replace(other, turn=1.0)
    again, _ = batch.measured_points(model, [trial, changed], CANDIDATES)
    batch.measured_points(model, [changed, other, trial], CANDIDATES)
    assert turns == [[0.0, 0.5], [1.0]]
    assert again.tolist() == first.tolist()
