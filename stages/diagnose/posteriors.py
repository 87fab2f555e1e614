"""Posterior probabilities of the effects in the place of each accepted cause.

In each place all candidates and "no effect" compete, while a small amount of every
effect may be present (`background_effects`). Because trials are a random sample,
probabilities are averaged over a Bayesian bootstrap of them (pseudo-BMA+: Yao, Vehtari,
Simpson, Gelman, Bayesian Analysis 13, 917, 2018). They are also averaged over whether
misfit remains (`limit_by_agreement`).
"""

from __future__ import annotations

import logging
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.common import rms
from stringcast.stages.diagnose.agreement import probability_by_agreement
from stringcast.stages.diagnose.background_effects import (
    background_log_evidence_gains,
    background_responses,
)
from stringcast.stages.diagnose.candidate_comparison import compare_candidates
from stringcast.stages.diagnose.measures import (
    in_different_places,
    refit,
    tip_shift_rms,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.probabilities import effect_probabilities
from stringcast.stages.diagnose.rules import (
    Criteria,
    is_inside_range,
    remainder_hides,
)
from stringcast.stages.diagnose.selection_state import SelectionState, with_fit
from stringcast.stages.diagnose.selection_step import SelectionStep, by_evidence
from stringcast.stages.diagnose.stand_ins import (
    explained_shares,
    probability_by_shares,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, evaluate_fit, fit_hypothesis
from stringcast.stages.inference.trial_data import ByTrial, TrialData
from stringcast.stages.model.effect import Effect

log = logging.getLogger(__name__)

BOOTSTRAP_SAMPLES = 100  # gives probabilities within 0.05
LOGGED_CAUSES = 5  # the most probable ones of each place


@dataclass(frozen=True)
class SingleEffectPosterior:
    """Posterior of the effects in one place of the sum of single effects.

    Attributes
    ----------
    probabilities : dict
        Probability of each candidate and of none (""); they sum to one.
    fits : dict
        Fits of the candidates that were fitted.
    fit_without : Fit
        The fit with nothing in this place.
    data : TrialData
        The data of these fits.
    """

    probabilities: Mapping[str, float]
    fits: Mapping[str, Fit]
    fit_without: Fit
    data: TrialData

    @property
    def presence(self) -> float:
        """Probability that any cause is in the place."""
        return 1 - self.probabilities.get("", 0.0)

    @property
    def ranked_causes(self) -> list[str]:
        """The candidates and none (""), the most probable first."""
        return sorted(self.probabilities, key=lambda name: -self.probabilities[name])

    @property
    def holds_a_cause(self) -> bool:
        """Whether the place probably has a cause."""
        return self.presence > 0.5

    @property
    def likeliest_cause(self) -> str:
        """The most probable candidate, or none ("") if the place is probably empty."""
        return next(filter(None, self.ranked_causes)) if self.holds_a_cause else ""

    def credible_set(self, coverage: float) -> tuple[str, ...]:
        """Select the fewest candidates whose probability reaches the coverage."""
        ranked = self.ranked_causes
        total = np.cumsum([self.probabilities[name] for name in ranked])
        last = int(np.searchsorted(total, coverage * total[-1]))
        return tuple(ranked[: last + 1])


@dataclass(frozen=True)
class Posteriors:
    """A settled selection with the posterior of each of its places.

    Attributes
    ----------
    background : sequence of numpy.ndarray
        Responses to other effects (`background_responses`).
    by_cause : tuple of SingleEffectPosterior
        Posteriors in the order of acceptance; one if nothing was accepted.
    """

    state: SelectionState
    background: ByTrial
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
    """
    for changes_left in reversed(range(len(state.fit.hypothesis.causes) + 1)):
        background = background_responses(state.prepared.data, state.fit, effects)
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
        background = background_responses(
            likeliest.prepared.data, likeliest.fit, effects
        )
    return Posteriors(likeliest, background, tuple(by_cause))


def _more_probable_fit(
    posterior: SingleEffectPosterior,
    state: SelectionState,
    criteria: Criteria,
) -> Fit | None:
    """Find the fit with a more probable candidate in a place, or None.

    Nothing is changed if the credible set contains a cause of the model in any place,
    unless the place is probably empty.
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
    """Put the likeliest effect into each place if that raises the evidence."""
    likeliest = {}  # by cause, in the order of the places
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
    background: ByTrial,
    criteria: Criteria,
    seed: int,
) -> Iterator[SingleEffectPosterior]:
    """Compute the posterior of each place, the last one first.

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
            criteria.tip_tolerance_m,
        )


def _compare_alternatives(
    state: SelectionState,
    cause: type[Effect],
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
) -> SelectionStep:
    """Compare candidates for the place of a cause, given the others."""
    hypothesis = state.fit.hypothesis
    if cause is hypothesis.causes[-1]:
        step = _comparison_at_acceptance(state)
        if step is not None:
            return step
    data = state.prepared.data
    others = hypothesis.without_cause(cause)
    reordered = others.with_cause(cause)
    chi = reordered.exponents_from(state.fit.exponents)
    contested = evaluate_fit(data, reordered, chi)
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
        contested,
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
            has_moved = len(in_different_places([state.fit, as_accepted])) > 1
            return None if has_moved else step
    return None


def bootstrap_weights(trials: int, seed: int) -> np.ndarray:
    """Draw weights of trials for a Bayesian bootstrap, (samples, K)."""
    # A random stream apart from those of the fits
    rng = np.random.default_rng([seed, BOOTSTRAP_SAMPLES])
    return trials * rng.dirichlet(np.ones(trials), BOOTSTRAP_SAMPLES)


def single_effect_posterior(
    step: SelectionStep,
    background: ByTrial,
    weights: np.ndarray,
    candidates: int,
    min_tip_shift_m: float,
) -> SingleEffectPosterior:
    """Compute the probability of each candidate of a step, and of none.

    If there are fits on common data, only these compete. A cause at the end of its
    range does not compete, because it probably stands for another one. The probability
    of effects below the smallest tip shift is added to that of none. Effects that
    differ by less than the unexplained misfit are equally probable. So are those with
    which trials cannot be simulated well enough.

    Parameters
    ----------
    weights : numpy.ndarray, shape (samples, K)
        Bootstrap weights of the trials.
    candidates : int
        Number of effects that share the prior probability of one being active.
    """
    data = step.data
    fits = _fits_within_range(step.compared or step.fits)
    log_evidence = {}  # (samples,) each
    rng = np.random.default_rng(len(weights))
    for name, fit in {"": step.parent, **fits}.items():
        resampled = fit.log_evidence + (weights - 1) @ fit.log_likelihood_by_trial
        gains = background_log_evidence_gains(data, fit, background, weights)
        errors = fit.log_evidence_error * rng.standard_normal(len(weights))
        log_evidence[name] = resampled + gains + errors
    probabilities = effect_probabilities(log_evidence, candidates)
    for name, fit in fits.items():
        if tip_shift_rms(data, step.parent, fit).max() < min_tip_shift_m:
            probabilities[""] += probabilities.pop(name)
    unresolved = _fits_within_range(step.unresolved)
    probabilities |= dict.fromkeys(unresolved, 0.0)
    fits |= unresolved
    probabilities |= _shared_probabilities(data, probabilities, fits, unresolved)
    posterior = SingleEffectPosterior(probabilities, fits, step.parent, data)
    ranked = []
    for name in posterior.ranked_causes[:LOGGED_CAUSES]:
        ranked.append(f"{name or 'none'} {probabilities[name]:.2f}")
    log.info("probabilities in a place: %s", ", ".join(ranked))
    return posterior


def _fits_within_range(fits: Sequence[Fit]) -> dict[str, Fit]:
    """Select the fits whose last cause is inside its range, by name of the cause."""
    by_name = {}
    for fit in by_evidence(fits):
        cause = fit.hypothesis.causes[-1]
        if not fit.has_diverged and is_inside_range(fit, cause):
            by_name[cause.name] = fit
    return by_name


def _shared_probabilities(
    data: TrialData,
    probabilities: Mapping[str, float],
    fits: Mapping[str, Fit],
    unresolved: Container[str],
) -> dict[str, float]:
    """Share the probability among effects that differ by less than the misfit.

    The misfit that none explains may be just the difference between two of them. The
    evidence does not account for that and is overconfident (Brynjarsdottir, O'Hagan,
    Inverse Problems 30, 114007, 2014).

    Returns
    -------
    dict of str to float
        Equal probabilities of the most probable effect, of those that differ from it at
        the tip by no more than its misfit, and of unresolved ones.
    """
    names = [name for name in probabilities if name]
    if len(names) < 2:
        return {}
    best = fits[max(names, key=probabilities.__getitem__)]
    remainder_m = rms(unexplained_tip_rms(data, best))
    similar = []
    for name in names:
        difference_m = rms(tip_shift_rms(data, best, fits[name]))
        if name in unresolved or remainder_hides(difference_m, remainder_m):
            similar.append(name)
    share = sum(probabilities[name] for name in similar) / len(similar)
    return dict.fromkeys(similar, share)


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


def inclusion_probabilities(
    posteriors: Sequence[SingleEffectPosterior],
) -> dict[str, float]:
    """Compute the probability that each effect is in any place."""
    absent: dict[str, float] = {}
    for posterior in posteriors:
        for name, probability in posterior.probabilities.items():
            if name:
                absent[name] = absent.get(name, 1.0) * (1 - probability)
    return {name: 1 - share for name, share in absent.items()}
