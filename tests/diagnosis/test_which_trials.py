"""Choice of the searched trials, and confirmation of causes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import CRITERIA, simulate_trial, swing_angles

from stringcast.stages.diagnose.results.tables import screening_table
from stringcast.stages.diagnose.search import cause_search, selection_state
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.diagnose.search.selection_step import SelectionStep
from stringcast.stages.diagnose.settings import DiagnosisSettings
from stringcast.stages.diagnose.trials import discretisation
from stringcast.stages.diagnose.trials.discretisation import (
    subtract_discretisation_error,
    unresolvable_trials,
    with_second_order_mesh,
)
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.diagnose.trials.trials_by_use import TrialsByUse
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import evaluate_fit
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.library import effects_by_name


@pytest.mark.parametrize(
    ("uncertainty_m", "kept_each_time", "rejected"),
    [(1e-3, [(), ("t2",)], []), (9e-3, [()], ["t2"])],
)
def test_a_trial_that_is_resolved_only_with_causes_is_used(
    uncertainty_m, kept_each_time, rejected, monkeypatch
):
    """The third trial is chaotic without a cause; its uncertainty with one is given."""
    kept = []

    def prepare(model, observations, tolerance_m, rng, starts, progress, step, keep):
        kept.append(tuple(keep))
        return prepared_trials(chaotic=() if keep else ("t2",))

    def prepare_further(prepared, trials, fit):
        return None, np.full(len(trials), uncertainty_m)

    def select(state, *given):
        prepared = state.prepared
        yield SelectionState(prepared, fit_with("wind"))
        # if a cause resolves the trial, the search without it stops
        assert prepared.chaotic_trials == tuple(rejected)
        yield SelectionState(prepared, fit_with("wind", "clamp"))

    monkeypatch.setattr(cause_search, "find_outlying_trial", lambda *given: {})
    monkeypatch.setattr(cause_search, "prepare_further_trials", prepare_further)
    monkeypatch.setattr(cause_search, "with_causes_found_before", keep_causes)
    used, prepared, _ = settle(monkeypatch, prepare, select)
    assert kept == kept_each_time
    assert [*used.left_out] == rejected == [*prepared.chaotic_trials]


def swung_trials(arm):
    """Simulate three trials of the base model; return them with its hypothesis."""
    hypothesis = Hypothesis(with_second_order_mesh(ordinary(arm)))
    model = hypothesis.model
    rng = np.random.default_rng(0)
    trials = []
    for k, angles in enumerate(swing_angles(arm, 3, 0.4)):
        measured = simulate_trial(
            f"t{k}", arm, model, TRUTH, angles, np.array([8, 14, 20]), rng
        )
        trial = prepare_trial(model, measured)
        trials.append(replace(trial, sigma=np.full(len(trial.s), 1e-3)))
    return trials, hypothesis


def test_a_trial_that_diverges_on_a_finer_mesh_is_unresolved(arm, monkeypatch):
    trials, hypothesis = swung_trials(arm)
    extrapolate = discretisation.extrapolate_errors

    def diverge_in_t1(*given):
        errors, uncertainties = extrapolate(*given)
        diverged = np.full_like(errors[1], np.nan)
        nothing = np.full_like(uncertainties[1], np.nan)
        return (
            [errors[0], diverged, errors[2]],
            [uncertainties[0], nothing, uncertainties[2]],
        )

    monkeypatch.setattr(discretisation, "extrapolate_errors", diverge_in_t1)
    chi = hypothesis.model.exponents_of_values(TRUTH)
    data, uncertainty_m = subtract_discretisation_error(trials, hypothesis, chi)
    assert np.isinf(uncertainty_m).tolist() == [False, True, False]
    assert np.isfinite(evaluate_fit(data, hypothesis, chi).log_evidence)


def test_proposals_are_kept_without_a_chaotic_trial(arm):
    """The page lists proposals. Fits of these steps included a trial left out now."""
    trials, hypothesis = swung_trials(arm)
    chi = hypothesis.model.exponents_of_values(TRUTH)
    data, uncertainty_m = subtract_discretisation_error(trials, hypothesis, chi)
    fit = evaluate_fit(data, hypothesis, chi)
    prepared = PreparedData(data, fit, tuple(trials), tuple(trials), 0, uncertainty_m)
    proposals = (SimpleNamespace(effect=effects_by_name()["wind"], gain=50.0),)
    steps = [SelectionStep(data, fit, proposals, [fit], accepted=True)]
    state = SelectionState(prepared, fit, steps)
    state = selection_state.without_chaotic_trials(state, ["t1"], CRITERIA)
    assert [trial.name for trial in state.prepared.trials] == ["t0", "t2"]
    assert state.prepared.chaotic_trials == ("t1",)
    assert len(state.fit.residuals) == len(state.prepared.base_fit.residuals) == 2
    (step,) = state.steps
    assert step.proposals is proposals
    assert (len(step.parent.residuals), step.fits) == (2, ())
    assert len(screening_table(state)) == 1


@pytest.mark.parametrize("returns", [False, True])
def test_a_trial_that_is_chaotic_with_causes_is_used_again_once(returns, monkeypatch):
    """For a strip, a search from the start took 80 s more and found other causes.

    The third trial is chaotic with the causes found with it. It may be resolved with
    those found without it.
    """

    def prepared(names, chaotic=()):
        trials = [SimpleNamespace(name=name) for name in names]
        return prepared_trials(trials, [0.0, 0.0, 9e-3][: len(names)], chaotic)

    def prepare(model, observations, *given):
        prepared_with.append([o.trial for o in observations])
        return prepared(prepared_with[-1])

    def select(state, *given):
        causes = state.fit.hypothesis.causes
        begun_with.append(causes)
        further = ("wind", "clamp")[: len(causes) + 1]
        yield SelectionState(state.prepared, fit_with(*further))

    def leave_out(state, names, criteria):
        return SelectionState(prepared(["t0", "t1"], tuple(names)), state.fit)

    def prepare_further(prepared, trials, fit):
        is_resolved = returns and fit.hypothesis.causes == ("wind", "clamp")
        return None, np.full(len(trials), 0.0 if is_resolved else 9e-3)

    prepared_with, begun_with = [], []
    monkeypatch.setattr(cause_search, "find_outlying_trial", lambda *given: {})
    monkeypatch.setattr(cause_search, "without_chaotic_trials", leave_out)
    monkeypatch.setattr(cause_search, "with_causes_found_before", keep_causes)
    monkeypatch.setattr(cause_search, "prepare_further_trials", prepare_further)
    used, _, causes = settle(monkeypatch, prepare, select)
    every = ["t0", "t1", "t2"]
    both = ("wind", "clamp")
    assert prepared_with == ([every, every] if returns else [every])
    assert begun_with == [(), ("wind",)]  # no cause is searched with the trial
    assert causes == both
    assert [*used.left_out] == ["t2"]


@pytest.mark.parametrize(
    "coarse_error_mm",
    [(0.0, 0.0, 9.0), (0.0, 9.0, 9.0)],
    ids=["one trial", "so many trials that none can be left out"],
)
def test_a_search_continues_on_a_fine_mesh_if_causes_need_it(
    coarse_error_mm, monkeypatch
):
    """The mesh was chosen for the base model, whose string may differ."""

    def prepare(
        model, observations, tolerance, rng, starts, progress, may_coarsen, keep
    ):
        could_coarsen.append(may_coarsen)
        trials = [SimpleNamespace(name=o.trial) for o in observations]
        error_m = np.array(coarse_error_mm) / 1e3 if may_coarsen else np.full(3, 1e-4)
        return prepared_trials(trials, error_m)

    def select(state, *given):
        begun_with.append(state.fit.hypothesis.causes)
        yield SelectionState(state.prepared, fit_with("wind"))

    could_coarsen, begun_with = [], []
    monkeypatch.setattr(cause_search, "find_outlying_trial", lambda *given: {})
    monkeypatch.setattr(cause_search, "with_causes_found_before", keep_causes)
    used, _, causes = settle(monkeypatch, prepare, select, mesh_is_coarse=True)
    assert could_coarsen == [True, False]
    assert begun_with == [(), ("wind",)]
    assert causes == ("wind",)
    assert not used.left_out


@pytest.mark.parametrize("is_predicted", [True, False])
def test_an_outlying_trial_that_the_causes_predict_is_used_again(
    is_predicted, monkeypatch
):
    """A trial may be outlying because causes were wrong.

    The last trial is outlying in every search. After the causes found without it
    predict it, it stays, as do these causes.
    """

    def prepare(model, observations, *given):
        searched.append([o.trial for o in observations])
        return prepared_trials()

    def select(state, *given):
        if state.fit.hypothesis.causes:
            yield state
        else:
            cause = "wrong" if "t2" in searched[-1] else "right"
            yield SelectionState(state.prepared, fit_with(cause))

    def find_outlying(state, criteria):
        return {"t2": "of another motion"} if "t2" in searched[-1] else {}

    def find_predicted(state, excluded, criteria):
        return [o.trial for o in excluded if is_predicted]

    searched = []
    monkeypatch.setattr(cause_search, "find_outlying_trial", find_outlying)
    monkeypatch.setattr(cause_search, "find_predicted_trials", find_predicted)
    monkeypatch.setattr(cause_search, "with_causes_found_before", keep_causes)
    used, _, causes = settle(monkeypatch, prepare, select)
    assert causes == ("right",)
    every = ["t0", "t1", "t2"]
    again = [every] if is_predicted else []
    assert searched == [every, every[:2], *again]
    assert used.left_out == ({} if is_predicted else {"t2": "of another motion"})


def test_a_search_is_repeated_in_a_wider_range_if_causes_require_it(arm, monkeypatch):
    """The search in the narrow range may have led to other causes.

    The third trial is chaotic without a cause, and is used again in the wide range.
    """
    model = ordinary(arm)
    grasp = {p.name: p for p in model.string.parameters}["grasp_stiffness"]
    wider = model.with_ranges(replace(grasp, high=30 * grasp.high))

    def prepare(given, observations, tolerance, rng, starts, progress, step, keep):
        searched.append((given.string.ranges, tuple(keep)))
        return prepared_trials(chaotic=() if keep else ("t2",))

    def prepare_further(prepared, trials, fit):
        return None, np.zeros(len(trials))

    def select(state, *given):
        begun_with.append(state.fit.hypothesis.causes)
        yield SelectionState(state.prepared, fit_with("tip_mass"))

    def widen(data, fit, criteria):
        return wider if len(searched) == 1 else None

    searched, begun_with = [], []
    monkeypatch.setattr(cause_search, "find_outlying_trial", lambda *given: {})
    monkeypatch.setattr(cause_search, "prepare_further_trials", prepare_further)
    _, _, causes = settle(monkeypatch, prepare, select, model=model, widen=widen)
    assert searched == [(model.string.ranges, ()), (wider.string.ranges, ("t2",))]
    assert begun_with == [(), ()]
    assert causes == ("tip_mass",)


def prepared_trials(trials=(), uncertainty_m=(), chaotic=()):
    """Return a stand-in for prepared trials, with a base model without causes."""
    hypothesis = SimpleNamespace(model=None, causes=())
    return SimpleNamespace(
        mesh_is_model=True,
        chaotic_trials=chaotic,
        data=SimpleNamespace(trials=trials),
        trials=list(trials),
        discretisation_uncertainty_m=np.array(uncertainty_m),
        base_fit=SimpleNamespace(hypothesis=hypothesis),
    )


def fit_with(*causes):
    """Return a stand-in for a fit with these causes."""
    return SimpleNamespace(hypothesis=SimpleNamespace(causes=causes))


def keep_causes(prepared, found, *given):
    """Keep the causes found before."""
    return SelectionState(prepared, found.fit)


def settle(
    monkeypatch,
    prepare,
    select,
    mesh_is_coarse=False,
    model=None,
    widen=lambda data, fit, criteria: None,
):
    """Search three trials until the choice of trials settles."""
    monkeypatch.setattr(cause_search, "widen_ranges_with_causes", widen)
    monkeypatch.setattr(cause_search, "_mesh_is_coarse", lambda state: mesh_is_coarse)
    monkeypatch.setattr(cause_search, "prepare_data", prepare)
    monkeypatch.setattr(cause_search, "candidate_effects", lambda *given: [])
    monkeypatch.setattr(cause_search, "select_causes", select)
    observations = [SimpleNamespace(trial=f"t{k}") for k in range(3)]
    trials = TrialsByUse(observations, (), {})
    settings = DiagnosisSettings(
        model=model,
        obstacles=(),
        seed=0,
        starts=4,
        criteria=CRITERIA,
        matching=None,
        design=None,
        excluded_effects=(),
        progress=lambda share: None,
    )
    *_, last = cause_search.search_until_trials_settle(trials, settings)
    return last.trials, last.prepared, last.state.fit.hypothesis.causes


@pytest.mark.parametrize(
    ("uncertainties_mm", "chaotic"),
    [((0.1, 15.0, 0.1), ["t1"]), ((0.1, 15.0), [])],
)
def test_a_chaotic_trial_is_excluded_while_two_others_remain(uncertainties_mm, chaotic):
    trials = [SimpleNamespace(name=f"t{k}") for k in range(len(uncertainties_mm))]
    uncertainty_m = np.array(uncertainties_mm) / 1e3
    prepared = SimpleNamespace(
        trials=trials, discretisation_uncertainty_m=uncertainty_m
    )
    assert unresolvable_trials(prepared, CRITERIA.tip_tolerance_m) == chaotic
