"""The search for causes, again while it changes which trials are used."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.stages.diagnose.base_model import widen_ranges_with_causes
from stringcast.stages.diagnose.discretisation import STEP_S, unresolvable_trials
from stringcast.stages.diagnose.forward_selection import select_causes
from stringcast.stages.diagnose.outlying_trials import (
    find_outlying_trial,
    find_predicted_trials,
)
from stringcast.stages.diagnose.preparation import prepare_data, prepare_further_trials
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.diagnose.proposals import candidate_effects
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.diagnose.selection_state import (
    SelectionState,
    with_causes_found_before,
    without_chaotic_trials,
)
from stringcast.stages.diagnose.settings import DiagnosisSettings
from stringcast.stages.diagnose.trials_by_use import TrialsByUse
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.library import effects_by_name

log = logging.getLogger(__name__)


class SearchProgress(NamedTuple):
    """How far a search has come.

    Attributes
    ----------
    trials : TrialsByUse
    prepared : PreparedData
        Corrected at the base model, before any cause.
    effects : list of type of Effect
        The candidates.
    state : SelectionState
    """

    trials: TrialsByUse
    prepared: PreparedData
    effects: list[type[Effect]]
    state: SelectionState


def search_until_trials_settle(
    trials: TrialsByUse,
    settings: DiagnosisSettings,
) -> Iterator[SearchProgress]:
    """Search causes, while these change which trials are used.

    A trial that is chaotic with the causes so far is left out, and returns once further
    causes resolve it. If the fit to all trials does not resolve it, it is left out for
    good. The search goes on from the causes. So it does with a trial that was outlying
    and that they predict: a search with this trial has found others. If trials are
    chaotic in long steps, the search begins again in short ones. So it does in a wider
    range if the causes leave a parameter of the string at the end of its own.
    """
    criteria = settings.criteria
    returned = list[str]()
    reached = _begin_search(trials, settings, returned, None)
    while True:
        yield reached
        together = None
        chaotic = list[str]()
        better = settings
        states = select_causes(
            reached.state, reached.effects, criteria, settings.seed, settings.starts
        )
        for number, state in enumerate(states, 1):
            settings.progress(0.3 + 0.5 * number / (criteria.max_causes + 1))
            reached = reached._replace(state=state)
            resolved = _trials_resolved_with_causes(
                state, trials.searched_trials, criteria.tip_tolerance_m
            )
            if resolved:
                log.info("resolved with the causes: %s", ", ".join(resolved))
                returned += resolved
                together = _search_together(trials, settings, returned, state)
                if together is None:
                    log.info("chaotic again: %s", ", ".join(resolved))
                    trials = trials.excluding_chaotic(resolved)
            chaotic = _trials_chaotic_with_causes(state, criteria)
            better = _settings_with_causes(state, settings, chaotic)
            if together or chaotic or better is not settings:
                break
            yield reached

        state = reached.state
        if better is not settings:
            settings = better
            reached = _begin_search(trials, settings, returned, None)
            continue
        if together is not None:
            reached = together
            continue
        if chaotic:
            log.info("chaotic with the causes: %s", ", ".join(chaotic))
            state = without_chaotic_trials(state, chaotic, criteria)
            for_good = [name for name in chaotic if name in returned]
            trials = trials.excluding_chaotic(for_good)
            used = trials.excluding_chaotic(state.prepared.chaotic_trials)
            reached = reached._replace(trials=used, state=state)
            continue
        searched = trials
        trials = _trials_for_another_search(searched, state, criteria)
        if trials is searched:
            return
        is_kept = trials.predicted != searched.predicted
        known = state if is_kept and state.fit.hypothesis.causes else None
        reached = _begin_search(trials, settings, returned, known)


def _begin_search(
    trials: TrialsByUse,
    settings: DiagnosisSettings,
    keep_if_chaotic: Sequence[str],
    known: SelectionState | None,
) -> SearchProgress:
    """Prepare the data, and fit the causes that are known from fewer trials."""
    log.info("fitting the base model")
    criteria = settings.criteria
    prepared = prepare_data(
        settings.model,
        trials.searched_trials,
        criteria.tip_tolerance_m,
        np.random.default_rng(settings.seed),
        settings.starts,
        lambda share: settings.progress(0.3 * share),
        settings.longest_step_s,
        keep_if_chaotic,
    )
    effects = candidate_effects(
        prepared.base_fit.hypothesis.model,
        effects_by_name(),
        prepared.data.trials,
        settings.excluded_effects,
    )
    used = trials.excluding_chaotic(prepared.chaotic_trials)
    state = SelectionState(prepared, prepared.base_fit)
    if known is not None:
        state = with_causes_found_before(
            prepared, known, criteria, settings.seed, settings.starts
        )
    return SearchProgress(used, prepared, effects, state)


def _search_together(
    trials: TrialsByUse,
    settings: DiagnosisSettings,
    returned: Sequence[str],
    known: SelectionState,
) -> SearchProgress | None:
    """Search with trials that returned, or not at all if the fit leaves any chaotic."""
    together = _begin_search(trials, settings, returned, known)
    chaotic = _trials_chaotic_with_causes(together.state, settings.criteria)
    return None if chaotic else together


def _trials_for_another_search(
    trials: TrialsByUse,
    state: SelectionState,
    criteria: Criteria,
) -> TrialsByUse:
    """Exclude or include trials by the causes found, or return the same trials.

    A trial that the others do not predict is excluded, until the causes found without
    it predict it.
    """
    for name, reason in find_outlying_trial(state, criteria).items():
        if name not in trials.predicted:
            log.info("%s: %s", name, reason)
            return replace(trials, outlying={**trials.outlying, name: reason})

    outlying = [o for o in trials.observations if o.trial in trials.outlying]
    predicted = find_predicted_trials(state, outlying, criteria)
    if not predicted:
        return trials
    log.info("predicted after all, and used again: %s", ", ".join(predicted))
    return trials.including_predicted(predicted)


def _settings_with_causes(
    state: SelectionState, settings: DiagnosisSettings, chaotic: Sequence[str]
) -> DiagnosisSettings:
    """Shorten steps in which trials are chaotic, or widen a range that is too narrow.

    Either may have led the causes astray. Returns the same settings if neither is so.
    """
    if chaotic and settings.longest_step_s > STEP_S and _steps_are_long(state):
        log.info("chaotic in long steps: %s", ", ".join(chaotic))
        return replace(settings, longest_step_s=STEP_S)
    if not state.fit.hypothesis.causes:
        return settings
    wider = widen_ranges_with_causes(state.prepared.data, state.fit)
    if wider is None:
        return settings
    string = replace(settings.model.string, ranges=wider.string.ranges)
    return replace(settings, model=replace(settings.model, string=string))


def _steps_are_long(state: SelectionState) -> bool:
    base = state.prepared.base_fit.hypothesis.model
    return base.string.largest_step > STEP_S


def _trials_chaotic_with_causes(state: SelectionState, criteria: Criteria) -> list[str]:
    """Name trials that no simulation with the causes resolves."""
    if not state.fit.hypothesis.causes:
        return []
    return unresolvable_trials(state.prepared, criteria.tip_tolerance_m)


def _trials_resolved_with_causes(
    state: SelectionState,
    searched: Sequence[Observation],
    tolerance_m: float,
) -> list[str]:
    """Name trials that are chaotic without the causes and resolved with them.

    Numerical error is also large where a string without the causes is bent to what
    they do.
    """
    chaotic_names = state.prepared.chaotic_trials
    chaotic = [o for o in searched if o.trial in chaotic_names]
    if not chaotic or not state.fit.hypothesis.causes:
        return []
    _, uncertainty_m = prepare_further_trials(state.prepared, chaotic, state.fit)
    resolved = np.flatnonzero(uncertainty_m < tolerance_m)
    return [chaotic[k].trial for k in resolved]
