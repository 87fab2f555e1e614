"""Comparisons of causes with the trials, and their log evidence.

The log evidence is that of the Bayesian information criterion [1]_, as a gain over the
original model:

    log evidence = 2 n ln(rms_0 / rms) - p / 2 ln(n)

n is the number of independent blocks of time, of two coordinates each. p is the number
of parameters of the causes. rms and rms_0 are the residuals with and without them.

References
----------
.. [1] Schwarz, Annals of Statistics 6, 461 (1978).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.stages.diagnose.evidence.probabilities import PRIOR_NO_EFFECT
from stringcast.stages.model.effect import Effect

Causes = tuple[str, ...]  # names of effects that act together, sorted
NO_CAUSE: Causes = ()
MIN_EXPLAINED_FRACTION = 0.5  # of the mean square misfit, for a cause to be named


@dataclass(frozen=True)
class Comparison:
    """Comparison of some causes, or none, with the trials.

    Parameters
    ----------
    causes : names of the effects; empty for the original model
    log_evidence : gain over the original model
    rms_m : root mean square residual of the centre-line [m]; NaN if the causes were
        neither screened nor fitted in these trials
    estimate : estimate with the causes, if they were fitted
    screened : exponents by name if the causes were not fitted: after the screening, or
        of a fit with more causes
    """

    causes: Causes
    log_evidence: float
    rms_m: float
    estimate: Estimate | None = None
    screened: Mapping[str, float] = field(default_factory=dict)

    @property
    def has_residual(self) -> bool:
        """Whether the residual in these trials is known; else it is NaN."""
        return not np.isnan(self.rms_m)

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
        residual_m = self.rms_m * float(np.exp(-0.5 * gain / blocks))
        return replace(self, log_evidence=self.log_evidence + gain, rms_m=residual_m)


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
    return Comparison(NO_CAUSE, 0.0, rms_m(estimate), estimate)


def rms_m(estimate: Estimate) -> float:
    """Return the root mean square residual of the centre-line [m]."""
    return float(estimate.fit["rms_after"].iloc[0])


def tip_rms_m(estimate: Estimate | None) -> float:
    """Return the root mean square residual of the tip [m]; NaN without a fit."""
    return np.nan if estimate is None else float(estimate.fit["tip_after"].iloc[0])


def noise_m(observations: Sequence[Observation]) -> float:
    """Return the distance by which noise alone moves a measured point [m]."""
    sigma = pd.concat([observation.points["sigma"] for observation in observations])
    return float(np.sqrt(2) * sigma.median())


def explains_half(
    comparison: Comparison, base: Comparison, noise_rms_m: float = 0.0
) -> bool:
    """Return whether causes explain half of the mean square misfit of a base.

    noise_rms_m: noise, which is not counted as misfit [m].
    """
    misfit = base.rms_m**2 - noise_rms_m**2
    remaining = comparison.rms_m**2 - noise_rms_m**2
    return remaining <= (1 - MIN_EXPLAINED_FRACTION) * misfit
