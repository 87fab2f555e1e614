"""Comparison of fits, and acceptance and removal of causes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ordinary
from synthetic_trials import CRITERIA

from stringcast.stages.diagnose import rules
from stringcast.stages.diagnose.evidence import agreement, measures
from stringcast.stages.diagnose.search import (
    confirmation,
    forward_selection,
    selection_state,
)
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.diagnose.search.selection_step import SelectionStep
from stringcast.stages.diagnose.trials.prepared_data import RefinedFit
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.model.library import effects_by_name


def fit_with(*causes):
    """Return a stand-in for a fit with these causes; each adds evidence."""
    hypothesis = SimpleNamespace(
        base=None, causes=causes, cause_names=tuple(cause.name for cause in causes)
    )
    hypothesis.without_cause = lambda cause: (
        fit_with(*(other for other in causes if other is not cause)).hypothesis
    )
    hypothesis.with_cause = lambda cause: fit_with(*causes, cause).hypothesis
    hypothesis.exponents_from = lambda known: np.zeros(0)
    return SimpleNamespace(
        hypothesis=hypothesis,
        log_evidence=100.0 * len(causes),
        exponents={},
        grid_points=None,
        chi=None,
        width=None,
    )


def refit_stand_in(data, fit, hypothesis):
    """Return a stand-in for the refit of a hypothesis to any data."""
    return fit_with(*hypothesis.causes)


@pytest.mark.parametrize(
    ("gains", "is_accepted"),
    [((76.0, 41.0), True), ((150.0, -5.0), False), ((150.0, 4.0), False)],
)
def test_a_cause_is_accepted_if_each_trial_predicts_the_other(
    gains, is_accepted, monkeypatch
):
    """Without it, one trial is explained at the cost of the other."""
    parent = SimpleNamespace(
        log_evidence=0.0, log_likelihood_by_trial=np.zeros(2), gains=(0.0, 0.0)
    )
    fit = SimpleNamespace(
        log_evidence=122.0,
        log_likelihood_by_trial=np.array([-9.0, 135.0]),
        gains=gains,
        has_diverged=False,
        hypothesis=SimpleNamespace(causes=(None, "slip")),
    )

    def predict(data, fit):
        return [SimpleNamespace(log_likelihood=gain) for gain in fit.gains]

    def touched(*given):
        return np.zeros(0)

    monkeypatch.setattr(rules, "tip_shift_rms", lambda *given: np.full(2, 0.06))
    monkeypatch.setattr(rules, "trials_touched_by", touched)
    monkeypatch.setattr(rules, "refitted_leave_one_out_gain", lambda *given: -1.0)
    monkeypatch.setattr(measures, "predict_left_out_trials", predict)
    data = SimpleNamespace(trials=range(2))
    assert rules.is_supported(data, parent, fit, CRITERIA) is is_accepted


@pytest.mark.parametrize(
    ("gains", "remaining"),
    [
        ([353.5, 265.4, 128.9, -22785.6, -225.6], ("wind",)),
        ([-353.5, -265.4, -128.9, 22785.6, 225.6], ()),
    ],
)
def test_one_trial_does_not_decide_which_causes_are_set_aside(
    gains, remaining, monkeypatch
):
    """One chaotic trial is predicted badly: its log-likelihood falls by 23,000."""
    wind = SimpleNamespace(name="wind")
    trials = [SimpleNamespace(name=f"t{k}") for k in range(5)]
    prepared = SimpleNamespace(data=SimpleNamespace(trials=trials))
    log_likelihoods = {(): np.zeros(5), ("wind",): np.array(gains)}

    def predict(data, fit):
        values = log_likelihoods[fit.hypothesis.cause_names]
        return [SimpleNamespace(log_likelihood=value) for value in values]

    def touched(*given):
        return np.zeros(0)

    monkeypatch.setattr(confirmation, "is_inside_range", lambda *_: True)
    monkeypatch.setattr(confirmation, "unexplained_tip_rms", lambda *_: np.zeros(2))
    monkeypatch.setattr(confirmation, "trials_touched_by", touched)
    monkeypatch.setattr(confirmation, "refit", refit_stand_in)
    monkeypatch.setattr(selection_state, "refine_fit", RefinedFit)
    monkeypatch.setattr(selection_state, "predict_left_out_trials", predict)
    monkeypatch.setattr(confirmation, "predict_trials", predict)
    monkeypatch.setattr(confirmation, "tip_errors", lambda *_: np.zeros(5))
    monkeypatch.setattr(confirmation, "mean_explained_fraction", lambda *_: 0.9)
    state = SelectionState(prepared, fit_with(wind))
    state = confirmation.drop_unconfirmed_causes(state, CRITERIA, 10)
    assert state.fit.hypothesis.cause_names == remaining


@pytest.mark.parametrize(
    ("trials", "touched", "words"),
    [(2, [], ""), (3, [], "do not agree"), (2, [1], "one trial")],
)
def test_a_cause_is_set_aside_with_the_reason(trials, touched, words, monkeypatch):
    """Two trials are too few to disagree."""
    wind = SimpleNamespace(name="wind")
    data = SimpleNamespace(trials=range(trials))
    state = SelectionState(SimpleNamespace(data=data), fit_with(wind))
    monkeypatch.setattr(SelectionState, "left_out_exponents", None)
    stand_ins = {
        "is_inside_range": True,
        "trials_touched_by": touched,
        "_predicts_trials": True,
        "unexplained_tip_rms": np.ones(1),
        "probability_by_agreement": 0.3,
    }
    for name, answer in stand_ins.items():
        monkeypatch.setattr(confirmation, name, lambda *given, answer=answer: answer)
    reason = confirmation._reason_to_set_aside(state, state, wind, CRITERIA, 10)
    assert words in reason
    assert bool(words) == bool(reason)


@pytest.mark.parametrize(
    ("unconfirmed", "remaining"),
    [(["wind"], ("set",)), (["wind", "set"], ("lag",)), (["wind", "set", "lag"], ())],
)
def test_a_confirmed_rival_replaces_a_cause_that_is_set_aside(
    unconfirmed, remaining, monkeypatch
):
    """Of causes with similar evidence, the one that all trials confirm is kept."""
    wind, set_, lag = (SimpleNamespace(name=name) for name in ("wind", "set", "lag"))
    prepared = SimpleNamespace(data=SimpleNamespace(trials=range(5)))
    compared = [fit_with(wind), fit_with(set_), fit_with(lag)]
    step = SelectionStep(
        prepared.data, fit_with(), (), compared, compared, accepted=True
    )

    def reason(state, without, cause, *given):
        return "the trials do not agree on it" if cause.name in unconfirmed else ""

    monkeypatch.setattr(confirmation, "_reason_to_set_aside", reason)
    monkeypatch.setattr(confirmation, "refit", refit_stand_in)
    monkeypatch.setattr(
        confirmation,
        "fit_hypothesis",
        lambda data, hypothesis, *_: fit_with(*hypothesis.causes),
    )
    monkeypatch.setattr(selection_state, "refine_fit", RefinedFit)
    state = SelectionState(prepared, fit_with(wind), [step])
    state = confirmation.drop_unconfirmed_causes(state, CRITERIA, 10)
    assert state.fit.hypothesis.cause_names == remaining
    assert list(state.set_aside) == ["wind"]
    assert state.replaced == ((wind,) if remaining else ())


@pytest.mark.parametrize(
    ("touched", "misfit_m", "remaining"),
    [
        ([2], 5e-3, ()),
        ([2], 1e-3, ("contact",)),  # no misfit remains
        ([1, 2], 5e-3, ("contact",)),
    ],
)
def test_a_contact_in_one_trial_is_set_aside_if_misfit_remains(
    touched, misfit_m, remaining, monkeypatch
):
    """A contact in one of three trials stood for an attraction, at 0.99."""
    contact = SimpleNamespace(name="contact")
    trials = [SimpleNamespace(name=f"t{k}") for k in range(3)]
    data = SimpleNamespace(trials=trials, random_effects={})
    prepared = SimpleNamespace(data=data)

    def predict(data, fit):
        return [SimpleNamespace(chi=np.zeros(1)) for _ in trials]

    monkeypatch.setattr(confirmation, "refit", refit_stand_in)
    monkeypatch.setattr(selection_state, "refine_fit", RefinedFit)
    monkeypatch.setattr(confirmation, "is_inside_range", lambda *given: True)
    monkeypatch.setattr(selection_state, "predict_left_out_trials", predict)
    monkeypatch.setattr(confirmation, "_predicts_trials", lambda *given: True)
    monkeypatch.setattr(
        confirmation, "unexplained_tip_rms", lambda *given: np.full(3, misfit_m)
    )
    for module in (confirmation, agreement):
        monkeypatch.setattr(module, "trials_touched_by", lambda *given: touched)
    monkeypatch.setattr(agreement, "log_bayes_factor_of_trials", lambda *given: 20.0)
    state = SelectionState(prepared, fit_with(contact))
    state = confirmation.drop_unconfirmed_causes(state, CRITERIA, 10)
    assert state.fit.hypothesis.cause_names == remaining
    assert list(state.set_aside) == ([] if remaining else ["contact"])


@pytest.mark.parametrize(
    ("evidence", "shift_m", "reason"),
    [
        (50.0, 1.2e-3, "small: it moves the tip by 1.2 mm, less than the tolerance"),
        (50.0, 3e-3, None),  # large enough, but refused for another reason
        (1.0, 1.2e-3, None),  # not evident
    ],
)
def test_an_evident_cause_below_the_tolerance_is_set_aside(
    evidence, shift_m, reason, monkeypatch
):
    shift = np.array([0.0, shift_m])
    monkeypatch.setattr(confirmation, "tip_shift_rms", lambda *_: shift)
    monkeypatch.setattr(confirmation, "is_large_enough", lambda *_: shift_m > 2e-3)
    parent = SimpleNamespace(log_evidence=0.0)
    hypothesis = SimpleNamespace(cause_names=("wind",))
    best = SimpleNamespace(log_evidence=evidence, hypothesis=hypothesis)
    step = SelectionStep(None, parent, (), (best,))
    state = SelectionState(SimpleNamespace(data=None), parent, (step,))
    state = forward_selection._set_aside_if_small(state, step, CRITERIA)
    assert state.set_aside == ({"wind": reason} if reason else {})


@pytest.mark.parametrize(
    ("misfit_m", "further", "reason", "found"),
    [
        (5e-3, True, "", ("offset", "angle")),
        (5e-3, True, "not confirmed", ()),
        (5e-3, False, "", ()),  # no further cause is accepted
        (1e-3, True, "", ()),  # no misfit is left
    ],
)
def test_a_small_cause_does_not_hide_a_larger_one(
    misfit_m, further, reason, found, monkeypatch
):
    """A clock offset of 0.7 ms was more evident than a turned grasp.

    It stays in the model with the grasp but is not named.
    """
    offset = SimpleNamespace(name="offset")
    angle = SimpleNamespace(name="angle")

    def compare(prepared, parent, effects, criteria, seed):
        causes = parent.hypothesis.causes
        if angle in causes:
            return SelectionStep(None, parent, (), ())
        added = angle if offset in causes else offset
        best = fit_with(*causes, added)
        return SelectionStep(
            None, parent, (), (best,), accepted=added is angle and further
        )

    def shift_m(data, one, other):
        has_angle = [angle in fit.hypothesis.causes for fit in (one, other)]
        return np.array([5e-3 if has_angle[0] != has_angle[1] else 1.3e-3])

    def add(state, best, *given):
        return replace(state, fit=best)

    monkeypatch.setattr(forward_selection, "compare_candidates", compare)
    monkeypatch.setattr(forward_selection, "add_cause", add)
    monkeypatch.setattr(
        forward_selection, "evaluate_fit", lambda data, *given: fit_with()
    )
    for module in (confirmation, selection_state):
        monkeypatch.setattr(module, "refit", refit_stand_in)
    monkeypatch.setattr(selection_state, "refine_fit", RefinedFit)
    monkeypatch.setattr(forward_selection, "is_evident", lambda *given: True)
    monkeypatch.setattr(confirmation, "_reason_to_set_aside", lambda *given: reason)
    monkeypatch.setattr(confirmation, "Hypothesis", lambda base: fit_with().hypothesis)
    for module in (confirmation, rules):
        monkeypatch.setattr(module, "tip_shift_rms", shift_m)
    for module in (forward_selection, rules):
        monkeypatch.setattr(
            module, "unexplained_tip_rms", lambda *given: np.array([misfit_m])
        )
    state = SelectionState(SimpleNamespace(data=None), fit_with())
    *_, state = forward_selection.select_causes(state, (), CRITERIA, 0, 2)
    assert state.fit.hypothesis.cause_names == found
    assert [cause.name for cause in state.nameable_causes] == list(found[1:])
    small = "small: it moves the tip by 1.3 mm, less than the tolerance"
    unconfirmed = {"angle": reason} if reason else {}
    assert state.set_aside == {"offset": small} | unconfirmed


@pytest.mark.parametrize("is_at_end", [True, False])
def test_the_search_goes_on_without_a_cause_at_the_end_of_its_range(
    is_at_end, monkeypatch
):
    """A wind of 5 m/s stood in for the set of a strip, and was dropped."""
    wind, rest = SimpleNamespace(name="wind"), SimpleNamespace(name="set")

    def compare(prepared, parent, effects, criteria, seed):
        if parent.hypothesis.causes:
            return SelectionStep(None, parent, (), ())
        best = fit_with(effects[0])
        return SelectionStep(None, parent, (), (best,), accepted=True)

    def drop(state, criteria, candidates):
        if wind not in state.fit.hypothesis.causes:
            return state
        reason = confirmation.AT_RANGE_END if is_at_end else "not confirmed"
        return replace(state, fit=fit_with(), set_aside={"wind": reason})

    def add(state, best, *given):
        return replace(state, fit=best)

    def keep(state, *given):
        return state

    monkeypatch.setattr(forward_selection, "compare_candidates", compare)
    monkeypatch.setattr(forward_selection, "drop_unconfirmed_causes", drop)
    monkeypatch.setattr(forward_selection, "add_cause", add)
    monkeypatch.setattr(forward_selection, "exchange_two_causes", keep)
    monkeypatch.setattr(forward_selection, "drop_redundant_causes", keep)
    monkeypatch.setattr(forward_selection, "evaluate_fit", lambda *given: fit_with())
    monkeypatch.setattr(
        forward_selection, "_is_evident_but_small", lambda *given: False
    )
    state = SelectionState(SimpleNamespace(data=None), fit_with())
    *_, state = forward_selection.select_causes(state, (wind, rest), CRITERIA, 0, 2)
    assert state.fit.hypothesis.cause_names == (("set",) if is_at_end else ())
    assert [*state.set_aside] == ["wind"]


def test_an_added_cause_is_no_longer_set_aside(monkeypatch):
    """Dry friction in a cable was both named and set aside."""
    slip, offset = SimpleNamespace(name="slip"), SimpleNamespace(name="offset")
    monkeypatch.setattr(selection_state, "refine_fit", RefinedFit)
    reasons = {"slip": "too few trials", "offset": "small", "drift": "too few trials"}
    state = SelectionState(None, fit_with(offset), set_aside=reasons)
    state = selection_state.with_fit(state, fit_with(offset, slip))
    assert [*state.set_aside] == ["offset", "drift"]  # a small cause is in the fit


@pytest.mark.parametrize(("gain", "is_taken"), [(17.7, True), (0.5, False)])
def test_a_better_fit_without_a_further_cause_replaces_the_state(
    gain, is_taken, monkeypatch
):
    hypothesis = SimpleNamespace(cause_names=())
    fit = SimpleNamespace(log_evidence=100.0, hypothesis=hypothesis)
    moved = SimpleNamespace(
        log_evidence=100.0 + gain, hypothesis=hypothesis, chi=None, width=None
    )
    step = SelectionStep(None, moved, (), ())
    monkeypatch.setattr(forward_selection, "compare_candidates", lambda *given: step)
    monkeypatch.setattr(forward_selection, "evaluate_fit", lambda *given: moved)
    monkeypatch.setattr(selection_state, "refine_fit", RefinedFit)
    state = SelectionState(SimpleNamespace(data=None), fit)
    state = forward_selection._add_step(state, (), CRITERIA, 0)
    assert state.fit is (moved if is_taken else fit)


def test_known_causes_start_at_the_same_values_in_other_ranges(arm, monkeypatch):
    """With a further trial, the data may require a wider range."""
    wind = effects_by_name()["wind"]
    base = ordinary(arm)
    found = Hypothesis(base, (wind,))
    (stiffness,) = [p for p in base.parameters if p.name == "bending_stiffness"]
    wider = base.with_ranges(replace(stiffness, high=30 * stiffness.high))

    def fit(data, hypothesis, starts, grid_points):
        started.append((hypothesis, starts[0]))

    started = []
    monkeypatch.setattr(selection_state, "fit_hypothesis", fit)
    monkeypatch.setattr(selection_state, "add_cause", lambda *given: None)
    chi = np.linspace(0.2, 0.8, len(found.parameters))
    before = Fit(found, chi, (), (), None, None, np.zeros(0), 0.0)
    base_fit = SimpleNamespace(hypothesis=Hypothesis(wider), grid_points=None)
    prepared = SimpleNamespace(base_fit=base_fit, data=None)
    state = SelectionState(None, before)
    selection_state.with_causes_found_before(prepared, state, CRITERIA, 0, 2)
    ((hypothesis, start),) = started
    after = replace(before, hypothesis=hypothesis, chi=start)
    assert after.values == pytest.approx(before.values)
    assert not np.allclose(start, chi)


@pytest.mark.parametrize("own_evidence", [50.0, -50.0])
def test_another_string_is_compared_with_its_own_numerical_error(
    own_evidence, monkeypatch
):
    """Data corrected at another string's numerical error favour that string."""

    def fit_at(distance, log_evidence):
        residuals = [np.full(4, distance)]
        return SimpleNamespace(
            residuals=residuals, log_evidence=log_evidence, hypothesis=None
        )

    fit, found = fit_at(1.0, 0.0), fit_at(9.0, -900.0)
    evidence_of = {id(fit): 1.0, id(found): own_evidence}

    def refine(prepared, start):
        refined = SimpleNamespace(log_evidence=evidence_of[id(start)])
        return RefinedFit(prepared, refined)

    monkeypatch.setattr(selection_state, "search_other_strings", lambda *given: None)
    monkeypatch.setattr(selection_state, "evaluate_fit", lambda *given: found)
    monkeypatch.setattr(selection_state, "refine_fit", refine)
    better = selection_state._refine_from_other_strings(
        SimpleNamespace(data=None), fit, None, 4
    )
    assert better.fit.log_evidence == max(own_evidence, 1.0)


@pytest.mark.parametrize("corrected_evidence", [3.0, -30.0])
def test_other_values_of_a_cause_are_taken_only_with_their_own_numerical_error(
    corrected_evidence, monkeypatch
):
    """They were found in data corrected with the numerical error of others."""
    hypothesis = SimpleNamespace(cause_names=("wind",))
    first, found, corrected = (
        SimpleNamespace(log_evidence=evidence, hypothesis=hypothesis, grid_points=None)
        for evidence in (0.0, 5.0, corrected_evidence)
    )
    prepared = SimpleNamespace(data=None)

    def correct(prepared, fit):
        return RefinedFit(prepared, corrected if fit is found else fit)

    monkeypatch.setattr(selection_state, "correct_discretisation_once", correct)
    monkeypatch.setattr(
        selection_state, "alternative_parameter_starts", lambda *given: np.ones((1, 1))
    )
    monkeypatch.setattr(selection_state, "fit_hypothesis", lambda *given: found)
    refined = selection_state.refine_fit(prepared, first)
    assert refined.fit is (corrected if corrected_evidence > 0 else first)
