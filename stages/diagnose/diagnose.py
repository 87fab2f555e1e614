"""The diagnosis: from trials and a model to a verdict with its evidence."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
import pandas as pd
import yaml
from pydantic import AfterValidator, Field
from scipy.stats import norm

from stringcast.data.artifacts import (
    DIAGNOSIS_SUMMARY,
    HELD_OUT,
    Diagnosis,
    Observation,
    TrialSet,
)
from stringcast.data.schema import DataError
from stringcast.stages.common import InterruptRequest, Progress
from stringcast.stages.diagnose import tables
from stringcast.stages.diagnose.background_effects import posterior_with_background
from stringcast.stages.diagnose.budget import ErrorBudget, error_budget, nested_fits
from stringcast.stages.diagnose.candidate_motions import DesignSettings
from stringcast.stages.diagnose.chaos import unresolvable_trials
from stringcast.stages.diagnose.document import (
    diagnosis_document,
    extended_model_settings,
    replace_non_finite,
    unexplained_document,
    verdict_sentence,
)
from stringcast.stages.diagnose.experiment_design import (
    ProposedExperiment,
    Rivals,
    design_experiment,
)
from stringcast.stages.diagnose.forward_selection import SelectionState, select_causes
from stringcast.stages.diagnose.measures import (
    mean_explained_fraction,
    tip_shift_rms,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.posteriors import swap_lookalikes_until_stable
from stringcast.stages.diagnose.predictions import (
    held_out_table,
    predict_left_out_trials,
    predict_trials,
    predicts_better,
)
from stringcast.stages.diagnose.preparation import (
    prepare_data,
    prepare_further_trials,
    usable_trials,
)
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.diagnose.proposals import candidate_effects
from stringcast.stages.diagnose.rules import Criteria, VerdictNumbers, has_evidence
from stringcast.stages.diagnose.verdict import (
    RESOLUTION,
    Judgement,
    decide_verdict,
    fit_base_to,
    judge_interrupted_search,
    measure_verdict_numbers,
    name_causes,
)
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.estimate.trim import trim_at_contact
from stringcast.stages.inference.laplace import Fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.box import Box
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.library import check_effect_names, effects_by_name
from stringcast.stages.model.model import Model
from stringcast.stages.spec import StageCall

log = logging.getLogger(__name__)

# Intervals are so much wider than the likelihood's: 95 % of 165 values of earlier
# synthetic datasets then lie inside, 87 % without
INTERVAL_WIDENING = 1.4
# keeps the random motions apart from the random starts of fits
DESIGN_RANDOM_STREAM = 1
CHAOTIC_REASON = "too sensitive to be simulated to the tolerance; excluded"
BASE_MODEL_HEADER = "# No effect is named: this is the base model.\n"


def run(call: StageCall, trials: TrialSet) -> Diagnosis:
    """Diagnose all trials, up to where their string touches an obstacle, as a stage.

    Parameters
    ----------
    call : StageCall
    trials : TrialSet

    Returns
    -------
    Diagnosis
    """
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
    observations : sequence of Observation
    rejected : dict
        Names of trials that cannot be used, with the reason.
    held_out : sequence of str
        Names of trials in which the gain is measured. Without any, each trial is left
        out in turn.
    obstacles : sequence of Box
        That the proposed motion avoids.
    seed : int
    starts : int
        Number of starts of the base model's search.
    criteria : Criteria
    matching : Matching
        How the matching rate is counted.
    design : DesignSettings
        Of the motion that would decide between look-alikes.
    excluded_effects : sequence of str
        Names of effects that are no candidates.
    progress : callable

    Returns
    -------
    Diagnosis

    Raises
    ------
    DataError
        If no trial can be used.
    InterruptRequest
        If interrupted before there is a base model. An interruption after that ends
        the search with what is known.
    """
    data = _separate_trials(model, observations, rejected, held_out, criteria, matching)
    reached = None
    try:
        # Base model, corrected data, and causes by forward selection
        search = _search_until_trials_settle(
            data, excluded_effects, seed, starts, progress
        )
        for reached in search:  # noqa: B007, an interruption needs the last one
            pass
        assert reached is not None
        searched, prepared, effects, state = reached

        # Look-alikes of the accepted causes, and all probabilities
        posteriors = swap_lookalikes_until_stable(state, effects, criteria, seed)
        state = posteriors.state
        base_fit = fit_base_to(state)

        # The numbers that decide, and whether held-out trials show something else
        numbers = measure_verdict_numbers(posteriors, base_fit, criteria, seed)
        numbers = replace(
            numbers, mesh_too_coarse=_mesh_is_too_coarse(prepared, criteria)
        )
        is_named = bool(name_causes(numbers, criteria).causes)
        if (
            searched.held_out
            and not is_named
            and _heldout_trials_misfit(state, searched)
        ):
            log.info("held-out trials misfit: the search is repeated on all trials")
            return diagnose(
                model,
                data.observations,
                data.rejected,
                (),
                obstacles,
                seed=seed,
                starts=starts,
                criteria=criteria,
                matching=matching,
                design=design,
                excluded_effects=excluded_effects,
                progress=progress,
            )

        # The gain on trials that were not fitted, and the verdict
        gain = _measure_gain(searched, state, base_fit)
        numbers = gain.added_to(numbers, criteria)
        judgement = Judgement(
            decide_verdict(numbers, criteria),
            numbers,
            posteriors.by_cause,
            base_fit,
            posteriors.background,
        )
        experiment = _propose_experiment(
            state, judgement, criteria, obstacles, design, seed
        )
    except InterruptRequest:
        if reached is None:
            raise
        return _interrupted_diagnosis(reached, seed)
    log.info("verdict: %s", judgement.verdict.kind)
    return build_diagnosis(searched, state, judgement, gain, experiment, seed)


@dataclass(frozen=True)
class DiagnosisInput:
    """Trials by their use.

    Attributes
    ----------
    model : Model
    observations : sequence of Observation
        All trials that can be used.
    rejected : dict
        Names of other trials, with the reason.
    searched, held_out : sequence of int
        Indices of the trials in which causes are searched, and of those in which only
        the gain is measured.
    """

    model: Model
    observations: Sequence[Observation]
    rejected: Mapping[str, str]
    searched: Sequence[int]
    held_out: Sequence[int]
    criteria: Criteria
    matching: Matching

    @property
    def searched_trials(self) -> list[Observation]:
        """The trials in which causes are searched."""
        return [self.observations[index] for index in self.searched]

    @property
    def heldout_trials(self) -> list[Observation]:
        """The trials in which only the gain is measured."""
        return [self.observations[index] for index in self.held_out]

    @property
    def interval_half_width(self) -> float:
        """Half width of an interval in standard deviations of the likelihood."""
        normal = float(norm.ppf(0.5 + self.criteria.coverage / 2))
        return INTERVAL_WIDENING * normal

    def without_chaotic(self, names: Sequence[str]) -> DiagnosisInput:
        """Exclude chaotic trials from the search."""
        searched = [k for k in self.searched if self.observations[k].trial not in names]
        rejected = {**self.rejected, **dict.fromkeys(names, CHAOTIC_REASON)}
        return replace(self, searched=searched, rejected=rejected)


class SearchProgress(NamedTuple):
    """How far a search has come; `prepared` is the base model, before any cause."""

    data: DiagnosisInput
    prepared: PreparedData
    effects: list[type[Effect]]
    state: SelectionState


def _separate_trials(
    model: Model,
    observations: Sequence[Observation],
    rejected: Mapping[str, str],
    held_out_names: Sequence[str],
    criteria: Criteria,
    matching: Matching,
) -> DiagnosisInput:
    """Separate usable trials into searched and held-out ones.

    All are searched where all are held out.
    """
    usable, faults = usable_trials(model, observations)
    rejected = {**rejected, **faults}
    if not usable:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in rejected.items())
        raise DataError(f"No trial can be used ({reasons}). Check the files it names.")
    held_out = [k for k, o in enumerate(usable) if o.trial in held_out_names]
    if len(held_out) == len(usable):
        held_out = []
    searched = [k for k in range(len(usable)) if k not in held_out]
    return DiagnosisInput(
        model, usable, rejected, searched, held_out, criteria, matching
    )


def _search_until_trials_settle(
    data: DiagnosisInput,
    excluded_effects: Sequence[str],
    seed: int,
    starts: int,
    progress: Progress,
) -> Iterator[SearchProgress]:
    """Search causes, and again while the causes change which trials are resolved.

    A trial that is chaotic without causes is used from then on if a simulation with
    causes resolves it; one that is chaotic with causes is excluded.
    """
    criteria = data.criteria
    keep_if_chaotic = list[str]()
    while True:
        log.info("fitting the base model")
        rng = np.random.default_rng(seed)
        prepared = prepare_data(
            data.model,
            data.searched_trials,
            criteria.tip_tolerance_m,
            rng,
            starts,
            lambda share: progress(0.3 * share),
            keep_if_chaotic,
        )
        base_model = prepared.base_fit.hypothesis.model
        trials = prepared.data.trials
        effects = candidate_effects(
            base_model, effects_by_name(), trials, excluded_effects
        )
        resolved = data.without_chaotic(prepared.chaotic_trials)
        state = SelectionState(prepared, prepared.base_fit)
        yield SearchProgress(resolved, prepared, effects, state)

        newly_resolved = list[str]()
        states = select_causes(prepared, effects, criteria, seed, starts)
        for number, state in enumerate(states, 1):
            progress(0.3 + 0.5 * number / (criteria.max_causes + 1))
            newly_resolved = _trials_resolved_with_causes(state, data)
            if newly_resolved:
                break
            yield SearchProgress(resolved, prepared, effects, state)

        chaotic = list[str]()
        if state.fit.hypothesis.causes:
            chaotic = unresolvable_trials(state.prepared, criteria.tip_tolerance_m)
        if newly_resolved:
            log.info("resolved with the causes: %s", ", ".join(newly_resolved))
            keep_if_chaotic += newly_resolved
        elif chaotic:
            log.info("chaotic with the causes: %s", ", ".join(chaotic))
            data = data.without_chaotic((*prepared.chaotic_trials, *chaotic))
        else:
            return


def _trials_resolved_with_causes(
    state: SelectionState, data: DiagnosisInput
) -> list[str]:
    """Name trials that are chaotic without the causes and resolved with them.

    Numerical error is also large where a string without the causes is bent to what
    they do.
    """
    chaotic_names = state.prepared.chaotic_trials
    chaotic = [o for o in data.searched_trials if o.trial in chaotic_names]
    if not chaotic or not state.fit.hypothesis.causes:
        return []
    _, uncertainty_m = prepare_further_trials(state.prepared, chaotic, state.fit)
    is_resolved = uncertainty_m < data.criteria.tip_tolerance_m
    return [
        o.trial for o, resolved in zip(chaotic, is_resolved, strict=True) if resolved
    ]


def _mesh_is_too_coarse(prepared: PreparedData, criteria: Criteria) -> bool:
    """Whether the configured mesh fits worse and displaces the tip noticeably."""
    base = prepared.base_fit
    configured = prepared.configured_mesh_fit
    if configured is None or not has_evidence(configured, base, criteria):
        return False
    shift = tip_shift_rms(prepared.data, configured, base)
    return bool(shift.max() > criteria.tip_tolerance_m)


def _heldout_trials_misfit(state: SelectionState, data: DiagnosisInput) -> bool:
    """Whether held-out trials misfit by more than the tolerance.

    The model is fitted to them as well: what the searched trials leave open of its
    parameters is no cause.
    """
    known = state.prepared.data
    fit = state.fit
    further, _ = prepare_further_trials(state.prepared, data.heldout_trials, fit)
    varying = {
        name: known.random_effects[name] + further.random_effects[name]
        for name in known.random_effects.keys() & further.random_effects.keys()
    }
    together = TrialData(known.trials + further.trials, varying)
    sizes = np.concatenate(
        [fit.scale_indices, np.zeros(len(further.trials), dtype=int)]
    )
    refit = fit_hypothesis(together, fit.hypothesis, fit.chi[None], sizes)
    misfit_m = unexplained_tip_rms(together, refit)[len(known.trials) :]
    return bool(misfit_m.max() > data.criteria.tip_tolerance_m)


@dataclass(frozen=True)
class HeldOutGain:
    """The gain on trials that were not fitted.

    Attributes
    ----------
    table : pandas.DataFrame
        HELD_OUT, empty where nothing could be left out.
    is_closer : bool
        Whether the extended model predicts these trials better than the base model.
    """

    table: pd.DataFrame
    is_closer: bool

    def added_to(self, numbers: VerdictNumbers, criteria: Criteria) -> VerdictNumbers:
        """Add the gain to the numbers of a verdict."""
        if not len(self.table):
            return replace(numbers, heldout_is_closer=self.is_closer)
        fraction = mean_explained_fraction(
            self.table["tip_rms_base"].to_numpy(),
            self.table["tip_rms_extended"].to_numpy(),
            criteria.tip_tolerance_m,
        )
        return replace(
            numbers,
            heldout_is_closer=self.is_closer,
            heldout_explained_fraction=fraction,
        )


def _measure_gain(
    data: DiagnosisInput, state: SelectionState, base_fit: Fit
) -> HeldOutGain:
    """Predict held-out trials, or else each trial by the fit to the others."""
    if len(data.observations) == 1:
        return HeldOutGain(HELD_OUT.empty(), False)
    fit = state.fit
    trials = state.prepared.data
    if data.held_out:
        observations = data.heldout_trials
        trials, _ = prepare_further_trials(state.prepared, observations, fit)
        predict = predict_trials
        extended = predict(trials, fit)
    else:
        observations = data.searched_trials
        predict = predict_left_out_trials
        extended = state.predictions
    base = extended
    if base_fit is not fit:
        base = predict(trials, base_fit)
    table = held_out_table(trials, base, extended, fit, observations, data.matching)
    return HeldOutGain(table, predicts_better(base, extended))


def _propose_experiment(
    state: SelectionState,
    judgement: Judgement,
    criteria: Criteria,
    obstacles: Sequence[Box],
    design: DesignSettings,
    seed: int,
) -> ProposedExperiment:
    """Propose the motion that distinguishes the first group of look-alikes."""
    groups = judgement.verdict.lookalike_groups
    names = groups[0] if groups else ()
    fits = {
        name: tables.fit_containing(state, judgement, name)
        for name in names
        if name != RESOLUTION
    }
    rivals = Rivals(fits, state.prepared.data, criteria.deciding_log_odds)
    rng = np.random.default_rng([seed, DESIGN_RANDOM_STREAM])
    return design_experiment(rivals, obstacles, design, rng)


def _interrupted_diagnosis(reached: SearchProgress, seed: int) -> Diagnosis:
    """Build the diagnosis of a search that was interrupted."""
    log.warning("interrupted: ending with what is known")
    data, _, effects, state = reached
    judgement = judge_interrupted_search(state, effects, data.criteria, seed)
    gain = HeldOutGain(HELD_OUT.empty(), False)
    return build_diagnosis(data, state, judgement, gain, ProposedExperiment(), seed)


def build_diagnosis(
    data: DiagnosisInput,
    state: SelectionState,
    judgement: Judgement,
    gain: HeldOutGain,
    experiment: ProposedExperiment,
    seed: int,
) -> Diagnosis:
    """Assemble the artifact; it shows the base model where no found cause is named."""
    trials = state.prepared.data
    base_fit = judgement.base_fit
    is_named = bool(
        set(judgement.verdict.causes) & set(state.fit.hypothesis.cause_names)
    )
    shown = state if is_named else replace(state, fit=base_fit)
    rng = np.random.default_rng([seed, len(trials.trials)])
    budget = error_budget(shown, base_fit, rng)
    nested = budget.nested_fits if is_named else nested_fits(state, base_fit)
    causes = tables.causes_table(shown, judgement, data.interval_half_width)
    finding = _finding_table(data, shown, judgement, gain, experiment, budget, causes)
    tolerance_m = data.criteria.tip_tolerance_m
    return Diagnosis(
        finding=finding,
        causes=causes,
        held_out=gain.table,
        residuals=tables.residuals_table(state.prepared, base_fit, shown.fit),
        hypotheses=tables.hypotheses_table(
            state, budget.nested_fits, judgement, tolerance_m
        ),
        entries=tables.entries_table(trials, nested),
        screening=tables.screening_table(state),
        likeness=tables.likeness_table(state),
        missing=tables.missing_table(trials, shown.fit, data.criteria),
        commands=experiment.commands,
        control_points=experiment.control_points,
        predicted=experiment.predicted,
    )


def _finding_table(
    data: DiagnosisInput,
    shown: SelectionState,
    judgement: Judgement,
    gain: HeldOutGain,
    experiment: ProposedExperiment,
    budget: ErrorBudget,
    causes: pd.DataFrame,
) -> pd.DataFrame:
    """Build the table FINDING: the verdict, diagnosis.json and extended.yaml."""
    trials = shown.prepared.data
    fit = shown.fit
    base_fit = judgement.base_fit
    certainty = {}
    for name, one in (("base", base_fit), ("extended", fit)):
        tempered_fit = posterior_with_background(trials, one, judgement.background)
        half_width = data.interval_half_width
        certainty[name] = tables.parameter_uncertainty(one, tempered_fit, half_width)
    left = unexplained_document(trials, fit, base_fit, judgement, budget, data.criteria)
    text = diagnosis_document(
        shown.prepared,
        base_fit,
        judgement,
        budget,
        causes,
        gain.table,
        data.rejected,
        left,
        experiment.next_experiment,
        certainty,
    )
    sentences = (verdict_sentence(judgement, causes), str(left["sentence"]))
    row = {
        "verdict": judgement.verdict.kind,
        "sentence": " ".join(filter(None, sentences)),
        "diagnosis": json.dumps(replace_non_finite(text), indent=2),
        "extended": _extended_model_yaml(data, fit, certainty["extended"]["intervals"]),
    }
    return DIAGNOSIS_SUMMARY.check(pd.DataFrame([row]))


def _extended_model_yaml(
    data: DiagnosisInput, fit: Fit, intervals: Mapping[str, Sequence[float]]
) -> str:
    """Write the model with its causes as settings; a header marks a base model."""
    parameters = [
        c.qualified_name(p) for c in fit.hypothesis.causes for p in c.parameters
    ]
    known = {name: intervals[name] for name in parameters}
    text = yaml.safe_dump(
        extended_model_settings(data.model, fit, known), sort_keys=False
    )
    return text if parameters else BASE_MODEL_HEADER + text
