"""Each rule passes at its limit and fails just beyond it; the rules act in order.

Fits are replaced by the numbers that a rule uses.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic_trials import CRITERIA

from stringcast.stages.diagnose import rules, verdict
from stringcast.stages.diagnose.evidence.single_effect import SingleEffectPosterior
from stringcast.stages.diagnose.rules import VerdictNumbers

LIMIT = CRITERIA.min_log_bayes_factor
TOLERANCE_M = CRITERIA.tip_tolerance_m
SLIGHTLY_LESS = 1 - 1e-9
SLIGHTLY_MORE = 1 + 1e-9


def fit_of(log_evidence=0.0, **more):
    hypothesis = SimpleNamespace(causes=("first", "second", "last"))
    values = {"has_diverged": False, "hypothesis": hypothesis, **more}
    return SimpleNamespace(log_evidence=log_evidence, **values)


def test_limits_follow_from_the_settings():
    assert pytest.approx(np.log(100)) == LIMIT
    assert CRITERIA.deciding_log_odds == pytest.approx(np.log(19))


def test_a_trial_is_resolved_to_the_tolerance_or_as_well_as_the_worst_before():
    before = np.array([1e-4, 1e-4])
    at, above = TOLERANCE_M, SLIGHTLY_MORE * TOLERANCE_M
    assert rules.is_resolved(np.array([at, at]), before, CRITERIA, 2)
    assert not rules.is_resolved(np.array([at, above]), before, CRITERIA, 2)
    assert rules.is_resolved(np.array([at, above]), before, CRITERIA, 1)
    poor = np.array([1e-4, 8e-3])
    assert rules.is_resolved(np.array([8e-3, 8e-3]), poor, CRITERIA, 2)
    assert not rules.is_resolved(np.array([8e-3, 9e-3]), poor, CRITERIA, 2)
    allowed_m = np.array([0.0, 9e-3])
    assert rules.is_resolved(np.array([8e-3, 9e-3]), poor, CRITERIA, 2, allowed_m)


@pytest.mark.parametrize(
    ("uncertainty_mm", "misfit_mm", "unresolved_mm"),
    [
        ((2.0,), (0.0,), 0.0),
        ((2.1,), (0.0,), 2.1),
        ((2.1, 2.0), (0.0, 0.0), 2.1),  # two are needed
        ((9.0, 2.0, 2.0), (0.0, 0.0, 0.0), 0.0),
        ((9.0,), (28.0,), 9.0),  # a tenth of the mean square is 8.9 mm
        ((9.0,), (29.0,), 0.0),
    ],
)
def test_simulation_resolves_two_trials_or_the_only_one(
    uncertainty_mm, misfit_mm, unresolved_mm
):
    uncertainty_m = 1e-3 * np.array(uncertainty_mm)
    misfit_m = 1e-3 * np.array(misfit_mm)
    found_m = rules.unresolved_by_simulation(uncertainty_m, misfit_m, CRITERIA)
    assert found_m == pytest.approx(1e-3 * unresolved_mm)


def test_evidence_is_sufficient_from_its_limit_on():
    parent = fit_of(7.0)
    assert rules.has_evidence(parent, fit_of(7.0 + SLIGHTLY_MORE * LIMIT), CRITERIA)
    weaker = fit_of(7.0 + SLIGHTLY_LESS * LIMIT)
    assert not rules.has_evidence(parent, weaker, CRITERIA)
    assert not rules.is_needed(parent, weaker, CRITERIA)
    assert rules.trials_agree(0.5 * SLIGHTLY_MORE)
    assert not rules.trials_agree(0.5)


@pytest.mark.parametrize(
    ("shift", "before", "after", "is_enough"),
    [
        ((0.0, 1.0), 1.0, 1.0, True),
        ((0.0, SLIGHTLY_LESS), 1.0, 0.5, False),
        ((9.0, 0.0), 1.0, 1.0, True),
        ((0.0, 0.9), 1.5, 1.0, True),  # brings the misfit within the tolerance
        ((0.0, 0.9), 1.9, SLIGHTLY_MORE, False),
    ],
)
def test_a_cause_must_move_the_tip_by_the_tolerance_or_bring_misfit_within_it(
    monkeypatch, shift, before, after, is_enough
):
    """All in tolerances. Three causes of 1.9 mm each left a misfit of 3.4 mm."""
    left = {"without": before, "with": after}
    monkeypatch.setattr(
        rules, "tip_shift_rms", lambda *_: TOLERANCE_M * np.array(shift)
    )
    monkeypatch.setattr(
        rules,
        "unexplained_tip_rms",
        lambda data, fit: TOLERANCE_M * np.array([0.0, left[fit]]),
    )
    assert rules.is_large_enough(None, "without", "with", CRITERIA) is is_enough


@pytest.mark.parametrize(("left", "is_enough"), [(0.70, True), (0.72, False)])
def test_a_contact_must_explain_half_of_the_trial_that_it_touches(
    monkeypatch, left, is_enough
):
    tip = {"parent": np.array([1.0, 1.0]), "fit": np.array([1.0, left])}
    monkeypatch.setattr(rules, "unexplained_tip_rms", lambda data, fit: tip[fit])
    enough = rules.explains_its_only_trial(None, "parent", "fit", 1, CRITERIA)
    assert enough is is_enough
    assert not rules.explains_its_only_trial(None, "parent", "fit", 0, CRITERIA)


@pytest.mark.parametrize("strong", [None, 0, 1, 2])
def test_one_of_three_leave_one_out_gains_is_sufficient(monkeypatch, strong):
    names = (
        "fixed_leave_one_out_gain",
        "refitted_leave_one_out_gain",
        "cross_validated_gain",
    )
    for number, name in enumerate(names):
        gain = LIMIT * (SLIGHTLY_MORE if number == strong else 1)
        monkeypatch.setattr(rules, name, lambda *_, gain=gain: gain)
    survives = rules.survives_leave_one_out(None, None, None, CRITERIA)
    assert survives is (strong is not None)


SUPPORTED = {
    "evidence": LIMIT * SLIGHTLY_MORE,
    "diverged": False,
    "moves": True,
    "touched": (),
    "explains": False,
    "trials": 3,
    "survives": True,
}


@pytest.mark.parametrize(
    ("changed", "is_supported"),
    [
        ({}, True),
        ({"evidence": 0.9 * LIMIT}, False),
        ({"diverged": True}, False),
        ({"moves": False}, False),
        ({"survives": False}, False),
        # a contact in one trial is judged in that trial
        ({"touched": (2,)}, False),
        ({"touched": (2,), "explains": True, "survives": False}, True),
        ({"touched": (1, 2), "explains": True, "survives": False}, False),
        # a single trial cannot be left out
        ({"trials": 1, "survives": False}, True),
        ({"trials": 2, "survives": False}, False),
    ],
)
def test_a_cause_is_accepted_by_all_rules_together(monkeypatch, changed, is_supported):
    case = SimpleNamespace(**SUPPORTED | changed)
    judged = []

    def explains(data, parent, fit, touched, criteria):
        judged.append(touched)
        return case.explains

    monkeypatch.setattr(rules, "is_large_enough", lambda *_: case.moves)
    monkeypatch.setattr(
        rules,
        "trials_touched_by",
        lambda data, fit, cause, least: case.touched if cause == "last" else (0,),
    )
    monkeypatch.setattr(rules, "explains_its_only_trial", explains)
    monkeypatch.setattr(rules, "survives_leave_one_out", lambda *_: case.survives)
    data = SimpleNamespace(trials=[None] * case.trials)
    fit = fit_of(case.evidence, has_diverged=case.diverged)
    assert rules.is_supported(data, fit_of(), fit, CRITERIA) is is_supported
    assert judged in ([], [2])


@pytest.mark.parametrize(
    ("gains", "explained", "helps"),
    [
        ((-9.0, 1.0, 1.0), 0.1, True),
        ((9.0, -1.0, -1.0), 0.1, False),
        ((0.0, 0.0), 0.1, False),
        ((9.0, 1.0, 1.0), -0.1, False),  # likelier, but tips are farther
    ],
)
def test_the_median_trial_and_the_tips_decide_on_prediction(gains, explained, helps):
    assert rules.predicts_heldout(np.array(gains), explained) is helps


def test_half_suffices_for_explaining_but_not_for_misfit():
    half = VerdictNumbers(2, misfit_probability=0.5, explained_fraction=0.5)
    assert rules.explains_enough(half, CRITERIA)
    assert not rules.explains_enough(replace(half, explained_fraction=0.49), CRITERIA)
    assert rules.predicts_better(replace(half, heldout_explained_fraction=-0.1))
    assert not rules.misfit_remains(0.5)
    assert rules.misfit_remains(0.51)
    assert rules.can_be_confirmed(half)


@pytest.mark.parametrize(("fraction", "counts"), [(0.01, True), (0.0, False)])
def test_misfit_may_be_larger_than_the_causes(fraction, counts):
    numbers = VerdictNumbers(2, misfit_probability=0.6, explained_fraction=fraction)
    numbers = replace(numbers, heldout_explained_fraction=fraction)
    assert rules.explains_enough(numbers, CRITERIA) is counts
    assert rules.predicts_better(numbers) is counts


def test_misfit_is_probable_if_that_of_the_worst_trial_is(monkeypatch):
    """In three of four draws, the tip of some trial exceeds the tolerance."""
    drawn_m = TOLERANCE_M * np.array([[0.5, 2.0, 0.5, 1.0], [2.0, 0.5, 2.0, 1.0]])
    seeds = []

    def sample(data, fit, rng):
        seeds.append(rng.bit_generator.random_raw())
        return drawn_m

    monkeypatch.setattr(verdict, "sample_discrepancy_tip_rms", sample)
    off = [verdict.misfit_probability(None, None, CRITERIA, 3) for _ in range(2)]
    assert off == [0.75, 0.75]
    assert seeds[0] == seeds[1]
    verdict.misfit_probability(None, None, CRITERIA, 4)
    assert seeds[2] != seeds[0]


class Place(SimpleNamespace):
    """The posterior of a place with only its presence."""

    holds_a_cause = SingleEffectPosterior.holds_a_cause


@pytest.mark.parametrize("has_cause", [True, False])
def test_the_verdicts_numbers_compare_the_causes_with_the_base_model(
    monkeypatch, has_cause
):
    hypothesis = SimpleNamespace(cause_names=("wind",) if has_cause else ())
    fit = fit_of(hypothesis=hypothesis)
    base_fit = fit_of() if has_cause else fit
    tip_m = {id(fit): 0.5 * TOLERANCE_M, id(base_fit): TOLERANCE_M}
    posterior = Place(
        presence=0.8,
        credible_set=lambda coverage: ("wind", "", "tilt")[: int(100 * coverage)],
    )
    prepared = SimpleNamespace(
        data=SimpleNamespace(trials=[1, 2, 3]),
        discretisation_uncertainty_m=np.array([3 * TOLERANCE_M]),
    )
    posteriors = SimpleNamespace(
        state=SimpleNamespace(prepared=prepared, fit=fit),
        by_cause=(posterior,) if has_cause else (),
    )
    monkeypatch.setattr(verdict, "inclusion_probabilities", lambda by_cause: {"a": 0.9})
    monkeypatch.setattr(
        verdict, "unexplained_tip_rms", lambda data, one: np.array([tip_m[id(one)]])
    )
    monkeypatch.setattr(verdict, "misfit_probability", lambda *_: 0.8)
    numbers = verdict.measure_verdict_numbers(posteriors, 0.2, base_fit, CRITERIA, 0)
    assert numbers == VerdictNumbers(
        trials=3,
        causes=("wind",) if has_cause else (),
        credible_sets=(("wind", "tilt"),) if has_cause else (),
        inclusion_probability={"a": 0.9},
        misfit_probability=0.2,
        base_misfit_probability=0.8 if has_cause else 0.2,
        explained_fraction=0.75 if has_cause else 0.0,
        unresolved_m=3 * TOLERANCE_M,
    )
    posterior.presence = 0.5
    numbers = verdict.measure_verdict_numbers(posteriors, 0.2, base_fit, CRITERIA, 0)
    assert numbers.credible_sets == ()
    fit.has_diverged = True
    numbers = verdict.measure_verdict_numbers(posteriors, 0.2, base_fit, CRITERIA, 0)
    assert numbers.diverged
    assert numbers.base_misfit_probability == 0.0


@pytest.mark.parametrize("better", ["before", "with causes"])
def test_the_base_is_refitted_only_if_there_are_causes_and_from_two_starts(
    monkeypatch, better
):
    """Otherwise the misfit of a poor minimum would be attributed to a cause."""
    hypothesis = SimpleNamespace(causes=("wind",), base="model")
    before, found = fit_of(name="before"), fit_of(name="with causes")
    found.hypothesis = hypothesis
    ends = {name: fit_of(-9.0, end=name) for name in ("before", "with causes")}
    ends[better].log_evidence = 7.0
    monkeypatch.setattr(verdict, "refit", lambda data, start, base: ends[start.name])
    prepared = SimpleNamespace(data=None, base_fit=before)
    state = SimpleNamespace(fit=found, prepared=prepared)
    assert verdict.fit_base_to(state) is ends[better]

    hypothesis.causes = ()
    assert verdict.fit_base_to(state) is found


def test_a_mesh_that_is_too_coarse_is_named_with_certainty():
    probabilities = {"wind": 0.3}
    numbers = VerdictNumbers(2, inclusion_probability=probabilities)
    coarse = verdict.Verdict("effect", 0.1, (verdict.RESOLUTION,))
    judged = verdict.Judgement(coarse, numbers, (), None, ())
    named = {"wind": 0.3, verdict.RESOLUTION: 1.0}
    assert judged.inclusion_probability == named
    other = replace(judged, verdict=verdict.Verdict("effect", 0.1, ("wind",)))
    assert other.inclusion_probability == probabilities


def test_an_interrupted_search_reports_the_causes_found(monkeypatch):
    """Of two causes in the fit, the second was known before the search."""

    def step(name, accepted=True):
        best = SimpleNamespace(hypothesis=SimpleNamespace(cause_names=("x", name)))
        return SimpleNamespace(accepted=accepted, best=best)

    monkeypatch.setattr(verdict, "find_background", lambda *_: ["response"])
    monkeypatch.setattr(verdict, "misfit_probability", lambda *_: 0.4)
    monkeypatch.setattr(verdict, "fit_base_to", lambda state: "base fit")
    monkeypatch.setattr(verdict, "single_effect_posterior", lambda step, *_: step.best)
    monkeypatch.setattr(
        verdict,
        "inclusion_probabilities",
        lambda posteriors: {p.hypothesis.cause_names[-1]: 0.9 for p in posteriors},
    )
    fit = fit_of(hypothesis=SimpleNamespace(cause_names=("wind", "given")))
    empty = SimpleNamespace(accepted=True, best=None)
    steps = [step("wind"), step("tilt", accepted=False), empty]
    prepared = SimpleNamespace(data=SimpleNamespace(trials=[1, 2]))
    state = SimpleNamespace(prepared=prepared, fit=fit, steps=steps)
    judged = verdict.judge_interrupted_search(state, [], CRITERIA, 0)
    assert judged.verdict.kind == "insufficient"
    assert judged.verdict.remark.endswith("so far it had found wind (0.90).")
    assert judged.verdict.misfit_probability == 0.4
    assert [p.hypothesis.cause_names[-1] for p in judged.posteriors] == ["wind"]
    assert judged.numbers.trials == 2
    assert judged.numbers.causes == ("wind", "given")
    assert (judged.base_fit, judged.background) == ("base fit", ["response"])
    assert judged.interrupted
