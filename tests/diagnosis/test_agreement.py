"""A t-test of whether trials agree on a cause."""

from types import SimpleNamespace

import numpy as np
import pytest

from stringcast.stages.diagnose.evidence import agreement
from stringcast.stages.diagnose.evidence.agreement import log_bayes_factor_of_trials


def bayes_factor(estimates, amplitude, *, move=lambda chi: chi - 0.5, amplitudes=None):
    """Compute the Bayes factor from estimates (G, P) without each group, absent at 0.5.

    move: returns the displacement (C, N) by a cause at exponents (C, P).
    """
    size = len(amplitude)
    hypothesis = SimpleNamespace(
        model=None,
        amplitude_indices=lambda cause: list(range(amplitudes or size)),
        exponents_from=lambda known: np.full(size, 0.5),
    )
    chi = 0.5 + np.array(amplitude)
    fit = SimpleNamespace(hypothesis=hypothesis, chi=chi, grid_points=None)
    white = SimpleNamespace(whiten=lambda rows, grid_points: rows[0])
    data = SimpleNamespace(
        residuals=lambda model, chi: [move(chi)],
        for_hypothesis=lambda hypothesis: white,
    )
    left_out = list(0.5 + np.array(estimates))
    return np.exp(log_bayes_factor_of_trials(data, fit, left_out, cause=None))


def leave_each_out(single):
    """Average estimates (K, A) of single trials without each in turn, (K, A)."""
    single = np.array(single)
    return (single.sum(axis=0) - single) / (len(single) - 1)


def test_the_bayes_factor_is_that_of_a_t_test_of_trial_estimates():
    """For means, the jackknife error is the standard error of the mean."""
    single = np.array([[0.10], [0.14], [0.09], [0.11]])
    t = single.mean() / (single.std(ddof=1) / 2)
    expected = (1 + t**2 / 3) ** 2 / 2
    found = bayes_factor(leave_each_out(single), single.mean(axis=0))
    assert found == pytest.approx(expected, rel=1e-9)


def test_trials_that_contradict_each_other_do_not_agree():
    single = np.array([[0.3], [-0.2], [0.25], [-0.1]])
    assert bayes_factor(leave_each_out(single), single.mean(axis=0)) < 1


def test_a_vector_may_have_a_component_that_is_absent():
    rng = np.random.default_rng(5)
    single = [0.2, 0.0] + 0.01 * rng.standard_normal((5, 2))
    assert bayes_factor(leave_each_out(single), single.mean(axis=0)) > 100


def test_correlated_parameters_do_not_prevent_agreement():
    """Only the product of a yield moment and a stiffness of dry friction matters."""
    amplitude = np.array([0.2, 0.1, 0.3, 0.15])
    other = 0.06 / amplitude
    estimates = np.stack([amplitude, other], axis=1)

    def move(chi):
        return np.prod(chi - 0.5, axis=1, keepdims=True)

    assert bayes_factor(estimates, [0.2, 0.3], move=move, amplitudes=1) > 1e6
    only_amplitude = bayes_factor(estimates[:, :1], [0.2])
    assert only_amplitude < 30


def test_trials_that_agree_exactly_give_a_finite_number():
    single = np.full((3, 1), 0.2)
    assert 100 < bayes_factor(leave_each_out(single), [0.2]) < np.inf


def test_an_absent_cause_seldom_passes():
    """At a Bayes factor of 100, it passes by chance in less than 1 % of datasets."""
    rng = np.random.default_rng(7)
    passed = 0
    for _ in range(500):
        single = rng.standard_normal((5, 1))
        passed += bayes_factor(leave_each_out(single), single.mean(axis=0)) > 100
    assert passed <= 5


@pytest.mark.parametrize(
    ("bayes_factor", "touched", "probability"),
    [
        (20, [], 0.5),
        (60, [], 0.75),
        (60, [1, 2], 0.75),
        (1e9, [1], 1 / 21),  # a single trial confirms nothing
    ],
)
def test_the_odds_are_the_bayes_factor_over_the_number_of_candidates(
    bayes_factor, touched, probability, monkeypatch
):
    """The prior probability that one of the candidates is active is one half."""
    monkeypatch.setattr(
        agreement, "log_bayes_factor_of_trials", lambda *given: np.log(bayes_factor)
    )
    monkeypatch.setattr(agreement, "trials_touched_by", lambda *given: touched)
    cause = SimpleNamespace(name="wind")
    prepared = SimpleNamespace(data=SimpleNamespace(random_effects={}))
    state = SimpleNamespace(prepared=prepared, fit=None, left_out_exponents=())
    found = agreement.probability_by_agreement(state, cause, 20, 1e-3)
    assert found == pytest.approx(probability)


def test_a_cause_that_varies_is_estimated_with_one_amplitude_for_all(monkeypatch):
    """With one amplitude per trial in addition, the common one is hardly determined.

    With these, the set of a measured strip would have been set aside.
    """
    shared = SimpleNamespace(random_effects={}, trials=range(4))
    varying = SimpleNamespace(
        random_effects={"set": ()},
        without_random_effect={"set": shared}.get,
    )
    compared = []
    stand_ins = {
        "trials_touched_by": lambda *given: [],
        "refit": lambda data, *given: f"fitted to {len(data.trials)}",
        "exponents_without_groups": lambda *given: given,
        "log_bayes_factor_of_trials": lambda *given: compared.append(given) or 0.0,
    }
    for name, stand_in in stand_ins.items():
        monkeypatch.setattr(agreement, name, stand_in)
    cause = SimpleNamespace(name="set")
    fit = SimpleNamespace(hypothesis=None)
    prepared = SimpleNamespace(data=varying)
    state = SimpleNamespace(prepared=prepared, fit=fit, left_out_exponents="with both")
    agreement.probability_by_agreement(state, cause, 20, 1e-3)
    ((data, fit, left_out, _),) = compared
    assert data is shared
    assert fit == "fitted to 4"
    assert left_out == (shared, fit, [[0], [1], [2], [3]])
