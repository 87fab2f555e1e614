"""Measures by which fits are compared, computed by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from stringcast.stages.diagnose.evidence import measures


def fit(log_evidence, by_trial):
    """Return a fit with only its evidence."""
    return SimpleNamespace(
        log_evidence=log_evidence,
        log_likelihood_by_trial=np.array(by_trial),
        hypothesis="one",
        grid_points=np.arange(len(by_trial)),
        chi=np.array([log_evidence]),
        width=np.array([1e-3]),
    )


PARENT = fit(10.0, [1.0, 2.0, 3.0])
FIT = fit(19.0, [2.0, 7.0, 4.0])  # it gains 1, 5 and 1


def test_the_trial_that_supports_a_fit_most_is_left_out():
    assert measures.fixed_leave_one_out_gain(PARENT, FIT) == pytest.approx(9.0 - 5.0)


class Trials:
    """Three trials that can be selected."""

    trials = (0, 1, 2)

    def subset(self, numbers):
        self.numbers = numbers
        return self


def test_both_fits_are_refitted_without_that_trial(monkeypatch):
    data = Trials()
    scales = []

    def refit(rest, hypothesis, starts, grid_points, width):
        scales.append(list(grid_points))
        return SimpleNamespace(log_evidence=2 * starts[0, 0])

    monkeypatch.setattr(measures, "fit_hypothesis", refit)
    gain = measures.refitted_leave_one_out_gain(data, PARENT, FIT)
    assert gain == pytest.approx(2 * 19.0 - 2 * 10.0)
    assert data.numbers == [0, 2]
    assert scales == [[0, 2], [0, 2]]


def test_a_sample_spans_trials_from_the_largest_misfit_to_the_least(monkeypatch):
    misfit_m = np.array([5.0, 1.0, 9.0, 2.0, 7.0, 3.0])
    monkeypatch.setattr(measures, "unexplained_tip_rms", lambda data, fit: misfit_m)
    assert measures.sample_by_misfit(None, None, 3) == [0, 1, 2]
    assert measures.sample_by_misfit(None, None, 2) == [1, 2]
    assert measures.sample_by_misfit(None, None, 8) == [0, 1, 2, 3, 4, 5]


def test_a_single_trial_gives_no_leave_one_out_support():
    data = SimpleNamespace(trials=(0,))
    alone = fit(1.0, [1.0]), fit(3.0, [3.0])
    assert measures.refitted_leave_one_out_gain(data, *alone) == -np.inf


def test_the_cross_validated_gain_excludes_the_trial_that_gains_most(monkeypatch):
    monkeypatch.setattr(
        measures,
        "predict_left_out_trials",
        lambda data, fit: fit.log_likelihood_by_trial,
    )
    monkeypatch.setattr(
        measures, "log_likelihood_gains", lambda without, with_it: with_it - without
    )
    assert measures.cross_validated_gain(None, PARENT, FIT) == pytest.approx(2.0)


def test_the_explained_fraction_is_of_the_larger_misfit():
    before, after = np.array([2.0, 1.0, 0.0]), np.array([1.0, 2.0, 0.0])
    fractions = measures.explained_fractions(before, after)
    assert fractions == pytest.approx([0.75, -0.75, 0.0])


@pytest.mark.parametrize(
    ("tolerance", "expected"),
    [(0.5, (0.75 - 0.75 + 0.0) / 3), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0)],
)
def test_trials_above_the_tolerance_have_equal_weight(tolerance, expected):
    before, after = np.array([2.0, 1.0, 0.5]), np.array([1.0, 2.0, 0.5])
    found = measures.mean_explained_fraction(before, after, tolerance)
    assert found == pytest.approx(expected)


def test_trials_within_the_tolerance_are_ignored_unless_all_are():
    before, after = np.array([4.0, 1.0]), np.array([2.0, 1.0])
    assert measures.mean_explained_fraction(before, after, 1.5) == pytest.approx(0.75)
    assert measures.mean_explained_fraction(before, after, 9.0) == pytest.approx(0.75)
    assert measures.mean_explained_fraction(before, after, 1.0) == pytest.approx(0.375)


@pytest.mark.parametrize("is_in_places", [True, False])
def test_a_cause_in_a_place_touches_trials_where_it_moves_the_tip(
    monkeypatch, is_in_places
):
    monkeypatch.setattr(measures, "is_position_dependent", lambda cause: is_in_places)
    hypothesis = SimpleNamespace(
        model=None,
        amplitude_indices=lambda cause: [1],
        exponents_from=lambda known: np.array([0.2, 0.5, 0.2]),
    )
    simulated = []
    data = SimpleNamespace(
        residuals=lambda model, chi: simulated.append(chi) or [np.zeros((1, 2))] * 3,
        tip_rms_by_trial=lambda shifts: np.array([[0.1], [0.3], [0.2]]),
    )
    one = SimpleNamespace(
        hypothesis=hypothesis,
        chi=np.array([0.7, 0.8, 0.9]),
        residuals=[np.zeros(2)] * 3,
    )
    touched = measures.trials_touched_by(data, one, None, 0.2)
    assert list(touched) == ([1] if is_in_places else [])
    if is_in_places:
        assert simulated[0] == pytest.approx(np.array([[0.7, 0.5, 0.9]]))
