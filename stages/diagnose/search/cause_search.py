"""The search for causes, repeated while causes change the trials or settings."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.stages.common import MM_PER_M
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.diagnose.search.forward_selection import select_causes
from stringcast.stages.diagnose.search.proposals import candidate_effects
from stringcast.stages.diagnose.search.selection_state import (
    SelectionState,
    with_causes_found_before,
    without_chaotic_trials,
)
from stringcast.stages.diagnose.settings import DiagnosisSettings
from stringcast.stages.diagnose.trials.base_model import widen_ranges_with_causes
from stringcast.stages.diagnose.trials.discretisation import (
    SEGMENTS,
    STEP_S,
    unresolvable_trials,
)
from stringcast.stages.diagnose.trials.outlying_trials import (
    find_outlying_trial,
    find_predicted_trials,
)
from stringcast.stages.diagnose.trials.preparation import (
    keep_configured_mesh_if_supported,
    prepare_data,
    prepare_further_trials,
)
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.diagnose.trials.trials_by_use import TrialsByUse
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.library import effects_by_name

log = logging.getLogger(__name__)


class SearchProgress(NamedTuple):
    """How far a search has come.

    Attributes
    ----------
    prepared : PreparedData
        Trials corrected at the base model, before any cause.
    effects : list of type of Effect
        The candidates.
    """

    trials: TrialsByUse
    prepared: PreparedData
    effects: list[type[Effect]]
    state: SelectionState


@dataclass(frozen=True)
class _Search:
    """Trials and settings of a search, which the causes found may change.

    Attributes
    ----------
    trials : TrialsByUse
        The trials, including those that are chaotic without causes.
    settings : DiagnosisSettings
        Settings, with the ranges and the meshes of this search.
    resolved_with_causes : tuple of str
        Names of chaotic trials that causes resolved. They are kept, even if chaotic
        without causes.
    """

    trials: TrialsByUse
    settings: DiagnosisSettings
    resolved_with_causes: tuple[str, ...] = ()

    def begin(self, known: SelectionState | None = None) -> SearchProgress:
        """Prepare the data, and fit the causes of an earlier search, if any."""
        log.info("fitting the base model")
        settings = self.settings
        criteria = settings.criteria
        prepared = prepare_data(
            settings.model,
            self.trials.searched_trials,
            criteria.tip_tolerance_m,
            np.random.default_rng(settings.seed),
            settings.starts,
            lambda share: settings.progress(0.3 * share),
            settings.mesh_may_be_coarser,
            self.resolved_with_causes,
        )
        effects = candidate_effects(
            prepared.base_fit.hypothesis.model,
            effects_by_name(),
            prepared.data.trials,
            settings.excluded_effects,
        )
        used = self.trials.excluding_chaotic(prepared.chaotic_trials)
        state = SelectionState(prepared, prepared.base_fit)
        if known is not None:
            state = with_causes_found_before(
                prepared, known, criteria, settings.seed, settings.starts
            )
        return SearchProgress(used, prepared, effects, state)


def search_until_trials_settle(
    trials: TrialsByUse,
    settings: DiagnosisSettings,
) -> Iterator[SearchProgress]:
    """Search causes, and repeat the search while they change the trials or settings.

    - A chaotic trial is used again if simulation with the causes resolves it, and the
      search continues from these causes. If the fit to all trials does not resolve it,
      it is left out for good.
    - If the error of a coarse mesh is too uncertain with the causes, the search
      continues from them on a fine one.
    - If the causes leave a parameter of the string at the end of its range, the search
      is repeated in a wider range.
    - A trial that is chaotic with the causes on a fine mesh is left out, and the
      search continues from the causes.
    - If the data with the causes clearly come from the configured mesh, the search
      continues from the causes on that mesh.
    - When no cause is missing any more, the search is repeated without a trial that is
      outlying. If the causes found then predict this trial, the search continues with
      it from these causes.
    """
    search = _Search(trials, settings)
    restart: SearchProgress | None = search.begin()
    while restart is not None:
        reached = restart
        restart = None
        yield reached
        selected = _select_causes(reached, settings)
        for reached in selected:
            search, restart = _search_after_new_cause(search, reached)
            if restart is not None:
                break
            yield reached
        if restart is None:
            search, restart = _search_other_trials(search, reached.state)


def _select_causes(
    reached: SearchProgress, settings: DiagnosisSettings
) -> Iterator[SearchProgress]:
    """Select causes in the present trials, one at a time, and report progress."""
    criteria = settings.criteria
    states = select_causes(
        reached.state, reached.effects, criteria, settings.seed, settings.starts
    )
    for number, state in enumerate(states, 1):
        share = min(1.0, number / (criteria.max_causes + 1))
        settings.progress(0.3 + 0.5 * share)
        yield reached._replace(state=state)


def _search_after_new_cause(
    search: _Search, reached: SearchProgress
) -> tuple[_Search, SearchProgress | None]:
    """Decide whether the new cause requires another search.

    Returns the search with its changes and its first state. The latter is None if the
    selection goes on as before.
    """
    state = reached.state
    criteria = search.settings.criteria
    resolved = _trials_resolved_with_causes(
        state, search.trials.searched_trials, criteria.tip_tolerance_m
    )
    names = (*search.resolved_with_causes, *resolved)
    search = replace(search, resolved_with_causes=names)

    # Another mesh or range requires all fits to be repeated, so it is chosen first
    if _needs_finer_mesh(state, search.settings):
        settings = replace(search.settings, mesh_may_be_coarser=False)
        search = replace(search, settings=settings)
        return search, search.begin(state)
    settings = _with_wider_ranges(state, search.settings)
    if settings is not search.settings:
        search = replace(search, settings=settings)
        return search, search.begin()

    if resolved:
        log.info("resolved with the causes: %s", ", ".join(resolved))
        together = search.begin(state)
        if not _trials_chaotic_with_causes(together.state, criteria):
            return search, together
        log.info("chaotic again, left out for good: %s", ", ".join(resolved))
        search = replace(search, trials=search.trials.excluding_chaotic(resolved))

    chaotic = _trials_chaotic_with_causes(state, criteria)
    if chaotic:
        return _search_without_chaotic_trials(search, reached, chaotic)
    return search, _search_on_configured_mesh(search.settings, reached)


def _search_without_chaotic_trials(
    search: _Search, reached: SearchProgress, chaotic: Sequence[str]
) -> tuple[_Search, SearchProgress]:
    """Continue from the causes without trials that are chaotic with them.

    Those that were used again before are left out for good.
    """
    log.info("chaotic with the causes: %s", ", ".join(chaotic))
    for_good = [name for name in chaotic if name in search.resolved_with_causes]
    trials = search.trials.excluding_chaotic(for_good)
    state = without_chaotic_trials(reached.state, chaotic, search.settings.criteria)
    used = trials.excluding_chaotic(state.prepared.chaotic_trials)
    without = reached._replace(trials=used, state=state)
    return replace(search, trials=trials), without


def _search_on_configured_mesh(
    settings: DiagnosisSettings, reached: SearchProgress
) -> SearchProgress | None:
    """Continue from the causes on the configured mesh if the data come from it."""
    state = reached.state
    if state.prepared.mesh_is_model or not state.fit.hypothesis.causes:
        return None
    criteria = settings.criteria
    prepared = keep_configured_mesh_if_supported(
        state.prepared, state.fit, settings.model
    )
    if not prepared.mesh_is_model:
        return None
    log.info("the data come from the configured mesh")
    on_its_mesh = with_causes_found_before(
        prepared, state, criteria, settings.seed, settings.starts
    )
    return reached._replace(prepared=prepared, state=on_its_mesh)


def _search_other_trials(
    search: _Search, state: SelectionState
) -> tuple[_Search, SearchProgress | None]:
    """Search without an outlying trial, or with one that the causes predict.

    Returns the search with these trials and its first state, which is None if the
    trials stay the same.
    """
    criteria = search.settings.criteria
    trials = _trials_for_another_search(search.trials, state, criteria)
    if trials is search.trials:
        return search, None
    includes_predicted = trials.predicted != search.trials.predicted
    has_causes = bool(state.fit.hypothesis.causes)
    search = replace(search, trials=trials)
    return search, search.begin(state if includes_predicted and has_causes else None)


def _trials_for_another_search(
    trials: TrialsByUse,
    state: SelectionState,
    criteria: Criteria,
) -> TrialsByUse:
    """Exclude an outlying trial, include predicted ones, or return the same trials.

    A trial that the others do not predict is excluded until the causes found without
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


def _needs_finer_mesh(state: SelectionState, settings: DiagnosisSettings) -> bool:
    """Return whether the error of a coarse mesh is too uncertain with the causes."""
    if not state.fit.hypothesis.causes or not settings.mesh_may_be_coarser:
        return False
    uncertainty_m = state.prepared.discretisation_uncertainty_m
    is_resolved = np.all(uncertainty_m < settings.criteria.tip_tolerance_m)
    if is_resolved or not _mesh_is_coarse(state):
        return False
    uncertainty_mm = np.round(MM_PER_M * uncertainty_m, 1)
    log.info("tips are uncertain by %s mm on the coarse mesh", uncertainty_mm)
    return True


def _mesh_is_coarse(state: SelectionState) -> bool:
    if state.prepared.mesh_is_model:
        return False
    string = state.prepared.base_fit.hypothesis.model.string
    return string.points - 1 < SEGMENTS or string.largest_step > STEP_S


def _with_wider_ranges(
    state: SelectionState, settings: DiagnosisSettings
) -> DiagnosisSettings:
    """Widen a range that is too narrow with the causes: it may have led to wrong ones.

    Returns the same settings if none is.
    """
    if not state.fit.hypothesis.causes:
        return settings
    data = state.prepared.data
    wider = widen_ranges_with_causes(data, state.fit, settings.criteria)
    if wider is None:
        return settings
    model = settings.model.with_ranges(*wider.string.ranges.values())
    return replace(settings, model=model)


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

    A fit without the causes may have large numerical errors because it distorts the
    string.
    """
    chaotic_names = state.prepared.chaotic_trials
    chaotic = [o for o in searched if o.trial in chaotic_names]
    if not chaotic or not state.fit.hypothesis.causes:
        return []
    _, uncertainty_m = prepare_further_trials(state.prepared, chaotic, state.fit)
    resolved = np.flatnonzero(uncertainty_m < tolerance_m)
    return [chaotic[k].trial for k in resolved]
