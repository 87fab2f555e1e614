"""Comparison of candidates: which are fitted and refined, and which one leads."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic_trials import CRITERIA

from stringcast.stages.diagnose.search import (
    candidate_comparison,
    rival_comparison,
    selection_step,
)
from stringcast.stages.diagnose.search.proposals import Proposal
from stringcast.stages.diagnose.search.selection_step import SelectionStep

SIX = ["e0", "e1", "e2", "e3", "e4", "e5"]


@dataclass(frozen=True)
class NamedFit:
    """A fit with only the fields that a comparison uses."""

    name: str
    log_evidence: float
    hypothesis: SimpleNamespace | None = None
    chi: np.ndarray = field(default_factory=lambda: np.zeros(1))
    grid_points: np.ndarray = field(default_factory=lambda: np.zeros(1, dtype=int))
    exponents: dict = field(default_factory=dict)
    log_likelihood_by_trial: np.ndarray = field(default_factory=lambda: np.zeros(1))
    log_evidence_error: float = 0.0


def named_fit(name, log_evidence):
    """Return a fit with a name for its cause."""
    hypothesis = SimpleNamespace(cause_names=(name,), causes=(name,))
    return NamedFit(name, log_evidence, hypothesis)


@pytest.fixture
def limited(monkeypatch):
    """Return a set for the causes at the end of their range, initially empty."""
    names = set()
    monkeypatch.setattr(
        selection_step, "is_inside_range", lambda fit, cause: cause not in names
    )
    return names


@pytest.fixture
def fitted_parents(monkeypatch):
    """Replace refits of parents by the parents themselves."""
    monkeypatch.setattr(candidate_comparison, "refit", lambda data, fit, *given: fit)


@pytest.fixture(autouse=True)
def named_contact(monkeypatch):
    """Treat an effect as a contact if its name says so."""
    monkeypatch.setattr(
        candidate_comparison,
        "is_position_dependent",
        lambda effect: effect == "contact",
    )


def compare_as_found(prepared, rivals, fitted_before=(), min_gain=1.0):
    """Give rivals the same evidence on common data."""
    return rivals


@pytest.mark.parametrize(
    ("before", "uncertain", "misfit", "best"),
    [
        ((0.0, 1e-3), (0.0, 4e-3), (5e-3, 5e-3), "resolved"),
        # the trial was as uncertain before
        ((0.0, 5e-3), (0.0, 4e-3), (5e-3, 5e-3), "uncertain"),
        # two other trials are resolved
        ((0.0, 1e-3, 0.0), (0.0, 4e-3, 0.0), (5e-3, 5e-3, 5e-3), "uncertain"),
        # the misfit is much larger, but most trials would be left out
        ((0.0,) * 5, (0.0, 0.0, 4e-3, 4e-3, 4e-3), (0.02,) * 5, "resolved"),
        # the misfit is much larger
        ((0.0, 1e-3), (0.0, 4e-3), (5e-3, 0.02), "uncertain"),
    ],
)
def test_a_cause_with_too_few_resolved_trials_is_not_accepted(
    before, uncertain, misfit, best, limited, monkeypatch
):
    fits = [named_fit("uncertain", 60.0), named_fit("resolved", 50.0)]
    uncertainty_m = {
        "uncertain": np.array(uncertain),
        "resolved": np.zeros(len(before)),
    }

    prepared = SimpleNamespace(
        discretisation_uncertainty_m=np.array(before), data="prepared"
    )
    monkeypatch.setattr(
        rival_comparison,
        "discretisation_uncertainty_of",
        lambda prepared, fit: uncertainty_m[fit.name],
    )
    monkeypatch.setattr(rival_comparison, "is_supported", lambda *given: True)
    monkeypatch.setattr(
        rival_comparison, "unexplained_tip_rms", lambda data, fit: np.array(misfit)
    )
    monkeypatch.setattr(rival_comparison, "fit_to_common_data", compare_as_found)
    compare_rivals = rival_comparison.compare_rivals
    given = SelectionStep(None, NamedFit("", 0.0), (), fits)
    step = compare_rivals(prepared, given, given, CRITERIA)
    assert (step.best.name, step.accepted) == (best, True)

    # In the place of an accepted cause all trials must be resolved
    given = replace(given, incumbent=fits[1])
    step = compare_rivals(prepared, given, given, CRITERIA)
    all_as_before = before == (0.0, 5e-3)
    assert step.best.name == ("uncertain" if all_as_before else "resolved")
    # It has more evidence, part of which may be numerical error
    ahead = [fit.name for fit in step.unresolved]
    assert ahead == ([] if all_as_before else ["uncertain"])
    behind = replace(given, fits=[fits[0], named_fit("resolved", 70.0)])
    step = compare_rivals(prepared, behind, behind, CRITERIA)
    assert not step.unresolved
    # The accepted cause itself was shown to resolve enough
    given = replace(given, incumbent=fits[0])
    step = compare_rivals(prepared, given, given, CRITERIA)
    assert step.best.name == "uncertain"


def compare_rivals(monkeypatch, found, common):
    """Compare fits whose evidence on common data differs from their first evidence.

    Returns the step, and the fits that were compared.
    """
    compared = []

    def compare(given, rivals, fitted_before=(), min_gain=1.0):
        assert given is prepared
        compared.extend(rival.name for rival in rivals if rival.name)
        return [
            replace(rival, log_evidence=common.get(rival.name, 0.0)) for rival in rivals
        ]

    prepared = SimpleNamespace(discretisation_uncertainty_m=np.zeros(2), data=None)
    monkeypatch.setattr(
        rival_comparison,
        "discretisation_uncertainty_of",
        lambda prepared, fit: np.zeros(2),
    )
    monkeypatch.setattr(rival_comparison, "is_supported", lambda *given: True)
    monkeypatch.setattr(rival_comparison, "fit_to_common_data", compare)
    monkeypatch.setattr(
        rival_comparison, "unexplained_tip_rms", lambda *given: np.ones(2)
    )
    parent = NamedFit("", 0.0)
    fits = [named_fit(name, value) for name, value in found.items()]
    fits = selection_step.rank_rivals(parent, fits, CRITERIA)
    given = SelectionStep(None, parent, (), fits)
    step = rival_comparison.compare_rivals(prepared, given, given, CRITERIA)
    return step, compared


def test_a_rival_that_was_not_compared_does_not_lead(limited, monkeypatch):
    """The fourth candidate was named because common data took 90 from the others."""
    found = {
        "set": 730.0,
        "wind": 694.0,
        "camera": 669.0,
        "tilt": 643.0,
        "angle": 595.0,
    }
    common = {
        "set": 640.0,
        "wind": 600.0,
        "camera": 580.0,
        "tilt": 550.0,
        "angle": 0.0,
    }
    step, compared = compare_rivals(monkeypatch, found, common)
    assert compared == ["set", "wind", "camera"]  # the fourth is slightly ahead
    assert step.best.name == "set"

    common = {**common, "set": 600.0}
    step, compared = compare_rivals(monkeypatch, found, common)
    assert compared == ["set", "wind", "camera", "tilt"]
    assert step.best.name == "set"
    assert [fit.name for fit in step.compared][-1] == "tilt"


def test_the_rival_with_most_evidence_on_common_data_leads(limited, monkeypatch):
    """A wind gained 145 only because numerical error was subtracted at its own fit."""
    found = {"wind": 719.0, "set": 633.0}
    common = {"wind": 574.0, "set": 633.0}
    step, _ = compare_rivals(monkeypatch, found, common)
    assert step.best.name == "set"
    assert [fit.log_evidence for fit in step.compared] == [633.0, 574.0]


def test_a_common_shift_of_evidence_does_not_change_the_order_of_rivals(
    limited, monkeypatch
):
    """All 21 candidates for a cable were refined, because each lost about 15."""
    found = {"slip": 23.0, "offset": 22.0, "drift": 21.0, "lag": 20.0}
    common = {"": -15.0, "slip": 8.0, "offset": 6.0, "drift": 5.0}
    step, compared = compare_rivals(monkeypatch, found, common)
    assert compared == ["slip", "offset", "drift"]
    assert [fit.log_evidence for fit in step.fits] == [8.0, 6.0, 5.0, 5.0]


def test_fits_compared_among_fewer_candidates_are_reused(monkeypatch):
    fitted = []

    def fit(prepared, rivals, fitted_before=(), min_gain=1.0):
        fitted.append([rival.name for rival in rivals])
        return rivals

    monkeypatch.setattr(rival_comparison, "fit_to_common_data", fit)
    parent = named_fit("", 0.0)
    rivals = [named_fit("set", 60.0), named_fit("wind", 50.0)]
    step = SelectionStep(None, parent, (), rivals)
    before = replace(step, compared=rivals[1:])
    rival_comparison._fit_new_rivals(None, step, rivals, before, 1.0)
    rival_comparison._fit_new_rivals(None, step, rivals, step, 1.0)
    assert fitted == [["set"], ["", "set", "wind"]]


@pytest.mark.parametrize(
    ("evidence", "errors", "refitted"),
    [
        ((900.0, 895.0, 500.0), (8.0, 0.1, 8.0), ["set"]),
        ((900.0, 895.0, 500.0), (8.0, 4.0, 8.0), ["set", "wind"]),
        # far from the best, to which of them nobody asks
        ((900.0, 600.0, 500.0), (8.0, 8.0, 8.0), []),
    ],
)
def test_only_rivals_close_to_the_best_are_fitted_precisely(
    evidence, errors, refitted, monkeypatch
):
    fitted = []

    def fit(prepared, rivals, fitted_before):
        fitted.extend(rival.name for rival in rivals)
        return [replace(rival, log_evidence_error=0.0) for rival in rivals]

    monkeypatch.setattr(rival_comparison, "fit_to_common_data", fit)
    rivals = []
    for name, value, error in zip(
        ("set", "wind", "tilt"), evidence, errors, strict=True
    ):
        rivals.append(replace(named_fit(name, value), log_evidence_error=error))
    settled = rival_comparison._fit_close_rivals_precisely(None, rivals, [], 9.0)
    assert fitted == refitted
    assert [fit.name for fit in settled] == ["set", "wind", "tilt"]


def test_a_rival_that_explains_less_than_its_parent_is_refitted_from_it(monkeypatch):
    """The parent had found a better minimum, and rivals were up to 286 behind it."""
    fitted = []

    def fit(prepared, rivals, fitted_before):
        fitted.extend(rival.name for rival in rivals)
        assert fitted_before == [parent]
        return [replace(rival, log_evidence=55.0) for rival in rivals]

    monkeypatch.setattr(rival_comparison, "fit_to_common_data", fit)
    parent = NamedFit("", 50.0, log_likelihood_by_trial=np.array([40.0, 20.0]))
    ahead = replace(named_fit("set", 60.0), log_likelihood_by_trial=np.array([75.0]))
    # A useless amplitude costs evidence, but not likelihood
    alike = replace(named_fit("wind", 45.0), log_likelihood_by_trial=np.array([59.5]))
    behind = replace(named_fit("tilt", 52.0), log_likelihood_by_trial=np.array([20.0]))
    fits = rival_comparison._refit_rivals_behind_parent(
        None, parent, [ahead, behind, alike]
    )
    assert fitted == ["tilt"]
    assert [fit.log_evidence for fit in fits] == [60.0, 55.0, 45.0]


@pytest.mark.parametrize(
    ("inside", "leader"),
    [(60.0, "set"), (40.0, "tilt")],  # it explains more than half, or less
)
def test_a_rival_inside_its_range_ranks_above_one_at_its_end(
    inside, leader, limited, monkeypatch
):
    """A tilt of gravity at its limit was accepted instead of the set of a strip."""
    limited |= {"tilt", "angle", "camera"}
    found = {"tilt": 100.0, "angle": 99.0, "camera": 98.0, "set": inside}
    step, compared = compare_rivals(monkeypatch, found, found)
    assert step.best.name == leader
    assert ("set" in compared) == (leader == "set")


@pytest.mark.parametrize(
    ("evidence", "angle", "expected"),
    [
        (50.0, 0.2, [*SIX, "e8"]),
        (50.0, 1.0, SIX),  # it could reach three tenths of the best cause's gain
        (1.0, 0.2, SIX),  # nothing is accepted
    ],
)
def test_look_alikes_of_the_best_are_fitted_even_with_a_small_predicted_gain(
    evidence, angle, expected, fitted_parents, monkeypatch
):
    directions = {"e0": (1.0, 0.0), "e8": (np.cos(angle), np.sin(angle))}

    def propose(data, parent, effects, seed):
        proposals = []
        for number, effect in enumerate(effects):
            hypothesis = SimpleNamespace(causes=(effect,))
            direction = np.array(directions.get(effect, (0.0, 1.0)))
            start, gain = np.zeros((1, 1)), 20.0 - number
            proposals.append(Proposal(hypothesis, start, gain, direction))
        return proposals

    def fit_proposals(prepared, step, proposals, criteria, sampled):
        fits = []
        for number, proposal in enumerate(proposals):
            fitted.append(proposal.effect)
            value = evidence - number
            fits.append(
                SimpleNamespace(hypothesis=proposal.hypothesis, log_evidence=value)
            )
        return replace(step, fits=[*step.fits, *fits])

    def accept(prepared, step, *given):
        return replace(step, accepted=True)

    fitted = []
    monkeypatch.setattr(candidate_comparison, "propose_causes", propose)
    monkeypatch.setattr(candidate_comparison, "_fit_more_proposals", fit_proposals)
    monkeypatch.setattr(candidate_comparison, "compare_rivals", accept)
    monkeypatch.setattr(
        candidate_comparison, "_find_better_parent", lambda *given: None
    )
    monkeypatch.setattr(
        candidate_comparison, "unexplained_tip_rms", lambda data, fit: np.zeros(1)
    )
    parent = SimpleNamespace(log_evidence=0.0, hypothesis=SimpleNamespace(causes=()))
    effects = [f"e{k}" for k in range(10)]
    prepared = SimpleNamespace(data=SimpleNamespace(trials=()))
    candidate_comparison.compare_candidates(prepared, parent, effects, CRITERIA, 0)
    assert fitted == expected


EIGHT = [*SIX, "e6", "contact"]


@pytest.mark.parametrize(
    ("accepted", "left_mm", "has_incumbent", "expected"),
    [
        (False, 9.0, False, EIGHT),
        (True, 9.0, False, [*SIX, "e6"]),  # it explains a fifth
        (True, 5.0, False, SIX),  # it explains three quarters
        (True, 9.0, True, SIX),  # others were fitted before
    ],
)
def test_all_others_are_fitted_if_the_best_explains_little(
    accepted, left_mm, has_incumbent, expected, fitted_parents, monkeypatch
):
    """Relaxation had a predicted gain of 4, gained 400, and was not tried after slip.

    A contact with a small predicted gain is tried only if nothing was accepted: one in
    a strip that touches nothing gained 1098.

    They are compared with the parent on the data of the search: refined rivals and
    their parent are fitted to other data.
    """
    tried = []
    parents = []
    incumbent = named_fit("slip", 20.0) if has_incumbent else None
    parent = named_fit("", 0.0)
    misfit_mm = {"": 10.0, "slip": left_mm}

    def propose(data, parent, effects, seed):
        proposals = []
        for number, effect in enumerate(effects):
            hypothesis = SimpleNamespace(causes=(effect,))
            gain = 100.0 - 10.0 * number
            proposals.append(Proposal(hypothesis, None, gain, np.zeros(1)))
        return proposals

    def fit_proposals(prepared, step, proposals, *given):
        tried.extend(proposal.effect for proposal in proposals)
        parents.append(step.parent)
        return step

    def compare(prepared, step, *given):
        moved = named_fit("", 50.0)
        fits = [named_fit("slip", 70.0)]
        return replace(step, parent=moved, fits=fits, accepted=accepted)

    monkeypatch.setattr(candidate_comparison, "propose_causes", propose)
    monkeypatch.setattr(candidate_comparison, "_fit_more_proposals", fit_proposals)
    monkeypatch.setattr(candidate_comparison, "_lookalikes_of_best", lambda *given: [])
    monkeypatch.setattr(
        candidate_comparison, "_find_better_parent", lambda *given: None
    )
    monkeypatch.setattr(candidate_comparison, "compare_rivals", compare)
    monkeypatch.setattr(
        candidate_comparison,
        "unexplained_tip_rms",
        lambda data, fit: np.array([1e-3 * misfit_mm[fit.name]]),
    )
    prepared = SimpleNamespace(data=SimpleNamespace(trials=()))
    step = candidate_comparison.compare_candidates(
        prepared, parent, EIGHT, CRITERIA, 0, incumbent
    )
    assert tried == expected
    assert all(each is parent for each in parents)
    assert step.parent.log_evidence == 50.0


@pytest.mark.parametrize(("without", "parents"), [(17.7, [0.0, 17.7]), (9.0, [0.0])])
def test_a_better_minimum_without_a_cause_replaces_the_parent_first(
    without, parents, fitted_parents, monkeypatch
):
    """All 21 candidates for a cable gained 14 to 23: its parent was 18 too low."""
    candidate = named_fit("wind", 20.0)
    refined = []

    def fit_without(data, hypothesis, starts, *given):
        assert starts.tolist() == [[0.0], [0.4]]  # of the parent and of the candidate
        return replace(parent, log_evidence=without)

    def refine(prepared, step, *given):
        refined.append(step.parent.log_evidence)
        return replace(step, accepted=True)

    def fit_proposals(prepared, step, *given):
        tried.append(step.parent.log_evidence)
        return replace(step, fits=[candidate])

    tried = []
    monkeypatch.setattr(candidate_comparison, "propose_causes", lambda *given: [])
    monkeypatch.setattr(candidate_comparison, "_fit_more_proposals", fit_proposals)
    monkeypatch.setattr(candidate_comparison, "compare_rivals", refine)
    monkeypatch.setattr(candidate_comparison, "fit_hypothesis", fit_without)
    monkeypatch.setattr(
        candidate_comparison, "unexplained_tip_rms", lambda *given: np.ones(1)
    )
    hypothesis = SimpleNamespace(
        causes=(), exponents_from=lambda exponents: np.array([0.4])
    )
    parent = NamedFit("", 0.0, hypothesis)
    prepared = SimpleNamespace(data=SimpleNamespace(trials=()))
    candidate_comparison.compare_candidates(prepared, parent, [], CRITERIA, 0)
    assert sorted(set(tried)) == parents
    assert refined == parents[-1:]


def test_candidates_are_first_fitted_to_a_sample_of_many_trials(monkeypatch):
    """Less than twice the size of a sample are not sampled."""

    def evaluate(data, *given):
        return f"fit to {len(data)}"

    class Trials(list):
        trials = property(list)

        def subset(self, chosen):
            return Trials(self[k] for k in chosen)

    monkeypatch.setattr(candidate_comparison, "evaluate_fit", evaluate)
    monkeypatch.setattr(
        candidate_comparison, "sample_by_misfit", lambda data, fit, count: range(count)
    )
    parent = SimpleNamespace(hypothesis=None, chi=None, width=None)
    few = Trials(range(15))
    assert candidate_comparison._sample_trials(few, parent) == (few, parent)
    many = Trials(range(16))
    sample = candidate_comparison._sample_trials(many, parent)
    assert sample == (Trials(range(8)), "fit to 8")


@pytest.mark.parametrize(
    ("first", "corrected", "kept"),
    [
        (40.0, -9.0, 40.0),
        (25.0, 40.0, 40.0),
        (-1.0, 9.0, -1.0),  # it explains nothing
        (15.0, 40.0, 15.0),  # it gains less than half of what the best gains
    ],
)
def test_a_rough_correction_does_not_lower_the_evidence_of_a_proposal(
    first, corrected, kept, monkeypatch, limited
):
    """One finer mesh gives only a rough error; refined fits are compared later."""
    evidence = {"plain": first, "corrected": corrected}

    def fit(data, *given):
        return named_fit("wind", evidence[data])

    for name in ("fit_hypothesis", "refit"):
        monkeypatch.setattr(candidate_comparison, name, fit)
    monkeypatch.setattr(
        candidate_comparison,
        "correct_data_on_one_finer_mesh",
        lambda *given: "corrected",
    )
    monkeypatch.setattr(
        candidate_comparison, "rank_rivals", lambda parent, fits, criteria: fits
    )
    parent = NamedFit("", 0.0)
    best = named_fit("clamp", 35.0)
    step = SelectionStep(None, parent, [], [best])
    wind = SimpleNamespace(name="wind")
    hypothesis = SimpleNamespace(causes=(wind,), cause_names=("wind",))
    proposal = Proposal(hypothesis, None, 20.0, np.ones(1))
    prepared = SimpleNamespace(data="plain")
    found = candidate_comparison._fit_more_proposals(
        prepared, step, [proposal], CRITERIA, ("plain", parent)
    )
    assert [each.log_evidence for each in found.fits] == [35.0, kept]


@pytest.mark.parametrize(("proposed", "starts"), [(-30.0, [0.9, 0.2]), (12.0, [0.9])])
def test_a_fit_worse_than_its_parent_is_restarted_without_the_cause(
    proposed, starts, monkeypatch
):
    """The model with the cause contains its parent."""
    ends = {0.9: proposed, 0.2: 8.0}
    tried = []

    def fit(data, hypothesis, start, *given):
        tried.append(float(start[0, 0]))
        log_likelihood = ends[tried[-1]]
        by_trial = np.array([log_likelihood])
        fit = NamedFit("wind", log_likelihood, hypothesis)
        return replace(fit, log_likelihood_by_trial=by_trial)

    monkeypatch.setattr(candidate_comparison, "fit_hypothesis", fit)
    monkeypatch.setattr(
        candidate_comparison, "least_evidence_of_rivals", lambda *given: np.inf
    )
    monkeypatch.setattr(
        candidate_comparison, "rank_rivals", lambda parent, fits, criteria: fits
    )
    parent = NamedFit("", 0.0)
    wind = SimpleNamespace(name="wind")
    hypothesis = SimpleNamespace(
        causes=(wind,),
        cause_names=("wind",),
        exponents_from=lambda exponents: np.array([0.2]),
    )
    proposal = Proposal(hypothesis, np.array([[0.9]]), 20.0, np.ones(1))
    found = candidate_comparison._fit_more_proposals(
        SimpleNamespace(data="plain"),
        SelectionStep(None, parent, [], []),
        [proposal],
        CRITERIA,
        ("plain", parent),
    )
    assert tried == starts
    assert [each.log_evidence for each in found.fits] == [max(proposed, 8.0)]
