"""Posterior probabilities in the slot of each cause, and swaps of look-alikes."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from synthetic_trials import CRITERIA

from stringcast.stages.diagnose import rules
from stringcast.stages.diagnose.evidence import agreement, posteriors, single_effect
from stringcast.stages.diagnose.evidence.background_effects import (
    Background,
    background_log_evidence_gains,
)
from stringcast.stages.diagnose.evidence.single_effect import SingleEffectPosterior
from stringcast.stages.diagnose.evidence.stand_ins import probability_by_shares
from stringcast.stages.diagnose.search import selection_state
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.diagnose.search.selection_step import SelectionStep
from stringcast.stages.diagnose.trials.prepared_data import RefinedFit
from stringcast.stages.inference.discrepancy_grid import (
    DISCREPANCY_SCALES_M,
    log_scale_prior,
)
from stringcast.stages.inference.likelihood import PRIOR_PRECISION


class Scaled:
    """Two trials whose residuals, divided by a size for each, are white."""

    def for_hypothesis(self, hypothesis: None) -> "Scaled":
        return self

    def whiten_by_trial(
        self, residuals: list[np.ndarray], sizes: np.ndarray
    ) -> list[np.ndarray]:
        return [each / size for each, size in zip(residuals, sizes, strict=True)]


@pytest.mark.parametrize("weights", [(1.0, 1.0), (0.5, 1.5)])
def test_the_evidence_with_background_is_that_of_a_dense_covariance(weights):
    """A trial with half the weight has twice the variance."""
    rng, sizes = np.random.default_rng(0), np.array([1.0, 3.0])
    slopes, small = (
        [rng.standard_normal((rows, 20)) * scale for _ in range(2)]
        for rows, scale in ((2, 1.0), (3, 1e3))
    )
    residuals = [rng.standard_normal(20) + 1e-3 * each[0] for each in small]
    fit = SimpleNamespace(
        hypothesis=None,
        residuals=residuals,
        slopes=slopes,
        grid_points=sizes,
        chi=np.zeros(2),
    )
    scale = np.repeat(sizes / np.sqrt(weights), 20)
    a, s, r = (
        np.concatenate(each, axis=-1) / scale for each in (slopes, small, residuals)
    )

    def log_density(size: float) -> float:
        covariance = np.eye(40) + a.T @ a / PRIOR_PRECISION + size**2 * s.T @ s
        return float(multivariate_normal(np.zeros(40), covariance).logpdf(r))

    scales_m = DISCREPANCY_SCALES_M[:9]
    by_size = np.array([log_density(size) for size in scales_m])
    expected = logsumexp(by_size + log_scale_prior()[:9]) - log_density(0.0)
    background = Background(small, scales_m)
    gain = background_log_evidence_gains(Scaled(), fit, background, np.array([weights]))
    assert gain == pytest.approx([expected], abs=1e-6)


def named_fit(name, *causes):
    hypothesis = SimpleNamespace(cause_names=causes, causes=causes)
    return SimpleNamespace(hypothesis=hypothesis, name=name)


class CorrectedAt(SimpleNamespace):
    """Prepared data that record the fits at which they were corrected."""

    def at(self, fit):
        return CorrectedAt(data=f"{self.data} {fit.name}")


def swap(monkeypatch, by_fit, fit):
    """Swap look-alikes with given posteriors for each fit."""
    monkeypatch.setattr(
        selection_state,
        "refine_fit",
        lambda prepared, fit: RefinedFit(prepared.at(fit), fit),
    )
    monkeypatch.setattr(
        posteriors,
        "find_background",
        lambda data, fit, effects, max_scale_m: f"small at {fit.name}",
    )
    monkeypatch.setattr(
        posteriors,
        "_single_effect_posteriors",
        lambda state, *rest: by_fit[state.fit.name],
    )
    state = SelectionState(CorrectedAt(data=""), fit)
    return posteriors.swap_lookalikes_until_stable(state, (), CRITERIA, 0)


def test_look_alikes_are_followed_each_with_its_own_numerical_error(monkeypatch):
    """Look-alikes replace causes, each with its own numerical error.

    First the second cause's look-alike is likelier, then no cause in the first slot.
    """
    fits = {
        "one": named_fit("one", "a", "x"),
        "two": named_fit("two", "b", "x"),
        "three": named_fit("three", "b"),
    }
    by_fit = {  # the last accepted cause first
        "one": [
            SingleEffectPosterior({"x": 1.0}, {}, None, None),
            SingleEffectPosterior(
                {"a": 0.02, "b": 0.98}, {"b": fits["two"]}, None, None
            ),
        ],
        "two": [
            SingleEffectPosterior({"x": 0.2, "": 0.8}, {}, fits["three"], None),
            None,
        ],
        "three": [SingleEffectPosterior({"b": 0.9, "": 0.1}, {}, None, None)],
    }
    settled = swap(monkeypatch, by_fit, fits["one"])
    assert settled.state.fit is fits["three"]
    assert settled.state.prepared.data == " two three"
    assert settled.background == "small at three"
    assert list(settled.by_cause) == by_fit["three"]


def test_swapped_look_alikes_end_with_posteriors_of_the_final_model(monkeypatch):
    """Here each of two look-alikes is likelier than the other when that is active."""
    fits = {name: named_fit(name, name) for name in "ab"}
    by_fit = {}
    for name, other in ("ab", "ba"):
        probabilities = {name: 0.02, other: 0.98}
        posterior = SingleEffectPosterior(
            probabilities, {other: fits[other]}, None, None
        )
        by_fit[name] = [posterior]
    settled = swap(monkeypatch, by_fit, fits["a"])
    name = settled.state.fit.name
    assert settled.background == f"small at {name}"
    (posterior,) = settled.by_cause
    assert posterior.credible_set(0.8) == (name,)


def test_a_cause_within_the_credible_set_is_not_replaced(monkeypatch):
    fit = named_fit("one", "a")
    posterior = SingleEffectPosterior({"a": 0.3, "b": 0.7}, {"b": None}, None, None)
    settled = swap(monkeypatch, {"one": [posterior]}, fit)
    assert settled.state.fit is fit
    assert settled.by_cause == (posterior,)


@pytest.mark.parametrize(
    ("none", "rival", "own", "kept"),
    [
        (0.44, 0.42, 0.14, "one"),  # it does not decide which one is active
        (0.44, 0.55, 0.01, "two"),
        (0.60, 0.30, 0.10, "empty"),
    ],
)
def test_a_cause_is_removed_only_if_its_slot_is_probably_empty(
    none, rival, own, kept, monkeypatch
):
    """No cause may be the most probable of many, but the slot probably has a cause."""
    fits = {
        "one": named_fit("one", "a"),
        "two": named_fit("two", "b"),
        "empty": named_fit("empty"),
    }
    probabilities = {"": none, "b": rival, "a": own}
    posterior = SingleEffectPosterior(
        probabilities, {"b": fits["two"]}, fits["empty"], None
    )
    by_fit = {key: [posterior] for key in fits}
    monkeypatch.setattr(
        posteriors, "with_most_probable_causes", lambda state, by_cause: state
    )
    assert swap(monkeypatch, by_fit, fits["one"]).state.fit is fits[kept]


@pytest.mark.parametrize(
    ("by_trial", "is_certain"),
    [
        ((20.0, 20.0, 20.0, 20.0), True),
        ((100.0, -6.0, -7.0, -7.0), False),
        ((80.0, 0.0, 0.0, 0.0), True),
    ],
)
def test_evidence_from_one_trial_against_the_others_is_not_certain(
    by_trial, is_certain, monkeypatch
):
    """The total gain is 80, which would be certain without the bootstrap."""
    posterior = posterior_of_wind(monkeypatch, by_trial, inside_range=True)
    assert sum(posterior.probabilities.values()) == pytest.approx(1.0)
    assert (posterior.probabilities["wind"] > 0.9) == is_certain


@pytest.mark.parametrize("inside_range", [True, False])
def test_a_rival_at_the_end_of_its_range_does_not_compete(inside_range, monkeypatch):
    """A rival whose optimum is beyond its range does not replace another cause."""
    posterior = posterior_of_wind(monkeypatch, (20.0,) * 4, inside_range)
    assert ("wind" in posterior.probabilities) == inside_range
    assert ("wind" in posterior.fits) == inside_range


def posterior_of_wind(monkeypatch, gain_by_trial, inside_range):
    """Compute the posterior of a slot with wind as only candidate; it gains 80."""
    monkeypatch.setattr(
        single_effect, "is_inside_range", lambda fit, cause: inside_range
    )
    return posterior_of_slot(monkeypatch, {"wind": (80.0, gain_by_trial)}, 1.0)


def posterior_of_slot(
    monkeypatch, gains, difference_m, error=0.0, unresolved=(), size_priors=None
):
    """Compute the posterior of a slot, with 1 m at each tip left unexplained.

    gains : in log evidence, and in log-likelihood of each trial, by effect
    difference_m : between the effects at each tip, and to their parent
    error : of the log evidence of the effects
    size_priors : of the effects by name, if they are not the same
    """
    sizes = dict.fromkeys(gains, 1.0) | (size_priors or {})
    monkeypatch.setattr(
        single_effect, "size_prior", lambda fit: sizes[fit.hypothesis.causes[0].name]
    )
    monkeypatch.setattr(
        single_effect,
        "background_log_evidence_gains",
        lambda data, fit, small, weights: np.zeros(len(weights)),
    )

    def shift_m(data, one, fit):
        return np.full(4, 0.0 if one is fit else difference_m)

    for module in (rules, single_effect):
        monkeypatch.setattr(module, "tip_shift_rms", shift_m)
        monkeypatch.setattr(module, "unexplained_tip_rms", lambda *_: np.ones(4))

    def slot(name, log_evidence, by_trial, error):
        return SimpleNamespace(
            log_evidence=log_evidence,
            log_evidence_error=error,
            log_likelihood_by_trial=np.array(by_trial),
            hypothesis=SimpleNamespace(causes=(SimpleNamespace(name=name),)),
            has_diverged=False,
        )

    parent = slot("", 0.0, (0.0,) * 4, 0.0)
    fits = [slot(name, *gain, error) for name, gain in gains.items()]
    resolved = [fit for fit in fits if fit.hypothesis.causes[0].name not in unresolved]
    unresolved = [fit for fit in fits if fit not in resolved]
    rng = np.random.default_rng(0)
    weights = 4 * rng.dirichlet(np.ones(4), single_effect.BOOTSTRAP_SAMPLES)
    step = SelectionStep(None, parent, (), resolved, unresolved=unresolved)
    return single_effect.single_effect_posterior(step, (), weights, 20, CRITERIA)


@pytest.mark.parametrize(("difference_m", "share"), [(0.9, 0.5), (1.1, 0.0)])
def test_effects_that_differ_by_less_than_the_misfit_are_equally_probable(
    difference_m, share, monkeypatch
):
    """By evidence alone wind would be certain; it still ranks first."""
    monkeypatch.setattr(single_effect, "is_inside_range", lambda fit, cause: True)
    gains = {"tilt": (60.0, (15.0,) * 4), "wind": (80.0, (20.0,) * 4)}
    posterior = posterior_of_slot(monkeypatch, gains, difference_m)
    assert posterior.probabilities["tilt"] == pytest.approx(share, abs=1e-6)
    assert sum(posterior.probabilities.values()) == pytest.approx(1.0)
    assert posterior.ranked_causes[0] == "wind"


def test_an_effect_of_common_size_has_more_of_the_probability_of_look_alikes(
    monkeypatch,
):
    """Wind has the higher evidence, but the misfit may be just this difference."""
    monkeypatch.setattr(single_effect, "is_inside_range", lambda fit, cause: True)
    gains = {"tilt": (60.0, (15.0,) * 4), "wind": (80.0, (20.0,) * 4)}
    sizes = {"tilt": 0.6, "wind": 0.2}
    alike = posterior_of_slot(monkeypatch, gains, 0.9, size_priors=sizes)
    assert alike.probabilities["tilt"] == pytest.approx(0.75, abs=1e-6)
    assert alike.probabilities["wind"] == pytest.approx(0.25, abs=1e-6)
    distinct = posterior_of_slot(monkeypatch, gains, 1.1, size_priors=sizes)
    assert distinct.probabilities["wind"] == pytest.approx(1.0, abs=1e-6)


def test_an_unresolved_effect_is_as_probable_as_the_best(monkeypatch):
    """It is not more probable than the best resolved effect."""
    monkeypatch.setattr(single_effect, "is_inside_range", lambda fit, cause: True)
    gains = {
        "softening": (90.0, (22.5,) * 4),
        "tilt": (60.0, (15.0,) * 4),
        "wind": (80.0, (20.0,) * 4),
    }
    posterior = posterior_of_slot(monkeypatch, gains, 1.1, unresolved=["softening"])
    assert posterior.probabilities["softening"] == pytest.approx(0.5, abs=1e-6)
    assert posterior.probabilities["wind"] == pytest.approx(0.5, abs=1e-6)
    assert posterior.ranked_causes[0] == "wind"
    assert set(posterior.fits) == {*gains}


@pytest.mark.parametrize(("error", "share"), [(0.0, 0.0), (20.0, 0.24)])
def test_rivals_that_differ_by_less_than_their_errors_share_probability(
    error, share, monkeypatch
):
    """A difference of 20 with an error of 28 has the wrong sign in a quarter."""
    monkeypatch.setattr(single_effect, "is_inside_range", lambda fit, cause: True)
    gains = {"dry": (200.0, (50.0,) * 4), "worn": (180.0, (45.0,) * 4)}
    posterior = posterior_of_slot(monkeypatch, gains, 1.1, error)
    assert posterior.probabilities["worn"] == pytest.approx(share, abs=0.1)
    assert (posterior.probabilities["worn"] > 0.1) == (error > 0)


SET_AND_SOFTENING = ({"set": 0.7, "tilt": 0.3}, {"softening": 0.9, "play": 0.1})


@pytest.mark.parametrize(
    ("probabilities", "evidence", "causes"),
    [
        (SET_AND_SOFTENING, 5.0, ("set", "softening")),
        (SET_AND_SOFTENING, -5.0, ("tilt", "play")),
        (
            ({"set": 0.3, "tilt": 0.7}, {"softening": 0.9, "play": 0.1}),
            5.0,
            ("tilt", "softening"),
        ),
        (
            ({"set": 0.3, "tilt": 0.7}, {"softening": 0.1, "play": 0.9}),
            5.0,
            ("tilt", "play"),
        ),
        # an effect cannot be in both slots
        (
            ({"play": 0.6, "tilt": 0.4}, {"softening": 0.1, "play": 0.9}),
            5.0,
            ("tilt", "play"),
        ),
        (
            ({"": 0.6, "tilt": 0.4}, {"softening": 0.9, "play": 0.1}),
            5.0,
            ("tilt", "play"),
        ),
    ],
)
def test_the_likeliest_effects_replace_causes_if_their_joint_evidence_is_higher(
    probabilities, evidence, causes, monkeypatch
):
    """They replace a tilt and a play without evidence."""

    def fit(*causes, evidence=0.0):
        hypothesis = SimpleNamespace(base=None, causes=causes, cause_names=causes)
        hypothesis.exponents_from = lambda known: np.zeros(1)
        return SimpleNamespace(
            hypothesis=hypothesis,
            exponents={},
            grid_points=None,
            log_evidence=evidence,
        )

    def fitted(data, hypothesis, *given):
        return fit(*hypothesis.causes, evidence=evidence)

    def hypothesis(base, causes):
        return fit(*causes).hypothesis

    monkeypatch.setattr(posteriors, "Hypothesis", hypothesis)
    monkeypatch.setattr(posteriors, "fit_hypothesis", fitted)
    monkeypatch.setattr(selection_state, "refine_fit", RefinedFit)
    by_cause = []
    for each in probabilities:
        fits = {name: fit("other", name) for name in each if name}
        by_cause.append(SingleEffectPosterior(each, fits, fit(), None))
    state = SelectionState(SimpleNamespace(data=None), fit("tilt", "play"))
    likeliest = posteriors.with_most_probable_causes(state, by_cause)
    assert likeliest.fit.hypothesis.causes == causes


def limit_slot(
    monkeypatch, probabilities, log_bayes_factor, misfit_probability, share=1.0
):
    """Limit the probabilities of one slot with 50 candidates by agreement of trials.

    share: share of the misfit that the cause explains in each trial.
    """
    monkeypatch.setattr(
        agreement, "log_bayes_factor_of_trials", lambda *given: log_bayes_factor
    )
    monkeypatch.setattr(agreement, "trials_touched_by", lambda *given: np.zeros(0))
    cause = SimpleNamespace(name="a")
    data = SimpleNamespace(trials=[1, 2], random_effects={})
    state = SimpleNamespace(
        prepared=SimpleNamespace(data=data),
        fit=SimpleNamespace(hypothesis=SimpleNamespace(causes=(cause,))),
        left_out_exponents=None,
    )
    monkeypatch.setattr(
        posteriors, "explained_shares", lambda *given: np.full(2, share)
    )
    slot = SingleEffectPosterior(probabilities, {"a": None}, None, None)
    given = posteriors.Posteriors(state, None, (slot,))
    found = posteriors.limit_by_agreement(given, misfit_probability, 50, 1e-3)
    return found.by_cause[0].probabilities


def test_the_agreement_of_trials_limits_probabilities_if_misfit_remains(
    monkeypatch,
):
    """The odds are the trials' Bayes factor times the prior odds of one cause."""
    certain = {"a": 0.9, "b": 0.1, "": 0.0}
    there = 0.75 * probability_by_shares(np.ones(2))
    found = limit_slot(monkeypatch, certain, np.log(150), 1.0)
    assert found == pytest.approx({"a": 0.9 * there, "b": 0.1 * there, "": 1 - there})

    halfway = limit_slot(monkeypatch, certain, np.log(150), 0.5)
    assert halfway[""] == pytest.approx((1 - there) / 2)


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
def test_the_probability_of_a_stand_in_limits_that_of_a_cause(monkeypatch, share):
    """Something outside the library may have the same effect in all trials."""
    found = limit_slot(monkeypatch, {"a": 1.0, "": 0.0}, 30.0, 1.0, share)
    assert found["a"] == pytest.approx(probability_by_shares(np.array([share])))


@pytest.mark.parametrize(("log_bayes_factor", "misfit"), [(-3.0, 0.0), (30.0, 1.0)])
def test_probabilities_are_unchanged_without_misfit_or_below_the_limit(
    monkeypatch, log_bayes_factor, misfit
):
    given = {"a": 0.8, "": 0.2}
    found = limit_slot(monkeypatch, given, log_bayes_factor, misfit)
    assert found == pytest.approx(given)


def test_without_a_cause_the_posterior_is_that_of_the_last_step(monkeypatch):
    """An earlier step may have accepted a cause that was dropped later."""
    monkeypatch.setattr(
        posteriors, "single_effect_posterior", lambda step, *given: step
    )
    state = SelectionState(
        prepared=SimpleNamespace(data=SimpleNamespace(trials=(0, 1))),
        fit=SimpleNamespace(hypothesis=SimpleNamespace(causes=())),
        steps=("entered", "none"),
    )
    criteria = SimpleNamespace(tip_tolerance_m=1e-3)
    found = posteriors._single_effect_posteriors(state, (), (), criteria, seed=0)
    assert list(found) == ["none"]


def test_the_inclusion_probability_is_that_of_any_slot():
    slots = [
        SingleEffectPosterior({"wind": 0.5, "": 0.5}, {}, None, None),
        SingleEffectPosterior({"wind": 0.4, "tip_mass": 0.2, "": 0.4}, {}, None, None),
    ]
    found = single_effect.inclusion_probabilities(slots)
    assert found == pytest.approx({"wind": 0.7, "tip_mass": 0.2})


@pytest.mark.parametrize(
    ("best", "accepted", "cause", "solutions", "is_known"),
    [
        (None, False, "b", 1, False),
        (("a", "c"), True, "b", 1, False),
        (("a", "b"), False, "b", 1, False),
        (("a", "b"), True, "b", 1, True),
        (("a", "b"), True, "b", 2, False),  # the fit has moved
        (("a", "b"), True, "a", 1, False),  # it was compared without the other cause
    ],
)
def test_the_comparison_at_acceptance_is_reused_for_the_last_cause(
    best, accepted, cause, solutions, is_known, monkeypatch
):
    others = SimpleNamespace(
        with_cause=lambda cause: SimpleNamespace(exponents_from=lambda known: None)
    )
    hypothesis = SimpleNamespace(
        causes=("a", "b"),
        cause_names=("a", "b"),
        without_cause=lambda cause: others,
        exponents_from=lambda known: None,
    )
    fit = best and SimpleNamespace(
        hypothesis=SimpleNamespace(cause_names=best), exponents={}
    )
    first = SimpleNamespace(best=None, accepted=False)
    last = SimpleNamespace(best=fit, accepted=accepted)
    state = SimpleNamespace(
        steps=(first, last),
        fit=SimpleNamespace(hypothesis=hypothesis, exponents={}),
        prepared=SimpleNamespace(data=None, base_fit=None),
    )
    fitted = SimpleNamespace(log_evidence=0.0)
    for name in ("evaluate_fit", "refit"):
        monkeypatch.setattr(posteriors, name, lambda *given: fitted)
    monkeypatch.setattr(posteriors, "distinct_fits", lambda fits: fits[:solutions])
    monkeypatch.setattr(posteriors, "compare_candidates", lambda *given: "compared")
    found = posteriors._compare_alternatives(state, cause, (), None, 0)
    assert found is (last if is_known else "compared")


@pytest.mark.parametrize("better", ["with the cause", "base"])
def test_a_fit_without_a_cause_is_the_better_of_two_starts(better, monkeypatch):
    """The parameters with the cause may be a poor start without it."""
    others = SimpleNamespace(
        with_cause=lambda cause: SimpleNamespace(exponents_from=lambda known: None)
    )
    hypothesis = SimpleNamespace(causes=("a", "b"), without_cause=lambda cause: others)
    starts = {}
    for name in ("with the cause", "base"):
        starts[name] = SimpleNamespace(name=name, hypothesis=hypothesis, exponents={})
    state = SimpleNamespace(
        fit=starts["with the cause"],
        prepared=SimpleNamespace(data=None, base_fit=starts["base"]),
    )

    def refit(data, fit, hypothesis):
        return SimpleNamespace(name=fit.name, log_evidence=float(fit.name == better))

    def compare(prepared, parent, *given):
        return parent.name

    monkeypatch.setattr(posteriors, "evaluate_fit", lambda *given: None)
    monkeypatch.setattr(posteriors, "refit", refit)
    monkeypatch.setattr(posteriors, "compare_candidates", compare)
    assert posteriors._compare_alternatives(state, "a", (), None, 0) == better
