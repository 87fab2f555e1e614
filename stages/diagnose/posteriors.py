"""Posterior probabilities of the effects in the place of each accepted cause.

In each place all candidates compete, and none among them, while every effect may be a
little wrong everywhere (`background_effects`). Trials are a sample of those that might
have been: probabilities are averaged over a Bayesian bootstrap of them (pseudo-BMA+:
Yao, Vehtari, Simpson, Gelman, Bayesian Analysis 13, 917, 2018).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from stringcast.stages.diagnose.background_effects import (
    background_log_evidence_gains,
    background_responses,
)
from stringcast.stages.diagnose.forward_selection import (
    SelectionState,
    SelectionStep,
    compare_candidates,
    with_fit,
)
from stringcast.stages.diagnose.measures import refit, tip_shift_rms
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, evaluate_fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect

PRIOR_NO_EFFECT = 0.5  # probability that no effect of the library is active
BOOTSTRAP_SAMPLES = 100  # probabilities are then known to 0.05


@dataclass(frozen=True)
class SingleEffectPosterior:
    """Posterior of the effects in one place of the sum of single effects.

    Attributes
    ----------
    probabilities : dict
        Of each candidate, and of none (""); they sum to one.
    fits : dict
        Of the candidates that were fitted.
    fit_without : Fit
        With nothing in this place.
    """

    probabilities: Mapping[str, float]
    fits: Mapping[str, Fit]
    fit_without: Fit

    def credible_set(self, coverage: float) -> tuple[str, ...]:
        """Take the fewest candidates with so much probability, the likeliest first."""
        ranked = sorted(self.probabilities, key=lambda name: -self.probabilities[name])
        total = np.cumsum([self.probabilities[name] for name in ranked])
        last = int(np.searchsorted(total, coverage * total[-1]))
        return tuple(ranked[: last + 1])


@dataclass(frozen=True)
class Posteriors:
    """A settled selection with the posterior of each of its places.

    Attributes
    ----------
    state : SelectionState
    background : sequence of numpy.ndarray
        What other effects do about the fit, as of `background_effects`.
    by_cause : tuple of SingleEffectPosterior
        In the order of acceptance; one if nothing was accepted.
    """

    state: SelectionState
    background: Sequence[np.ndarray]
    by_cause: tuple[SingleEffectPosterior, ...]


def swap_lookalikes_until_stable(
    state: SelectionState,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
) -> Posteriors:
    """Replace causes by more probable look-alikes until none is left.

    A cause is replaced where its credible set holds another effect, or none, instead.
    There are at most as many changes as causes.
    """
    for changes_left in range(len(state.fit.hypothesis.causes), -1, -1):
        background = background_responses(state.prepared.data, state.fit, effects)
        names = state.fit.hypothesis.cause_names
        posteriors = list[SingleEffectPosterior]()
        replacement = None
        for posterior in _single_effect_posteriors(
            state, effects, background, criteria, seed
        ):
            posteriors.append(posterior)
            credible = posterior.credible_set(criteria.coverage)
            is_stable = credible[0] and {*names} & {*credible}
            if names and not is_stable and replacement is None:
                replacement = posterior.fits.get(credible[0], posterior.fit_without)
            if changes_left and replacement is not None:
                break
        if replacement is None:
            break
        state = with_fit(state, replacement)

    posteriors = posteriors[::-1]
    likeliest = with_most_probable_causes(state, posteriors)
    if replacement is not None or likeliest is not state:
        background = background_responses(
            likeliest.prepared.data, likeliest.fit, effects
        )
    return Posteriors(likeliest, background, tuple(posteriors))


def with_most_probable_causes(
    state: SelectionState, posteriors: Sequence[SingleEffectPosterior]
) -> SelectionState:
    """Put the likeliest effect into each place if the evidence is then higher."""
    fits = [each.fits.get(each.credible_set(0.0)[0]) for each in posteriors]
    likeliest = {fit.hypothesis.causes[-1]: fit for fit in fits if fit is not None}
    causes = state.fit.hypothesis.causes
    data = state.prepared.data
    if len(likeliest) != len(causes) or likeliest.keys() == {*causes}:
        return state
    exponents = dict(state.fit.exponents)
    for fit in likeliest.values():
        exponents |= fit.exponents
    together = Hypothesis(state.fit.hypothesis.base, tuple(likeliest))
    start = together.exponents_from(exponents)
    other = with_fit(
        state, fit_hypothesis(data, together, start[None], state.fit.scale_indices)
    )
    return other if other.fit.log_evidence > state.fit.log_evidence else state


def _single_effect_posteriors(
    state: SelectionState,
    effects: Sequence[type[Effect]],
    background: Sequence[np.ndarray],
    criteria: Criteria,
    seed: int,
) -> Iterator[SingleEffectPosterior]:
    """Compute the posterior of each place, the last one first.

    The last cause is most often a look-alike of another. If there is no cause, the
    posterior is of what was not accepted.
    """
    data = state.prepared.data
    causes = state.fit.hypothesis.causes
    weights = bootstrap_weights(len(data.trials), seed)
    steps = iter(state.steps[-1:])
    if causes:
        steps = (
            _compare_alternatives(state, cause, effects, criteria, seed)
            for cause in reversed(causes)
        )
    for step in steps:
        yield single_effect_posterior(
            data, step, background, weights, len(effects), criteria.min_tip_shift_m
        )


def _compare_alternatives(
    state: SelectionState,
    cause: type[Effect],
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
) -> SelectionStep:
    """Compare what else may be in the place of a cause, the others staying."""
    first = state.steps[0]
    hypothesis = state.fit.hypothesis
    if (
        first.best is not None
        and first.best.hypothesis.cause_names == hypothesis.cause_names
    ):
        return first
    data = state.prepared.data
    others = hypothesis.without_cause(cause)
    reordered = others.with_cause(cause)
    accepted = evaluate_fit(
        data, reordered, reordered.exponents_from(state.fit.exponents)
    )
    parent = refit(data, state.fit, others)
    return compare_candidates(state.prepared, parent, effects, criteria, seed, accepted)


def bootstrap_weights(trials: int, seed: int) -> np.ndarray:
    """Draw how often each trial counts in a Bayesian bootstrap, (samples, K)."""
    rng = np.random.default_rng([seed, BOOTSTRAP_SAMPLES])
    return trials * rng.dirichlet(np.ones(trials), BOOTSTRAP_SAMPLES)


def single_effect_posterior(
    data: TrialData,
    step: SelectionStep,
    background: Sequence[np.ndarray],
    weights: np.ndarray,
    candidates: int,
    min_tip_shift_m: float,
) -> SingleEffectPosterior:
    """Compute the probability of each candidate of a step, and of none.

    Only refined fits compete, if there are any. An effect that moves the tip by less
    than counts is counted as none.

    Parameters
    ----------
    weights : numpy.ndarray, shape (samples, K)
        How often each trial counts.
    candidates : int
        Number of effects that share the prior probability of one being active.
    """
    competing = step.refined or step.fits
    fits = {
        fit.hypothesis.cause_names[-1]: fit for fit in competing if not fit.diverged
    }
    log_prior = np.log((1 - PRIOR_NO_EFFECT) / candidates)
    log_odds = {}
    for name, fit in {"": step.parent, **fits}.items():
        resampled = fit.log_evidence + (weights - 1) @ fit.log_likelihood_by_trial
        tempered = resampled + background_log_evidence_gains(
            data, fit, background, weights
        )
        log_odds[name] = tempered + (log_prior if name else np.log(PRIOR_NO_EFFECT))
    total = logsumexp(list(log_odds.values()), axis=0)
    probabilities = {
        name: float(np.mean(np.exp(value - total))) for name, value in log_odds.items()
    }
    for name, fit in fits.items():
        if tip_shift_rms(data, step.parent, fit).max() < min_tip_shift_m:
            probabilities[""] += probabilities.pop(name)
    return SingleEffectPosterior(probabilities, fits, step.parent)


def inclusion_probabilities(
    posteriors: Sequence[SingleEffectPosterior],
) -> dict[str, float]:
    """Compute the probability that each effect is in one place or another."""
    absent: dict[str, float] = {}
    for posterior in posteriors:
        for name, probability in posterior.probabilities.items():
            if name:
                absent[name] = absent.get(name, 1.0) * (1 - probability)
    return {name: 1 - share for name, share in absent.items()}
