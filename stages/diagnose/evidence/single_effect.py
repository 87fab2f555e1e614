"""Posterior probabilities of the effects in one slot of the sum of single effects.

The causes of a model are a sum with one effect in each slot (SuSiE: Wang et al., J. R.
Stat. Soc. B 82, 1273, 2020). All candidates and "no effect" compete in a slot, while a
small amount of every effect may be present (`background_effects`). Because trials are a
random sample, probabilities are averaged over a Bayesian bootstrap of them
(pseudo-BMA+: Yao, Vehtari, Simpson, Gelman, Bayesian Analysis 13, 917, 2018).
"""

from __future__ import annotations

import logging
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.stages.common import rms
from stringcast.stages.diagnose.evidence.background_effects import (
    Background,
    background_log_evidence_gains,
)
from stringcast.stages.diagnose.evidence.measures import (
    tip_shift_rms,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.evidence.probabilities import effect_probabilities
from stringcast.stages.diagnose.rules import (
    Criteria,
    is_inside_range,
    is_large_enough,
    remainder_hides,
)
from stringcast.stages.diagnose.search.selection_step import SelectionStep, by_evidence
from stringcast.stages.inference.laplace import Fit, log_size_prior
from stringcast.stages.inference.trial_data import TrialData

log = logging.getLogger(__name__)

BOOTSTRAP_SAMPLES = 100  # gives probabilities within 0.05
LOGGED_CAUSES = 5  # the most probable ones of each slot


@dataclass(frozen=True)
class SingleEffectPosterior:
    """Posterior of the effects in one slot of the sum of single effects.

    Attributes
    ----------
    probabilities : dict
        Probability of each candidate and of none (""); they sum to one.
    fits : dict
        Fits of the candidates that were fitted.
    fit_without : Fit
        The fit with nothing in this slot.
    data : TrialData
        The data of these fits.
    """

    probabilities: Mapping[str, float]
    fits: Mapping[str, Fit]
    fit_without: Fit
    data: TrialData

    @property
    def presence(self) -> float:
        """Probability that any cause is in the slot."""
        return 1 - self.probabilities.get("", 0.0)

    @property
    def ranked_causes(self) -> list[str]:
        """The candidates and none (""), the most probable first."""
        return sorted(self.probabilities, key=lambda name: -self.probabilities[name])

    @property
    def holds_a_cause(self) -> bool:
        """Whether the slot probably has a cause."""
        return self.presence > 0.5

    @property
    def likeliest_cause(self) -> str:
        """The most probable candidate, or none ("") if the slot is probably empty."""
        return next(filter(None, self.ranked_causes)) if self.holds_a_cause else ""

    def credible_set(self, coverage: float) -> tuple[str, ...]:
        """Select the fewest candidates whose probability reaches the coverage."""
        ranked = self.ranked_causes
        total = np.cumsum([self.probabilities[name] for name in ranked])
        last = int(np.searchsorted(total, coverage * total[-1]))
        return tuple(ranked[: last + 1])


def bootstrap_weights(trials: int, seed: int) -> np.ndarray:
    """Draw weights of trials for a Bayesian bootstrap, (samples, K)."""
    # A random stream apart from those of the fits
    rng = np.random.default_rng([seed, BOOTSTRAP_SAMPLES])
    return trials * rng.dirichlet(np.ones(trials), BOOTSTRAP_SAMPLES)


def single_effect_posterior(
    step: SelectionStep,
    background: Background,
    weights: np.ndarray,
    candidates: int,
    criteria: Criteria,
) -> SingleEffectPosterior:
    """Compute the probability of each candidate of a step, and of none.

    If there are fits on common data, only these compete. A cause at the end of its
    range does not compete, because it probably stands for another one. The probability
    of effects that are too small is added to that of none. Effects that
    differ by less than the unexplained misfit share their probability in proportion to
    the prior of their sizes. So do those with which trials cannot be simulated well
    enough.

    Parameters
    ----------
    step : SelectionStep
        Comparison of the candidates for this slot.
    background : Background
        Small amounts of other effects.
    weights : numpy.ndarray, shape (samples, K)
        Bootstrap weights of the trials.
    candidates : int
        Number of effects that share the prior probability of one being active.
    criteria : Criteria
        Its tolerance decides which effects are too small.
    """
    data = step.data
    fits = _fits_within_range(step.compared or step.fits)

    # Log evidence in each bootstrap sample, (samples,), by cause
    log_evidence = {}
    rng = np.random.default_rng(len(weights))
    for name, fit in {"": step.parent, **fits}.items():
        resampled = fit.log_evidence + (weights - 1) @ fit.log_likelihood_by_trial
        gains = background_log_evidence_gains(data, fit, background, weights)
        errors = fit.log_evidence_error * rng.standard_normal(len(weights))
        log_evidence[name] = resampled + gains + errors
    probabilities = effect_probabilities(log_evidence, candidates)

    # Small effects count as none
    for name, fit in fits.items():
        if not is_large_enough(data, step.parent, fit, criteria):
            probabilities[""] += probabilities.pop(name)

    # Effects that cannot be distinguished share their probability
    unresolved = _fits_within_range(step.unresolved)
    probabilities |= dict.fromkeys(unresolved, 0.0)
    fits |= unresolved
    probabilities |= _shared_probabilities(data, probabilities, fits, unresolved)

    posterior = SingleEffectPosterior(probabilities, fits, step.parent, data)
    ranked = []
    for name in posterior.ranked_causes[:LOGGED_CAUSES]:
        ranked.append(f"{name or 'none'} {probabilities[name]:.2f}")
    log.info("probabilities in a slot: %s", ", ".join(ranked))
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
        Probabilities of the most probable effect, of those that differ from it at the
        tip by no more than its misfit, and of unresolved ones, in proportion to the
        prior of their sizes.
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
    together = sum(probabilities[name] for name in similar)
    priors = {name: size_prior(fits[name]) for name in similar}
    total = sum(priors.values())
    return {name: together * prior / total for name, prior in priors.items()}


def size_prior(fit: Fit) -> float:
    """Compute the prior density of the last cause's size, relative to a small one."""
    cause = fit.hypothesis.causes[-1]
    return float(np.exp(log_size_prior(fit.hypothesis, cause, fit.chi)))


def inclusion_probabilities(
    posteriors: Sequence[SingleEffectPosterior],
) -> dict[str, float]:
    """Compute the probability that each effect is in any slot."""
    absent: dict[str, float] = {}
    for posterior in posteriors:
        for name, probability in posterior.probabilities.items():
            if name:
                absent[name] = absent.get(name, 1.0) * (1 - probability)
    return {name: 1 - share for name, share in absent.items()}
