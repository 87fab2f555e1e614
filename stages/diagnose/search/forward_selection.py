"""Forward selection of causes by Bayes factors, as a sum of single effects (SuSiE).

For every cause in the sum all candidates and "no cause" compete. Candidates that
explain as much as the best are kept as its look-alikes (Wang, Sarkar, Carbonetto,
Stephens, J. R. Stat. Soc. B 82, 1273, 2020). The rules are in `rules`.
"""

from __future__ import annotations

import logging
from collections.abc import Generator, Iterator, Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.evidence.measures import unexplained_tip_rms
from stringcast.stages.diagnose.rules import (
    NEGLIGIBLE_LOG_EVIDENCE,
    Criteria,
    has_evidence,
    is_evident,
    is_large_enough,
)
from stringcast.stages.diagnose.search.candidate_comparison import compare_candidates
from stringcast.stages.diagnose.search.cause_exchange import exchange_two_causes
from stringcast.stages.diagnose.search.confirmation import (
    AT_RANGE_END,
    drop_unconfirmed_causes,
    reason_if_small,
)
from stringcast.stages.diagnose.search.selection_state import (
    SelectionState,
    add_cause,
    drop_redundant_causes,
    with_fit,
)
from stringcast.stages.diagnose.search.selection_step import SelectionStep
from stringcast.stages.inference.laplace import evaluate_fit
from stringcast.stages.model.effect import Effect

log = logging.getLogger(__name__)


def select_causes(
    state: SelectionState,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    starts: int,
) -> Iterator[SelectionState]:
    """Add one cause at a time to a state while the evidence supports it.

    Causes that ended at an end of their ranges stood in for others. So the selection
    goes on without them, unless a rival has taken their place.

    Parameters
    ----------
    state : SelectionState
        State at the start; it may have causes.
    effects : sequence of type of Effect
        Candidates.
    criteria : Criteria
        Thresholds of the rules.
    seed : int
        Seed of random starts.
    starts : int
        Number of starts of the string's parameters.

    Yields
    ------
    SelectionState
        The state after each cause, and finally the state without causes that left-out
        trials do not confirm.
    """
    while True:
        state = yield from _add_causes(state, effects, criteria, seed, starts)
        confirmed = drop_unconfirmed_causes(state, criteria, len(effects))
        stand_ins = _dropped_stand_ins(state, confirmed)
        if not stand_ins:
            break
        log.info("searching again without %s", ", ".join(c.name for c in stand_ins))
        effects = [effect for effect in effects if effect not in stand_ins]
        state = confirmed
    yield confirmed


def _add_causes(
    state: SelectionState,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    starts: int,
) -> Generator[SelectionState, None, SelectionState]:
    """Add one cause at a time, yield the state after each, and return the last."""
    for number in range(len(state.nameable_causes), criteria.max_causes):
        rng = np.random.default_rng([seed, number])
        state = _add_step(state, effects, criteria, seed)
        if _is_evident_but_small(state, criteria):
            small = _add_small_cause(state, criteria, rng, starts)
            small = _add_step(small, effects, criteria, seed)
            state = small if small.steps[-1].accepted else state
        step = state.steps[-1]
        if step.best is None or not step.accepted:
            state = _set_aside_if_small(state, step, criteria)
            break
        name = step.best.hypothesis.cause_names[-1]
        log.info("accepted: %s, log evidence %+.1f", name, step.best_gain)
        before = state.fit.hypothesis.causes
        state = add_cause(state, step.best, criteria, rng, starts)
        state = exchange_two_causes(state, criteria)
        state = drop_redundant_causes(state, criteria)
        if state.fit.hypothesis.causes == before:
            break  # the new cause was redundant and would be found again
        yield state
    return state


def _dropped_stand_ins(
    state: SelectionState, confirmed: SelectionState
) -> list[type[Effect]]:
    """Find causes that were dropped at an end of their ranges and not replaced."""
    dropped = []
    for cause in state.fit.hypothesis.causes:
        reason = confirmed.set_aside.get(cause.name)
        if reason == AT_RANGE_END and cause not in confirmed.replaced:
            dropped.append(cause)
    return dropped


def _add_step(
    state: SelectionState,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
) -> SelectionState:
    """Compare all candidates for one more cause.

    A better fit without a further cause replaces the state's fit.
    """
    step = compare_candidates(state.prepared, state.fit, effects, criteria, seed)
    parent = step.parent
    if not step.accepted:
        data = state.prepared.data
        moved = evaluate_fit(data, parent.hypothesis, parent.chi, parent.width)
        if moved.log_evidence > state.fit.log_evidence + NEGLIGIBLE_LOG_EVIDENCE:
            state = with_fit(state, moved)
    return replace(state, steps=(*state.steps, step))


def _is_evident_but_small(state: SelectionState, criteria: Criteria) -> bool:
    """Return whether the best cause of the last step is evident but too small.

    A cause that hardly moves the tip may be more evident than one that moves it more,
    such as a small offset of the clocks in fast motions.
    """
    data = state.prepared.data
    step = state.steps[-1]
    if step.best is None or is_large_enough(data, step.parent, step.best, criteria):
        return False
    if unexplained_tip_rms(data, step.best).max() < criteria.tip_tolerance_m:
        return False
    return is_evident(data, step.parent, step.best, criteria)


def _add_small_cause(
    state: SelectionState,
    criteria: Criteria,
    rng: np.random.Generator,
    starts: int,
) -> SelectionState:
    """Add the best cause of the last step, to search others in addition to it."""
    best = state.steps[-1].best
    assert best is not None
    cause = best.hypothesis.causes[-1]
    log.info("%s is small; others are searched in addition to it", cause.name)
    state = add_cause(state, best, criteria, rng, starts)
    return replace(state, unnamed=(*state.unnamed, cause))


def _set_aside_if_small(
    state: SelectionState,
    step: SelectionStep,
    criteria: Criteria,
) -> SelectionState:
    """Set aside the best cause of a step if it is evident but hardly moves the tip."""
    data = state.prepared.data
    best = step.best
    if best is None or not has_evidence(step.parent, best, criteria):
        return state
    reason = reason_if_small(data, step.parent, best, criteria)
    if not reason:
        return state
    name = best.hypothesis.cause_names[-1]
    return replace(state, set_aside={**state.set_aside, name: reason})
