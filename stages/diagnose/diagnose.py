"""The diagnosis: from trials and a model to a verdict with its evidence."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
import pandas as pd
import yaml
from pydantic import AfterValidator, Field

from stringcast.data.artifacts import Observation, TrialSet
from stringcast.data.dataset import describe_rejected
from stringcast.data.diagnoses import DIAGNOSIS_SUMMARY, HELD_OUT, Diagnosis
from stringcast.data.file_checks import mark_yaml_end
from stringcast.data.schema import DataError
from stringcast.stages.common import InterruptRequest, Progress
from stringcast.stages.diagnose.clocks.trial_clocks import find_trial_clocks
from stringcast.stages.diagnose.evidence.held_out_gain import (
    HeldOutGain,
    held_out_trials_misfit,
    measure_gain,
)
from stringcast.stages.diagnose.evidence.intervals import parameter_uncertainty
from stringcast.stages.diagnose.evidence.measures import tip_shift_rms
from stringcast.stages.diagnose.evidence.posteriors import (
    limit_by_agreement,
    swap_lookalikes_until_stable,
)
from stringcast.stages.diagnose.proposal.candidate_motions import DesignSettings
from stringcast.stages.diagnose.proposal.experiment_design import (
    ProposedExperiment,
    Rivals,
    design_experiment,
)
from stringcast.stages.diagnose.results import tables
from stringcast.stages.diagnose.results.budget import (
    ErrorBudget,
    error_budget,
    nested_fits,
)
from stringcast.stages.diagnose.results.document import (
    FORMAT_VERSION,
    alternatives_document,
    budget_document,
    cause_document,
    clocks_document,
    effects_with_reasons,
    extended_model_settings,
    gain_document,
    replace_non_finite,
    trials_document,
    unexplained_document,
    verdict_sentences,
)
from stringcast.stages.diagnose.rules import Criteria, has_evidence, misfit_remains
from stringcast.stages.diagnose.search.cause_search import search_until_trials_settle
from stringcast.stages.diagnose.search.proposals import effects_left_out
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.diagnose.settings import DiagnosisSettings
from stringcast.stages.diagnose.trials.preparation import usable_trials
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.diagnose.trials.trials_by_use import TrialsByUse
from stringcast.stages.diagnose.verdict import (
    Judgement,
    decide_verdict,
    fit_base_to,
    judge_interrupted_search,
    measure_verdict_numbers,
    misfit_probability,
    name_causes,
)
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.estimate.trim import trim_at_contact
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.kept_results import use_any_store
from stringcast.stages.model.box import Box
from stringcast.stages.model.effects.time_offset import TimeOffset
from stringcast.stages.model.library import check_effect_names, effects_by_name
from stringcast.stages.model.model import Model
from stringcast.stages.spec import StageCall, declare_string_counts

log = logging.getLogger(__name__)

# random stream of the motions, separate from that of the starts of fits
DESIGN_RANDOM_STREAM = 1
STRINGS_PER_START = 250  # simulated strings per start in default runs
BASE_MODEL_HEADER = "# No effect is named: this is the base model.\n"


def run(call: StageCall, trials: TrialSet) -> Diagnosis:
    """Diagnose all trials, up to where their string touches an obstacle, as a stage."""
    obstacles = call.setup.obstacles
    observations = [trim_at_contact(o, obstacles) for o in trials.observations]
    diagnosis: Diagnosis = call.by(
        call.setup.model,
        observations,
        trials.rejected,
        trials.held_out,
        obstacles,
        seed=call.seed,
        progress=call.progress,
    )
    return diagnosis


@declare_string_counts(lambda given: {"starts": STRINGS_PER_START * given["starts"]})
def diagnose(
    model: Model,
    observations: Sequence[Observation],
    rejected: Mapping[str, str],
    held_out: Sequence[str],
    obstacles: Sequence[Box],
    *,
    seed: int,
    starts: Annotated[int, Field(ge=2)],
    criteria: Criteria,
    matching: Matching,
    design: DesignSettings,
    excluded_effects: Annotated[Sequence[str], AfterValidator(check_effect_names)] = (),
    progress: Progress = lambda share: None,
) -> Diagnosis:
    """Find the effects that explain the misfit between a model and trials.

    Parameters
    ----------
    model : Model
        The base model.
    observations : sequence of Observation
        All trials.
    rejected : dict
        Names of trials that cannot be used, with the reason.
    held_out : sequence of str
        Names of trials in which the gain is measured. Without any, each trial is left
        out in turn.
    obstacles : sequence of Box
        Obstacles for the proposed motion.
    seed : int
        Seed of all random numbers.
    starts : int
        Number of starts of the base model's search.
    criteria : Criteria
        Thresholds of the rules.
    matching : Matching
        Settings of the matching rate.
    design : DesignSettings
        Settings of the motion that would distinguish look-alikes.
    excluded_effects : sequence of str
        Names of effects that are not candidates.
    progress : callable
        Called with the share of the search that is done.

    Returns
    -------
    Diagnosis
        The verdict with its evidence, diagnosis.json and the extended model.

    Raises
    ------
    DataError
        If no trial can be used.
    InterruptRequest
        If interrupted before there is a base model. A later interruption ends the
        search with the causes found so far.
    """
    usable, faults = usable_trials(model, observations)
    rejected = {**rejected, **faults}
    if not usable:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in rejected.items())
        raise DataError(
            "",
            f"No trial can be used ({reasons})",
            "Check the files it names.",
        )
    settings = DiagnosisSettings(
        model=model,
        obstacles=obstacles,
        seed=seed,
        starts=starts,
        criteria=criteria,
        matching=matching,
        design=design,
        excluded_effects=excluded_effects,
        progress=progress,
    )
    trials = TrialsByUse(usable, held_out, rejected)
    if not trials.searched_trials:
        trials = replace(trials, held_out_names=())
    with use_any_store():
        return _diagnose_trials(trials, settings)


def _diagnose_trials(trials: TrialsByUse, settings: DiagnosisSettings) -> Diagnosis:
    """Diagnose trials; repeat with all of them if held-out ones misfit otherwise."""
    criteria = settings.criteria
    seed = settings.seed
    reached = None
    try:
        # Base model, corrected data, and causes by forward selection. The search is a
        # generator, so that its progress is kept at an interruption.
        for reached in search_until_trials_settle(trials, settings):  # noqa: B007
            pass
        assert reached is not None
        used, prepared, effects, state = reached

        # Look-alikes of the accepted causes, and all probabilities
        competing = [effect for effect in effects if effect not in state.replaced]
        posteriors = swap_lookalikes_until_stable(state, competing, criteria, seed)
        state = posteriors.state
        misfit = misfit_probability(state.prepared.data, state.fit, criteria, seed)
        posteriors = limit_by_agreement(
            posteriors, misfit, len(effects), criteria.tip_tolerance_m
        )
        base_fit = fit_base_to(state)

        # The numbers of the verdict, and whether held-out trials misfit otherwise
        numbers = measure_verdict_numbers(posteriors, misfit, base_fit, criteria, seed)
        numbers = replace(
            numbers, mesh_too_coarse=_mesh_is_too_coarse(prepared, criteria)
        )
        is_named = bool(name_causes(numbers, criteria).causes)
        held_out = trials.held_out
        if not is_named and held_out_trials_misfit(state, held_out, criteria):
            log.info("held-out trials misfit: the search is repeated on all trials")
            return _diagnose_trials(replace(trials, held_out_names=()), settings)

        # The gain on trials that were not fitted, and the verdict
        gain = measure_gain(used, settings.matching, state, base_fit)
        numbers = gain.added_to(numbers, criteria)
        judgement = Judgement(
            decide_verdict(numbers, criteria),
            numbers,
            posteriors.by_cause,
            base_fit,
            posteriors.background,
        )
        experiment = _propose_experiment(state, judgement, settings)
        judgement = _with_trial_clocks(state, judgement, settings)
    except InterruptRequest:
        if reached is None:
            raise
        log.warning("interrupted: ending with the causes found so far")
        used, _, effects, state = reached
        judgement = judge_interrupted_search(state, effects, criteria, seed)
        gain = HeldOutGain(HELD_OUT.empty(), False)
        experiment = ProposedExperiment()
    log.info("verdict: %s", judgement.verdict.kind)
    return build_diagnosis(used, settings, state, judgement, gain, experiment)


def _mesh_is_too_coarse(prepared: PreparedData, criteria: Criteria) -> bool:
    """Return whether the configured mesh fits worse and moves the tip noticeably."""
    base = prepared.base_fit
    configured = prepared.configured_mesh_fit
    if configured is None or not has_evidence(configured, base, criteria):
        return False
    shift = tip_shift_rms(prepared.data, configured, base)
    return bool(shift.max() > criteria.tip_tolerance_m)


def _with_trial_clocks(
    state: SelectionState, judgement: Judgement, settings: DiagnosisSettings
) -> Judgement:
    """Find clocks that differ between trials, if misfit remains.

    Clocks that are in the model are known.
    """
    remains = misfit_remains(judgement.verdict.misfit_probability)
    if not remains or TimeOffset in settings.model.effects:
        return judgement
    log.info("comparing the clocks of the trials")
    reported = _reported_state(state, judgement)
    trial_clocks = find_trial_clocks(reported.prepared.data, reported.fit)
    return replace(judgement, trial_clocks=trial_clocks)


def _reported_state(state: SelectionState, judgement: Judgement) -> SelectionState:
    """Return the state with the base model if none of its causes is named."""
    final_causes = set(state.fit.hypothesis.cause_names)
    if final_causes.isdisjoint(judgement.verdict.causes):
        return replace(state, fit=judgement.base_fit)
    return state


def _propose_experiment(
    state: SelectionState,
    judgement: Judgement,
    settings: DiagnosisSettings,
) -> ProposedExperiment:
    """Propose the motion that distinguishes the first group of look-alikes."""
    names = list[str]()
    for group in judgement.verdict.lookalike_groups[:1]:
        names += group
    fits = {name: tables.fit_containing(state, judgement, name) for name in names}
    log_odds = settings.criteria.deciding_log_odds
    rivals = Rivals(fits, state.prepared.data, log_odds)
    rng = np.random.default_rng([settings.seed, DESIGN_RANDOM_STREAM])
    return design_experiment(rivals, settings.obstacles, settings.design, rng)


def build_diagnosis(
    trials: TrialsByUse,
    settings: DiagnosisSettings,
    state: SelectionState,
    judgement: Judgement,
    gain: HeldOutGain,
    experiment: ProposedExperiment,
) -> Diagnosis:
    """Assemble the artifact; it shows the base model if no cause is named."""
    data = state.prepared.data
    base_fit = judgement.base_fit
    reported = _reported_state(state, judgement)
    # A random stream separate from those of the fits
    rng = np.random.default_rng([settings.seed, len(data.trials)])
    budget = error_budget(reported, base_fit, rng)
    # Causes that were found but not named have entries, too
    entered_fits: Sequence[Fit] = budget.nested_fits
    if reported is not state:
        entered_fits = nested_fits(state, base_fit)
    causes = tables.causes_table(reported, judgement, settings.interval_half_width)
    finding = _finding_table(
        trials,
        settings,
        reported,
        judgement,
        gain,
        experiment,
        budget,
        causes,
    )
    criteria = settings.criteria
    return Diagnosis(
        finding=finding,
        causes=causes,
        held_out=gain.table,
        residuals=tables.residuals_table(state.prepared, base_fit, reported.fit),
        hypotheses=tables.hypotheses_table(
            state,
            budget.nested_fits,
            judgement,
            criteria.tip_tolerance_m,
        ),
        entries=tables.entries_table(data, entered_fits),
        screening=tables.screening_table(state),
        likeness=tables.likeness_table(state),
        missing=tables.missing_table(data, reported.fit, criteria),
        commands=experiment.commands,
        control_points=experiment.control_points,
        predicted=experiment.predicted,
    )


def effects_not_tried(
    settings: DiagnosisSettings, state: SelectionState
) -> dict[str, str]:
    """Return the reason for each effect of the library that was not tried, by name."""
    library = effects_by_name()
    base = state.prepared.base_fit.hypothesis.model
    trials = state.prepared.data.trials
    reasons = effects_left_out(base, library, trials, settings.excluded_effects)
    if state.steps:
        tried = set(state.fit.hypothesis.cause_names)
        tried |= {proposal.effect.name for proposal in state.steps[0].proposals}
        for name in library.keys() - reasons.keys() - tried:
            reasons[name] = "it can do nothing in these trials"
    return dict(sorted(reasons.items()))


def _finding_table(
    trials: TrialsByUse,
    settings: DiagnosisSettings,
    reported: SelectionState,
    judgement: Judgement,
    gain: HeldOutGain,
    experiment: ProposedExperiment,
    budget: ErrorBudget,
    causes: pd.DataFrame,
) -> pd.DataFrame:
    """Build the table FINDING: the verdict, diagnosis.json and extended.yaml."""
    data = reported.prepared.data
    verdict = judgement.verdict
    half_width = settings.interval_half_width
    base, extended = (
        parameter_uncertainty(data, fit, judgement.background, half_width)
        for fit in (judgement.base_fit, reported.fit)
    )
    trials_used = trials_document(reported.prepared, trials.left_out)
    unexplained = unexplained_document(
        data, reported.fit, judgement, budget, settings.criteria
    )
    clocks = clocks_document(judgement.trial_clocks)
    document = {
        "format": FORMAT_VERSION,
        "verdict": verdict.kind,
        "interrupted": judgement.interrupted,
        "causes": [cause_document(causes, name) for name in verdict.causes],
        "alternatives": alternatives_document(judgement),
        "set_aside": effects_with_reasons(reported.set_aside),
        "not_tried": effects_with_reasons(effects_not_tried(settings, reported)),
        "indistinguishable": [list(group) for group in verdict.lookalike_groups],
        "base": {"parameters": judgement.base_fit.values, **base},
        "extended": extended,
        "gain": gain_document(gain.table, trials_used["used"]),
        "unexplained": unexplained,
        "clocks": clocks,
        "budget": budget_document(budget),
        "trials": trials_used,
        "next_experiment": experiment.next_experiment,
    }
    sentences = verdict_sentences(judgement, causes, unexplained["sentence"])
    sentences.append(clocks["sentence"])
    if trials.left_out:
        sentences.append(f"Left out: {describe_rejected(trials.left_out)}.")
    row = {
        "verdict": verdict.kind,
        "sentence": " ".join(filter(None, sentences)),
        "diagnosis": json.dumps(replace_non_finite(document), indent=2),
        "extended": _extended_model_yaml(
            settings.model, reported.fit, extended["intervals"]
        ),
    }
    return DIAGNOSIS_SUMMARY.check(pd.DataFrame([row]))


def _extended_model_yaml(
    model: Model,
    fit: Fit,
    intervals: Mapping[str, Sequence[float]],
) -> str:
    """Write the model with its causes as settings; a header marks a base model."""
    cause_intervals = {}
    for cause in fit.hypothesis.causes:
        for parameter in cause.qualified_parameters():
            cause_intervals[parameter.name] = intervals[parameter.name]
    extended = extended_model_settings(model, fit, cause_intervals)
    text = yaml.safe_dump(extended, sort_keys=False)
    return mark_yaml_end(text if cause_intervals else BASE_MODEL_HEADER + text)
