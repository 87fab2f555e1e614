"""Posteriors of the slots of all accepted causes, and swaps of look-alikes.

A more probable look-alike replaces a cause. If misfit remains, the agreement of trials
limits the probability of a cause.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from stringcast.stages.diagnose.evidence.agreement import probability_by_agreement
from stringcast.stages.diagnose.evidence.background_effects import (
    Background,
    find_background,
)
from stringcast.stages.diagnose.evidence.measures import distinct_fits, refit
from stringcast.stages.diagnose.evidence.single_effect import (
    SingleEffectPosterior,
    bootstrap_weights,
    single_effect_posterior,
)
from stringcast.stages.diagnose.evidence.stand_ins import (
    explained_shares,
    probability_by_shares,
)
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.diagnose.search.candidate_comparison import compare_candidates
from stringcast.stages.diagnose.search.selection_state import SelectionState, with_fit
from stringcast.stages.diagnose.search.selection_step import SelectionStep
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, evaluate_fit, fit_hypothesis
from stringcast.stages.model.effect import Effect


@dataclass(frozen=True)
class Posteriors:
    """A settled selection with the posterior of each of its slots.

    Attributes
    ----------
    background : Background
        Small amounts of other effects.
    by_cause : tuple of SingleEffectPosterior
        Posteriors in the order of acceptance; one if nothing was accepted.
    """

    state: SelectionState
    background: Background
    by_cause: tuple[SingleEffectPosterior, ...]


def swap_lookalikes_until_stable(
    state: SelectionState,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
) -> Posteriors:
    """Replace causes by more probable look-alikes until there are none.

    After each replacement all posteriors are computed again. Replacements are limited
    to the number of causes; one more is made without new posteriors.

    Parameters
    ----------
    state : SelectionState
        The final state of the selection.
    effects : sequence of type of Effect
        Candidates for each slot.
    criteria : Criteria
        Its coverage defines credible sets.
    seed : int
        Seed of starts and of the bootstrap.

    Returns
    -------
    Posteriors
        The settled state with the posteriors of its slots.
    """
    for changes_left in reversed(range(len(state.fit.hypothesis.causes) + 1)):
        background = _find_background(state, effects, criteria)
        by_cause = list[SingleEffectPosterior]()
        replacement = None
        for posterior in _single_effect_posteriors(
            state,
            effects,
            background,
            criteria,
            seed,
        ):
            by_cause.append(posterior)
            if replacement is None:
                replacement = _more_probable_fit(posterior, state, criteria)
            if replacement is not None and changes_left:
                break
        if replacement is None:
            break
        state = with_fit(state, replacement)

    by_cause.reverse()
    likeliest = with_most_probable_causes(state, by_cause)
    if replacement is not None or likeliest is not state:
        background = _find_background(likeliest, effects, criteria)
    return Posteriors(likeliest, background, tuple(by_cause))


def _find_background(
    state: SelectionState, effects: Sequence[type[Effect]], criteria: Criteria
) -> Background:
    """Find the background at the fit of a state, of scales within the tolerance."""
    data = state.prepared.data
    return find_background(data, state.fit, effects, criteria.tip_tolerance_m)


def _more_probable_fit(
    posterior: SingleEffectPosterior,
    state: SelectionState,
    criteria: Criteria,
) -> Fit | None:
    """Find the fit with a more probable candidate in a slot, or None.

    Nothing is changed if the credible set contains a cause of the model in any slot,
    unless the slot is probably empty.
    """
    names = state.fit.hypothesis.cause_names
    credible = posterior.credible_set(criteria.coverage)
    likeliest = posterior.likeliest_cause
    holds_a_cause = likeliest and not set(names).isdisjoint(credible)
    if not names or holds_a_cause:
        return None
    return posterior.fits.get(likeliest, posterior.fit_without)


def with_most_probable_causes(
    state: SelectionState,
    posteriors: Sequence[SingleEffectPosterior],
) -> SelectionState:
    """Put the likeliest effect into each slot if that raises the evidence."""
    likeliest = {}  # by cause, in the order of the slots
    for posterior in posteriors:
        fit = posterior.fits.get(posterior.likeliest_cause)
        if fit is not None:
            likeliest[fit.hypothesis.causes[-1]] = fit
    causes = state.fit.hypothesis.causes
    if len(likeliest) != len(causes) or likeliest.keys() == {*causes}:
        return state
    exponents = dict(state.fit.exponents)
    for fit in likeliest.values():
        exponents |= fit.exponents
    together = Hypothesis(state.fit.hypothesis.base, tuple(likeliest))
    start = together.exponents_from(exponents)
    grid_points = state.fit.grid_points
    fit = fit_hypothesis(state.prepared.data, together, start[None], grid_points)
    other = with_fit(state, fit)
    return other if other.fit.log_evidence > state.fit.log_evidence else state


def _single_effect_posteriors(
    state: SelectionState,
    effects: Sequence[type[Effect]],
    background: Background,
    criteria: Criteria,
    seed: int,
) -> Iterator[SingleEffectPosterior]:
    """Compute the posterior of each slot, the last one first.

    The last cause is most often a look-alike. Causes that are not named have no
    posterior. Without causes, the posterior is that of the candidates not accepted.
    """
    causes = state.nameable_causes
    weights = bootstrap_weights(len(state.prepared.data.trials), seed)
    steps: Iterable[SelectionStep] = state.steps[-1:]
    if causes:
        steps = (
            _compare_alternatives(state, cause, effects, criteria, seed)
            for cause in reversed(causes)
        )
    for step in steps:
        yield single_effect_posterior(
            step,
            background,
            weights,
            len(effects),
            criteria,
        )


def _compare_alternatives(
    state: SelectionState,
    cause: type[Effect],
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
) -> SelectionStep:
    """Compare candidates for the slot of a cause, given the others."""
    hypothesis = state.fit.hypothesis
    if cause is hypothesis.causes[-1]:
        step = _comparison_at_acceptance(state)
        if step is not None:
            return step
    data = state.prepared.data
    others = hypothesis.without_cause(cause)
    reordered = others.with_cause(cause)
    chi = reordered.exponents_from(state.fit.exponents)
    incumbent = evaluate_fit(data, reordered, chi)
    # The parameters with the cause may be a poor start without it
    starts = (state.fit, state.prepared.base_fit)
    parents = [refit(data, start, others) for start in starts]
    parent = max(parents, key=lambda fit: fit.log_evidence)
    return compare_candidates(
        state.prepared,
        parent,
        effects,
        criteria,
        seed,
        incumbent,
    )


def _comparison_at_acceptance(state: SelectionState) -> SelectionStep | None:
    """Return the step that accepted the last cause, unless the fit has moved since.

    With other string parameters, another cause may explain the remaining misfit.
    """
    data = state.prepared.data
    hypothesis = state.fit.hypothesis
    for step in state.steps:
        best = step.best
        if best is None or not step.accepted:
            continue
        if best.hypothesis.cause_names == hypothesis.cause_names:
            chi = hypothesis.exponents_from(best.exponents)
            as_accepted = evaluate_fit(data, hypothesis, chi)
            has_moved = len(distinct_fits([state.fit, as_accepted])) > 1
            return None if has_moved else step
    return None


def limit_by_agreement(
    posteriors: Posteriors,
    misfit_probability: float,
    candidates: int,
    min_tip_shift_m: float,
) -> Posteriors:
    """Limit the probability of causes by the agreement of trials if misfit remains.

    The evidence of an incomplete model is overconfident. Then the limit is the
    probability from the scatter of the cause's estimates between trials (`agreement`),
    times the probability that the cause does not stand in for something outside the
    library (`stand_ins`).

    Parameters
    ----------
    misfit_probability : float
        Probability that misfit remains.
    candidates : int
        Number of effects that share the prior probability of one being active.
    min_tip_shift_m : float
        Tip shift above which a cause that depends on place acts in a trial [m].
    """
    state = posteriors.state
    if len(state.prepared.data.trials) < 2:
        return posteriors
    causes = {cause.name: cause for cause in state.fit.hypothesis.causes}
    by_cause = []
    for posterior in posteriors.by_cause:
        accepted = [name for name in posterior.ranked_causes if name in causes]
        if not accepted:
            by_cause.append(posterior)
            continue
        name = accepted[0]
        limit = probability_by_agreement(
            state, causes[name], candidates, min_tip_shift_m
        )
        shares = explained_shares(
            posterior.data, posterior.fit_without, posterior.fits[name], min_tip_shift_m
        )
        limit *= probability_by_shares(shares)
        by_cause.append(_limit_presence(posterior, limit, misfit_probability))
    return replace(posteriors, by_cause=tuple(by_cause))


def _limit_presence(
    posterior: SingleEffectPosterior,
    limit: float,
    misfit_probability: float,
) -> SingleEffectPosterior:
    """Apply a limit to the presence of a cause, with the probability of misfit."""
    presence = posterior.presence
    if presence <= limit:
        return posterior
    limited = (1 - misfit_probability) * presence + misfit_probability * limit
    probabilities = {}
    for name, probability in posterior.probabilities.items():
        probabilities[name] = probability * limited / presence
    probabilities[""] = 1 - limited
    return replace(posterior, probabilities=probabilities)
