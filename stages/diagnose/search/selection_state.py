"""The state of a search for causes, and changes of its causes or trials."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stringcast.stages.diagnose.evidence.left_out_fits import groups_to_leave_out
from stringcast.stages.diagnose.evidence.measures import (
    distinct_fits,
    refit,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.evidence.predictions import (
    TrialPrediction,
    predict_left_out_trials,
)
from stringcast.stages.diagnose.rules import (
    Criteria,
    is_needed,
    is_resolved,
)
from stringcast.stages.diagnose.search.proposals import alternative_parameter_starts
from stringcast.stages.diagnose.search.selection_step import SelectionStep, rank_rivals
from stringcast.stages.diagnose.trials.base_model import search_other_strings
from stringcast.stages.diagnose.trials.discretisation import (
    correct_discretisation_once,
    without_trials,
)
from stringcast.stages.diagnose.trials.noise import reestimate_noise
from stringcast.stages.diagnose.trials.prepared_data import PreparedData, RefinedFit
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, evaluate_fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SelectionState:
    """State of a search for causes.

    Attributes
    ----------
    prepared : PreparedData
        Trials corrected at the fit.
    fit : Fit
        The fit with all causes accepted so far.
    steps : sequence of SelectionStep
        The steps of the selection; the last one may have accepted nothing.
    set_aside : dict
        Causes that were accepted and then dropped, with the reason.
    unnamed : tuple of type of Effect
        Causes in the fit that move the tip too little to be named. They stay, because
        the values of others depend on them.
    replaced : tuple of type of Effect
        Causes that were replaced by a rival because trials confirm only the rival.
    """

    prepared: PreparedData
    fit: Fit
    steps: Sequence[SelectionStep] = ()
    set_aside: Mapping[str, str] = field(default_factory=dict)
    unnamed: tuple[type[Effect], ...] = ()
    replaced: tuple[type[Effect], ...] = ()

    @property
    def nameable_causes(self) -> list[type[Effect]]:
        """The causes of the fit except those that are not named."""
        causes = self.fit.hypothesis.causes
        return [cause for cause in causes if cause not in self.unnamed]

    @cached_property
    def predictions(self) -> list[TrialPrediction]:
        """Predictions of each trial from the fit to the others."""
        return predict_left_out_trials(self.prepared.data, self.fit)

    @property
    def left_out_exponents(self) -> list[np.ndarray]:
        """Exponents (P,) of the fits without each group of trials."""
        groups = groups_to_leave_out(len(self.prepared.data.trials))
        return [self.predictions[group[0]].chi for group in groups]


def refine_fit(prepared: PreparedData, fit: Fit) -> RefinedFit:
    """Correct the data at a fit, and try other starts of its causes' parameters."""
    log.info("refining: %s", " + ".join(fit.hypothesis.cause_names))
    refined = correct_discretisation_once(prepared, fit)
    data = refined.prepared.data
    fit = refined.fit
    starts = alternative_parameter_starts(data, fit)
    if not len(starts):
        return refined
    other = fit_hypothesis(data, fit.hypothesis, starts, fit.grid_points)
    if other.log_evidence <= fit.log_evidence:
        return refined
    # The gain may be numerical error, which was subtracted at the old optimum
    restarted = correct_discretisation_once(refined.prepared, other)
    return max(refined, restarted, key=lambda option: option.fit.log_evidence)


def with_fit(state: SelectionState, fit: Fit) -> SelectionState:
    """Refine another fit and put it into a state.

    Its causes are no longer set aside.
    """
    refined = refine_fit(state.prepared, fit)
    before = state.fit.hypothesis.cause_names
    added = set(fit.hypothesis.cause_names).difference(before)
    set_aside = {n: r for n, r in state.set_aside.items() if n not in added}
    return replace(
        state, prepared=refined.prepared, fit=refined.fit, set_aside=set_aside
    )


def add_cause(
    state: SelectionState,
    best: Fit,
    criteria: Criteria,
    rng: np.random.Generator,
    starts: int,
) -> SelectionState:
    """Put a fit with a further cause into a state; re-estimate noise and errors.

    Parameters
    ----------
    state : SelectionState
        State without the cause.
    best : Fit
        The fit with the cause.
    criteria : Criteria
        Its tolerance decides whether other strings are searched.
    rng, starts
        Generator and number of these strings.
    """
    with_noise = reestimate_noise(state.prepared, best)
    corrected = correct_discretisation_once(with_noise, best)
    prepared = corrected.prepared
    fit = corrected.fit
    steps = state.steps
    if with_noise.point_counts != state.prepared.point_counts:
        counts = with_noise.outlier_count, state.prepared.outlier_count
        log.info("%d outliers instead of %d", *counts)
        steps = [_refit_step(prepared.data, step, criteria) for step in steps]

    # Search other strings if much misfit is left. They must not be resolved worse,
    # because their numerical uncertainty may explain the gain.
    if unexplained_tip_rms(prepared.data, fit).max() > criteria.tip_tolerance_m:
        refined = _refine_from_other_strings(prepared, fit, rng, starts)
        uncertainty_m = refined.prepared.discretisation_uncertainty_m
        before_m = prepared.discretisation_uncertainty_m
        gain = refined.fit.log_evidence - fit.log_evidence
        log.info("from other strings: log evidence %+.1f", gain)
        if gain > 0 and is_resolved(
            uncertainty_m, before_m, criteria, needed=len(before_m)
        ):
            prepared = refined.prepared
            fit = refined.fit
    return replace(state, prepared=prepared, fit=fit, steps=steps)


def _refine_from_other_strings(
    prepared: PreparedData, fit: Fit, rng: np.random.Generator, starts: int
) -> RefinedFit:
    """Refine a fit and the result of a search from other strings; return the better.

    Each is compared with its own numerical error: data corrected at a fit favour it,
    however wrong it is.
    """
    chi = search_other_strings(prepared.data, fit, rng, starts)
    other = evaluate_fit(prepared.data, fit.hypothesis, chi)
    distinct = distinct_fits([fit, other])
    refined = [refine_fit(prepared, option) for option in distinct]
    return max(refined, key=lambda option: option.fit.log_evidence)


def _refit_step(
    data: TrialData, step: SelectionStep, criteria: Criteria
) -> SelectionStep:
    """Move a step to data with other points, refitting the compared fits."""
    parent = refit(data, step.parent, step.parent.hypothesis)
    compared = [refit(data, fit, fit.hypothesis) for fit in step.compared]
    was_compared = {id(fit) for fit in step.compared}  # fits hold arrays: no equality
    others = []
    for fit in step.fits:
        if id(fit) not in was_compared:
            others.append(evaluate_fit(data, fit.hypothesis, fit.chi))
    fits = rank_rivals(parent, [*compared, *others], criteria)
    unresolved = [refit(data, fit, fit.hypothesis) for fit in step.unresolved]
    # All fits now use the same data
    return replace(
        step,
        data=data,
        parent=parent,
        fits=fits,
        compared=compared,
        unresolved=unresolved,
    )


def with_causes_found_before(
    prepared: PreparedData,
    earlier: SelectionState,
    criteria: Criteria,
    seed: int,
    starts: int,
) -> SelectionState:
    """Fit the causes of an earlier search to the prepared trials."""
    base = prepared.base_fit
    hypothesis = Hypothesis(base.hypothesis.base, earlier.fit.hypothesis.causes)
    # By values, because ranges may differ with other trials
    start = hypothesis.model.exponents_of_values(earlier.fit.values)
    fit = fit_hypothesis(prepared.data, hypothesis, start[None], base.grid_points)
    rng = np.random.default_rng(seed)
    steps = _without_fits(earlier.steps, prepared)
    state = SelectionState(prepared, base, steps, unnamed=earlier.unnamed)
    return add_cause(state, fit, criteria, rng, starts)


def without_chaotic_trials(
    state: SelectionState, names: Sequence[str], criteria: Criteria
) -> SelectionState:
    """Leave out chaotic trials, and drop causes that are then redundant."""
    is_kept = [trial.name not in names for trial in state.prepared.data.trials]
    prepared = without_trials(state.prepared, names)
    before = state.fit
    grid_points = before.grid_points[is_kept]
    fit = fit_hypothesis(
        prepared.data, before.hypothesis, before.chi[None], grid_points
    )
    refined = refine_fit(prepared, fit)
    steps = _without_fits(state.steps, refined.prepared)
    remaining = SelectionState(
        refined.prepared, refined.fit, steps, unnamed=state.unnamed
    )
    return drop_redundant_causes(remaining, criteria)


def _without_fits(
    steps: Sequence[SelectionStep], prepared: PreparedData
) -> list[SelectionStep]:
    """Keep the proposals of steps, without their fits, which belong to other data."""
    data = prepared.data
    base = prepared.base_fit.hypothesis.base
    kept = []
    for step in steps:
        before = step.parent
        hypothesis = Hypothesis(base, before.hypothesis.causes)
        chi = hypothesis.model.exponents_of_values(before.values)
        parent = evaluate_fit(data, hypothesis, chi, before.width)
        kept.append(SelectionStep(data, parent, step.proposals, fits=()))
    return kept


def drop_redundant_causes(state: SelectionState, criteria: Criteria) -> SelectionState:
    """Drop causes, also the new one, that the evidence does not need any more."""
    for cause in state.fit.hypothesis.causes:
        data = state.prepared.data
        hypothesis = state.fit.hypothesis.without_cause(cause)
        without = refit(data, state.fit, hypothesis)
        if not is_needed(without, state.fit, criteria):
            log.info("%s is dropped: the evidence does not need it", cause.name)
            state = with_fit(state, without)
    return state
