"""Parameters that the trials leave possible about a solution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.estimate.matching import MatchingTarget
from stringcast.stages.inference.covariance import Covariance, parameter_covariance
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.search import with_refined_initial_states
from stringcast.stages.inference.trial_data import TrialData

POSTERIOR_DRAWS = 400


def sample_posterior(chi: np.ndarray, covariance: Covariance, seed: int) -> np.ndarray:
    """Draw exponents (DRAWS, P) about a solution (P,), cut at the ends of the range."""
    rng = np.random.default_rng([seed, POSTERIOR_DRAWS])
    draws = rng.multivariate_normal(chi, covariance.matrix, POSTERIOR_DRAWS)
    return np.clip(draws, 0, 1)


def sample_least_squares_posterior(
    targets: Sequence[MatchingTarget], chi: np.ndarray, seed: int
) -> np.ndarray:
    """Draw exponents (DRAWS, P) about a solution (P,), whichever way it was found.

    They have the covariance of least squares there.
    """
    trials = tuple(target.trial for target in targets)
    likelihood = Likelihood(TrialData(trials), trials[0].model)
    refined = with_refined_initial_states(likelihood, chi)
    return sample_posterior(chi, parameter_covariance(refined, chi), seed)
