"""The diagnosis: from trials and a model to a verdict with its evidence."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
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
from stringcast.stages.diagnose.forward_selection import (
    Criteria,
    SelectionState,
    mean_explained_fraction,
    select_causes,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.predictions import (
    held_out_table,
    predict_trials,
    predicts_better,
)
from stringcast.stages.diagnose.prepared_data import (
    PreparedData,
    prepare_data,
    unresolvable_trials,
    usable_trials,
)
from stringcast.stages.diagnose.proposals import candidate_effects
from stringcast.stages.diagnose.verdict import (
    RESOLUTION,
    Judgement,
    judge_interrupted_search,
    swap_lookalikes_until_stable,
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

# times the deviations of a likelihood: 95 % of 165 values of earlier benches then lie
# inside, 87 % without
INTERVAL_WIDENING = 1.4
DESIGN_RANDOM_STREAM = 1  # keeps the chance of the design apart from that of the fits
CHAOTIC_REASON = (
    "it is so sensitive that no simulation tells it to the tolerance; it was set aside"
)
SINGLE_TRIAL_REMARK = "Causes can be sought in one trial only: what is found in it could not be checked on another"
BASE_MODEL_HEADER = (
    "# There is no extended model, for no effect is named. This is the base model.\n"
)


def run(call: StageCall, trials: TrialSet) -> Diagnosis:
    """The diagnosis of all trials until their string touches an obstacle, as a stage."""
    setup = call.setup
    seen = [trim_at_contact(trial, setup.obstacles) for trial in trials.observations]
    given = (setup.model, seen, trials.rejected, trials.held_out, setup.obstacles)
    made: Diagnosis = call.by(*given, seed=call.seed, progress=call.progress)
    return made


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
    without: Annotated[Sequence[str], AfterValidator(check_effect_names)] = (),
    progress: Progress = lambda share: None,
) -> Diagnosis:
    """What the model gets wrong in these trials, and why.

    rejected: trials that cannot be used, with the reason. held_out: names of trials
    kept for measuring the gain; where there are none, each is left out in turn. starts:
    of the base model's search. matching: how E is counted. design: of the motion that
    would decide between look-alikes, clear of the obstacles. without: effects that are
    no candidates. Interrupted (`Enough`) after the base model, it ends with what it
    knows. Raises DataError without a trial to use.
    """
    asked, reached = (
        _diagnosis_input(model, observations, rejected, held_out, criteria, matching),
        None,
    )
    try:
        for reached in _search_until_trials_settle(
            asked, without, seed, starts, progress
        ):
            given, ready, effects, found = reached
        found, judgement = swap_lookalikes_until_stable(
            found, effects, criteria, _mesh_is_too_coarse(ready, criteria), seed
        )
        if (
            given.heldout_indices
            and not judgement.causes
            and _heldout_trials_misfit(found, given.heldout_trials, criteria)
        ):
            log.info(
                "the trials set aside show what the others do not: they are looked at as well"
            )
            again = partial(
                diagnose,
                seed=seed,
                starts=starts,
                criteria=criteria,
                matching=matching,
                design=design,
            )
            return again(
                model,
                asked.observations,
                asked.rejected,
                (),
                obstacles,
                without=without,
                progress=progress,
            )
        gained = _heldout_gain(given, found, judgement.base_fit)
        judgement = _require_predictive_gain(
            judgement, gained, len(given.search_indices), criteria
        )
        proposal = _propose_experiment(
            found, judgement, criteria, obstacles, design, seed
        )
    except InterruptRequest:
        if reached is None:
            raise
        return _interrupted_diagnosis(reached, seed)
    log.info("verdict: %s", judgement.verdict)
    return build_diagnosis(given, found, judgement, gained, proposal, seed)


@dataclass(frozen=True)
class DiagnosisInput:
    """What was given: trials, those rejected with the reason, numbers of those causes
    are sought in and of the rest.
    """

    model: Model
    observations: Sequence[Observation]
    rejected: Mapping[str, str]
    search_indices: Sequence[int]
    heldout_indices: Sequence[int]
    criteria: Criteria
    matching: Matching

    @property
    def search_trials(self) -> list[Observation]:
        """The trials in which causes are sought."""
        return [self.observations[i] for i in self.search_indices]

    @property
    def heldout_trials(self) -> list[Observation]:
        """The rest."""
        return [self.observations[i] for i in self.heldout_indices]

    @property
    def interval_half_width(self) -> float:
        """Half width of an interval, in standard deviations as the likelihood has them."""
        return INTERVAL_WIDENING * float(norm.ppf(0.5 + self.criteria.coverage / 2))

    def without_chaotic(self, chaotic: Sequence[str]) -> DiagnosisInput:
        """Causes are not sought in these trials."""
        kept = [
            i for i in self.search_indices if self.observations[i].trial not in chaotic
        ]
        return replace(
            self,
            search_indices=kept,
            rejected={**self.rejected, **dict.fromkeys(chaotic, CHAOTIC_REASON)},
        )


class SearchProgress(NamedTuple):
    """How far a search has come. ready: the base model, before any cause."""

    diagnosis_input: DiagnosisInput
    prepared: PreparedData
    effects: list[type[Effect]]
    state: SelectionState


def _diagnosis_input(
    model: Model,
    observations: Sequence[Observation],
    rejected: Mapping[str, str],
    held_out: Sequence[str],
    criteria: Criteria,
    matching: Matching,
) -> DiagnosisInput:
    """The trials that can be used; all but those held out are asked, unless that is
    none. Raises DataError where none can be used.
    """
    good, faults = usable_trials(model, observations)
    rejected = {**rejected, **faults}
    if not good:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in rejected.items())
        raise DataError(
            f"there is no trial that can be used ({reasons}). Look at the files it names."
        )
    rest = [i for i, o in enumerate(good) if o.trial in held_out]
    rest = rest if len(rest) < len(good) else []
    kept = [i for i in range(len(good)) if i not in rest]
    return DiagnosisInput(model, good, rejected, kept, rest, criteria, matching)


def _search_until_trials_settle(
    given: DiagnosisInput,
    without: Sequence[str],
    seed: int,
    starts: int,
    progress: Progress,
) -> Iterator[SearchProgress]:
    """Base model and candidates, without causes and with one after another. Trials that
    no simulation with the causes tells are set aside, as those that none without them
    does, unless it tells them with the causes; then the others, or they as well, are
    asked anew.
    """
    criteria, trusted = given.criteria, list[str]()
    while True:
        log.info("fitting the base model")
        rng = np.random.default_rng(seed)
        ready = prepare_data(
            given.model,
            given.search_trials,
            criteria.tolerance,
            rng,
            starts,
            lambda share: progress(0.3 * share),
            trusted,
        )
        effects = candidate_effects(
            ready.base_fit.hypothesis.model,
            effects_by_name(),
            ready.data.trials,
            without,
        )
        good = given.without_chaotic(ready.chaotic_trials)
        yield SearchProgress(
            good, ready, effects, SelectionState(ready, ready.base_fit)
        )
        for number, found in enumerate(
            select_causes(ready, effects, criteria, seed, starts), 1
        ):
            progress(0.3 + 0.5 * number / (criteria.causes + 1))
            if told := _trials_resolved_with_causes(found, given):
                break
            yield SearchProgress(good, ready, effects, found)
        if told:
            log.info("told with the causes found: %s", ", ".join(told))
            trusted += told
        elif chaotic := _trials_chaotic_with_causes(found, criteria):
            log.info("chaotic with the causes found: %s", ", ".join(chaotic))
            given = given.without_chaotic((*ready.chaotic_trials, *chaotic))
        else:
            return


def _interrupted_diagnosis(reached: SearchProgress, seed: int) -> Diagnosis:
    """The diagnosis of a search that was interrupted."""
    log.warning("interrupted: ending with what is known")
    judgement = judge_interrupted_search(
        reached.state, reached.effects, reached.diagnosis_input.criteria, seed
    )
    nothing = HeldOutGain(HELD_OUT.empty(), False)
    return build_diagnosis(
        reached.diagnosis_input,
        reached.state,
        judgement,
        nothing,
        ProposedExperiment(),
        seed,
    )


def _trials_chaotic_with_causes(found: SelectionState, criteria: Criteria) -> list[str]:
    """Trials that are chaotic with the causes; those that are without any were set
    aside before.
    """
    return (
        unresolvable_trials(found.prepared, criteria.tolerance)
        if found.fit.hypothesis.causes
        else []
    )


def _trials_resolved_with_causes(
    found: SelectionState, given: DiagnosisInput
) -> list[str]:
    """Trials that are chaotic without the causes, and are not with them: numerical
    error is large, too, where a string without them must be bent to what they do.
    """
    aside = [
        observation
        for observation in given.search_trials
        if observation.trial in found.prepared.chaotic_trials
    ]
    if not aside or not found.fit.hypothesis.causes:
        return []
    doubt = found.prepared.prepare_further_trials(aside, found.fit)[1]
    return [
        o.trial
        for o, each in zip(aside, doubt, strict=True)
        if each < given.criteria.tolerance
    ]


def _require_predictive_gain(
    judgement: Judgement, gained: HeldOutGain, trials: int, criteria: Criteria
) -> Judgement:
    """As far as it can be checked: what is found in one trial not at all, in several by
    those left out. Where more is left than is tolerated, it must remove the least share
    of what is lacking in those, too.
    """
    if judgement.verdict in ("none", "insufficient") or judgement.causes == (
        RESOLUTION,
    ):
        return judgement
    if trials == 1:
        likely = [
            f"{name} ({chance:.2f})"
            for name, chance in judgement.inclusion_probability.items()
            if chance > 0.5
        ]
        said = (
            f"{SINGLE_TRIAL_REMARK}; there it is {', '.join(likely)}"
            if likely
            else SINGLE_TRIAL_REMARK
        )
        return replace(
            judgement,
            verdict="insufficient",
            causes=(),
            lookalike_groups=(),
            remark=f"{said}.",
        )
    enough = (
        judgement.misfit_probability <= 0.5
        or gained.explained_fraction(criteria.tolerance) >= criteria.least_share
    )
    return judgement if gained.predicts_better and enough else judgement.as_unknown


def _mesh_is_too_coarse(ready: PreparedData, criteria: Criteria) -> bool:
    """Whether the configured mesh is worse than one that does not matter, and has the
    tip farther away than is tolerated.
    """
    own = ready.configured_mesh_fit
    if (
        own is None
        or ready.base_fit.log_evidence - own.log_evidence
        < criteria.min_log_bayes_factor
    ):
        return False
    apart = [
        each - base
        for each, base in zip(own.residuals, ready.base_fit.residuals, strict=True)
    ]
    return bool(ready.data.tip_rms_by_trial(apart).max() > criteria.tolerance)


def _heldout_trials_misfit(
    found: SelectionState, observations: Sequence[Observation], criteria: Criteria
) -> bool:
    """Whether trials that were set aside lack more at the tip than is tolerated, the
    model fitted to them as well: what the others leave open of its parameters is no
    cause.
    """
    seen, aside = (
        found.prepared.data,
        found.prepared.prepare_further_trials(observations, found.fit)[0],
    )
    varying = {
        name: seen.random_effects[name] + aside.random_effects[name]
        for name in seen.random_effects.keys() & aside.random_effects.keys()
    }
    data = TrialData(seen.trials + aside.trials, varying)
    sizes = np.concatenate(
        [found.fit.scale_indices, np.zeros(len(aside.trials), dtype=int)]
    )
    fit = fit_hypothesis(data, found.fit.hypothesis, found.fit.chi[None], sizes)
    return bool(
        unexplained_tip_rms(data, fit)[len(seen.trials) :].max() > criteria.tolerance
    )


def _propose_experiment(
    found: SelectionState,
    judgement: Judgement,
    criteria: Criteria,
    obstacles: Sequence[Box],
    design: DesignSettings,
    seed: int,
) -> ProposedExperiment:
    """The motion that would tell the first group of look-alikes apart."""
    group = judgement.lookalike_groups[0] if judgement.lookalike_groups else ()
    fits = {
        name: tables.fit_containing(found, judgement, name)
        for name in group
        if name != RESOLUTION
    }
    odds = float(np.log(criteria.coverage / (1 - criteria.coverage)))
    return design_experiment(
        Rivals(fits, found.prepared.data, odds),
        obstacles,
        design,
        np.random.default_rng([seed, DESIGN_RANDOM_STREAM]),
    )


@dataclass(frozen=True)
class HeldOutGain:
    """held_out: table HELD_OUT. better: whether the extended model predicts trials left
    out better than the base.
    """

    table: pd.DataFrame
    predicts_better: bool

    def explained_fraction(self, tolerance: float) -> float:
        """Share of what the base model lacks at the tips of trials left out that the
        extended model does not.
        """
        before, after = (
            self.table[f"tip_rms_{side}"].to_numpy() for side in ("base", "extended")
        )
        return mean_explained_fraction(before, after, tolerance)


def build_diagnosis(
    given: DiagnosisInput,
    found: SelectionState,
    judgement: Judgement,
    gained: HeldOutGain,
    proposal: ProposedExperiment,
    seed: int,
) -> Diagnosis:
    """The artifact: of the base model alone, beside all hypotheses, where none of the
    causes found is named.
    """
    data, named = (
        found.prepared.data,
        set(judgement.causes) & set(found.fit.hypothesis.cause_names),
    )
    shown = found if named else replace(found, fit=judgement.base_fit)
    budget = error_budget(
        shown, judgement.base_fit, np.random.default_rng([seed, len(data.trials)])
    )
    causes = tables.causes_table(shown, judgement, given.interval_half_width)
    return Diagnosis(
        _finding_table(given, shown, judgement, gained, proposal, budget, causes),
        causes,
        gained.table,
        tables.residuals_table(found.prepared, judgement.base_fit, shown.fit),
        tables.hypotheses_table(
            found, budget.nested_fits, judgement, given.criteria.tolerance
        ),
        tables.entries_table(
            data,
            budget.nested_fits if named else nested_fits(found, judgement.base_fit),
        ),
        tables.screening_table(found),
        tables.likeness_table(found),
        tables.missing_table(data, shown.fit, given.criteria),
        proposal.commands,
        proposal.control_points,
        proposal.predicted,
    )


def _finding_table(
    given: DiagnosisInput,
    found: SelectionState,
    judgement: Judgement,
    gained: HeldOutGain,
    proposal: ProposedExperiment,
    budget: ErrorBudget,
    named: pd.DataFrame,
) -> pd.DataFrame:
    """Table FINDING. named: table CAUSES."""
    data, base, z = found.prepared.data, judgement.base_fit, given.interval_half_width
    left = unexplained_document(
        data, found.fit, base, judgement, budget, given.criteria
    )
    plain = posterior_with_background(data, base, judgement.background)
    more = posterior_with_background(data, found.fit, judgement.background)
    sure = {
        "base": tables.parameter_uncertainty(base, plain, z),
        "extended": tables.parameter_uncertainty(found.fit, more, z),
    }
    evidence = (
        budget,
        named,
        gained.table,
        given.rejected,
        left,
        proposal.next_experiment,
        sure,
    )
    text = diagnosis_document(found.prepared, base, judgement, *evidence)
    said = " ".join(
        filter(None, (verdict_sentence(judgement, named), str(left["sentence"])))
    )
    row = {
        "verdict": judgement.verdict,
        "sentence": said,
        "diagnosis": json.dumps(replace_non_finite(text), indent=2),
    }
    row |= {
        "extended": _extended_model_yaml(
            given, found.fit, sure["extended"]["intervals"]
        )
    }
    return DIAGNOSIS_SUMMARY.check(pd.DataFrame([row]))


def _heldout_gain(
    given: DiagnosisInput, found: SelectionState, base: Fit
) -> HeldOutGain:
    """What the causes gain on trials left out: nothing where there is one trial."""
    if len(given.observations) == 1:
        return HeldOutGain(HELD_OUT.empty(), False)
    seen = given.heldout_trials or given.search_trials
    data = (
        found.prepared.prepare_further_trials(seen, found.fit)[0]
        if given.heldout_indices
        else found.prepared.data
    )
    more = (
        predict_trials(data, found.fit, unseen=True)
        if given.heldout_indices
        else found.predictions
    )
    plain = (
        more
        if base is found.fit
        else predict_trials(data, base, unseen=bool(given.heldout_indices))
    )
    return HeldOutGain(
        held_out_table(data, plain, more, found.fit, seen, given.matching),
        predicts_better(plain, more),
    )


def _extended_model_yaml(
    given: DiagnosisInput, fit: Fit, ends: Mapping[str, Sequence[float]]
) -> str:
    """extended.yaml: the model with its causes, else the base model, which it says.
    ends: of the intervals of all parameters.
    """
    own = [
        cause.qualified_name(p)
        for cause in fit.hypothesis.causes
        for p in cause.parameters
    ]
    text = yaml.safe_dump(
        extended_model_settings(given.model, fit, {name: ends[name] for name in own}),
        sort_keys=False,
    )
    return text if own else BASE_MODEL_HEADER + text
