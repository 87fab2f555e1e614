"""Rivals on what was measured, with nothing subtracted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import simulate_trial, swing_angles, true_exponents

from stringcast.stages.diagnose import common_data
from stringcast.stages.diagnose.common_data import measured_data
from stringcast.stages.diagnose.discretisation import (
    subtract_discretisation_error,
    with_second_order_mesh,
)
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.inference.extrapolated_data import ExtrapolatedData
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, evaluate_fit
from stringcast.stages.inference.mesh import residuals_on_meshes
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.engine.accuracy import richardson_limit

PLACES = np.array([8, 14, 20])
SIGMA_M = 1e-4


@pytest.fixture(scope="module")
def hypothesis(arm):
    return Hypothesis(with_second_order_mesh(ordinary(arm)))


@pytest.fixture(scope="module")
def trials(arm, hypothesis):
    rng = np.random.default_rng(0)
    model = hypothesis.model
    trials = []
    for k, angles in enumerate(swing_angles(arm, 2, 0.4)):
        measured = simulate_trial(f"t{k}", arm, model, TRUTH, angles, PLACES, rng)
        trial = prepare_trial(model, measured)
        trials.append(replace(trial, sigma=np.full(len(trial.s), SIGMA_M)))
    return tuple(trials)


def corrected_at(trials, hypothesis, chi):
    """Subtract the numerical error of exponents (P,) from trials."""
    data, uncertainty_m = subtract_discretisation_error(trials, hypothesis, chi)
    return PreparedData(data, None, trials, trials, 0, uncertainty_m)


def test_the_limit_of_two_meshes_is_near_that_of_finer_ones(trials, hypothesis):
    chi = true_exponents(hypothesis, TRUTH)[None]
    model = hypothesis.model
    coarse, finer, finest = residuals_on_meshes(model, trials, chi, (1, 2, 4))
    extrapolated = ExtrapolatedData(trials).residuals(model, chi)
    for k in range(len(trials)):
        limit = richardson_limit(finer[k], finest[k])
        error = np.abs(extrapolated[k] - limit).max()
        assert error < 0.1 * np.abs(coarse[k] - limit).max()


def test_evidence_on_common_data_is_the_same_wherever_they_were_corrected(
    trials, hypothesis
):
    """The numerical error of another fit, which was subtracted, is not that of a fit.

    The error model is that of one of them.
    """
    chi = true_exponents(hypothesis, TRUTH)
    own = corrected_at(trials, hypothesis, chi)
    other = corrected_at(trials, hypothesis, np.clip(chi + 0.15, 0.0, 1.0))
    with_same_errors = []
    for trial, other_trial in zip(own.data.trials, other.data.trials, strict=True):
        with_same_errors.append(replace(trial, points=other_trial.points))
    other = replace(other, data=TrialData(tuple(with_same_errors)))

    def log_likelihood(data):
        return evaluate_fit(data, hypothesis, chi).log_likelihood_by_trial.sum()

    on_corrected = log_likelihood(other.data) - log_likelihood(own.data)
    measured = [log_likelihood(measured_data(each)) for each in (other, own)]
    assert abs(on_corrected) > 1
    assert measured[0] == pytest.approx(measured[1], abs=1e-6)
    # What is left is the numerical error of the extrapolation
    assert measured[1] == pytest.approx(log_likelihood(own.data), abs=0.1)


def fit_of(name, exponents, log_evidence=0.0):
    """Return a fit of exponents by name, as far as a comparison knows it."""
    hypothesis = SimpleNamespace(name=name, model=SimpleNamespace(names=[*exponents]))
    hypothesis.exponents_from = lambda known: np.array([known[e] for e in exponents])
    chi = np.array([*exponents.values()])
    return Fit(hypothesis, chi, [], [], None, np.array([3]), np.zeros(1), log_evidence)


def test_a_rival_starts_from_its_optimum_or_from_that_of_the_best_other(monkeypatch):
    """The more likely start is used; that of another is fitted on one mesh first."""
    fits = [
        fit_of("base", {"stiffness": 0.1}, 1.0),
        fit_of("wind", {"stiffness": 0.2, "speed": 0.5}, 2.0),
        fit_of("set", {"stiffness": 0.3, "curvature": 0.6}, 3.0),
    ]
    likeliest = {"base": 0.1, "wind": 0.35, "set": 0.3}  # of the stiffness

    def fit_on_one_mesh(data, hypothesis, starts, *given):
        assert data == "one mesh"
        is_stiffness = np.arange(starts.shape[1]) == 0
        return starts[0] + 0.05 * is_stiffness, None

    def fit(data, hypothesis, starts, *given):
        (start,) = starts.round(9).tolist()
        fitted.append((data, hypothesis.name, start))
        return fit_of(hypothesis.name, {"stiffness": 0.0})

    def log_likelihoods(data, hypothesis, chi):
        return -np.abs(chi[:, 0] - likeliest[hypothesis.name])

    def add_random_effects(data, hypothesis, chi):
        return f"{data}, with {hypothesis.name}"

    fitted = []
    monkeypatch.setattr(common_data, "best_exponents", fit_on_one_mesh)
    monkeypatch.setattr(common_data, "fit_hypothesis", fit)
    monkeypatch.setattr(common_data, "log_likelihoods", log_likelihoods)
    monkeypatch.setattr(common_data, "measured_data", lambda prepared: "measured")
    monkeypatch.setattr(common_data, "with_random_effects", add_random_effects)
    prepared = SimpleNamespace(data="one mesh")
    compared = common_data.fit_to_common_data(prepared, fits)

    assert fitted == [
        ("measured, with base", "base", [0.1]),
        ("measured, with wind", "wind", [0.35, 0.5]),
        ("measured, with set", "set", [0.3, 0.6]),
    ]
    for one, before in zip(compared, fits, strict=True):
        assert one.hypothesis is before.hypothesis
