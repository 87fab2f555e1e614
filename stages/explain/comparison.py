"""Comparisons of causes with the trials, and their log evidence.

The log evidence is that of the Bayesian information criterion [1]_, as a gain over the
original model:

    log evidence = 2 n ln(r_0 / r) - p / 2 ln(n)

n is the number of independent blocks of time, of two coordinates each. p is the number
of parameters of the causes. r and r_0 are the root mean square residuals over the
points' sigma, with and without them. In distances, a few poorly read frames of a film
would hide the rest.

References
----------
.. [1] Schwarz, Annals of Statistics 6, 461 (1978).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stringcast.data.estimates import Estimate
from stringcast.stages.diagnose.evidence.probabilities import PRIOR_NO_EFFECT
from stringcast.stages.model.effect import Effect

Causes = tuple[str, ...]  # names of effects that act together, sorted
NO_CAUSE: Causes = ()
NOISE_RATIO = 1.0  # residual over sigma of noise alone
MIN_EXPLAINED_FRACTION = 0.5  # of the mean square misfit, for a cause to be named


@dataclass(frozen=True)
class Comparison:
    """Comparison of some causes, or none, with the trials.

    Parameters
    ----------
    causes : names of the effects; empty for the original model
    log_evidence : gain over the original model
    residual_ratio : root mean square residual over the points' sigma; NaN if the
        causes were neither screened nor fitted in these trials
    estimate : estimate with the causes, if they were fitted
    screened : exponents by name if the causes were not fitted: after the screening, or
        of a fit with more causes
    """

    causes: Causes
    log_evidence: float
    residual_ratio: float
    estimate: Estimate | None = None
    screened: Mapping[str, float] = field(default_factory=dict)

    @property
    def has_residual(self) -> bool:
        """Whether the residual in these trials is known; else it is NaN."""
        return not np.isnan(self.residual_ratio)

    @property
    def exponents(self) -> Mapping[str, float]:
        """Exponents of all parameters by name."""
        if self.estimate is None:
            return self.screened
        fitted = self.estimate.parameters
        return dict(zip(fitted["name"], fitted["chi"], strict=True))

    def with_gain(self, gain: float, blocks: int) -> Comparison:
        """Return a comparison with a higher log evidence and a smaller residual.

        blocks: number of independent blocks of time.
        """
        ratio = self.residual_ratio * float(np.exp(-0.5 * gain / blocks))
        evidence = self.log_evidence + gain
        return replace(self, log_evidence=evidence, residual_ratio=ratio)


def bic_penalty(effects: Sequence[type[Effect]], blocks: int) -> float:
    """Compute what the parameters of effects cost in log evidence."""
    parameters = sum(len(effect.parameters) for effect in effects)
    return float(0.5 * parameters * np.log(blocks))


def log_prior_odds_of_further_causes(causes: Causes, candidates: int) -> float:
    """Compute the log prior odds of all causes but the first.

    A priori, effects are independent. `effect_probabilities` includes the odds of one.
    """
    prior_odds = (1 - PRIOR_NO_EFFECT) / candidates / PRIOR_NO_EFFECT
    further = max(len(causes) - 1, 0)
    return float(further * np.log(prior_odds))


def without_causes(estimate: Estimate) -> Comparison:
    """Return the comparison of the original model."""
    return Comparison(NO_CAUSE, 0.0, estimate.residual_ratio, estimate)


def tip_rms_m(estimate: Estimate | None) -> float:
    """Return the root mean square residual of the tip [m]; NaN without a fit."""
    return np.nan if estimate is None else float(estimate.fit["tip_after"].iloc[0])


def explains_half(
    comparison: Comparison, base: Comparison, noise_ratio: float = 0.0
) -> bool:
    """Return whether causes explain half of the mean square misfit of a base.

    noise_ratio: noise over sigma, which is not counted as misfit.
    """
    misfit = base.residual_ratio**2 - noise_ratio**2
    remaining = comparison.residual_ratio**2 - noise_ratio**2
    return remaining <= (1 - MIN_EXPLAINED_FRACTION) * misfit
