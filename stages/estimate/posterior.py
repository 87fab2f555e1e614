"""Draw parameters from the posterior around a solution.

The likelihood is normal in the values, because forces, and so residuals, are nearly
linear in most values. This also holds where one drag can replace the other; in
exponents, such a valley is curved. The prior is uniform in the exponents. A prior that
is uniform in the values would make a damping that no trial shows large: after 58 looks,
tips in random casts were then 13 mm from the median draw in the mean, and 10 mm with
exponents.

A block of time counts as one measurement of each coordinate, as in the comparison of
causes. Model error, such as that of the mesh, is correlated within a block. It shifts a
solution by 4 to 40 standard errors of independent noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.estimate.matching import MatchingTarget
from stringcast.stages.inference.covariance import Linearisation, linearise
from stringcast.stages.inference.exponent_samples import NormalInValues
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.search import with_refined_initial_states
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.parameter import Parameter, parameter_values

POSTERIOR_DRAWS = 400
LEAST_MEAN_SQUARE = 1e-6  # of residuals over sigma, for data without noise


def sample_posterior(
    parameters: Sequence[Parameter],
    chi: np.ndarray,
    linear: Linearisation,
    independent_share: float,
    seed: int,
) -> np.ndarray:
    """Draw POSTERIOR_DRAWS exponents (K, P) around a solution (P,), within ranges."""
    values = parameter_values(parameters, chi)
    unit = parameter_values(parameters, chi + linear.step) - values
    change = linear.step[:, None] * linear.slope  # of the residuals by a unit step
    weighted = linear.weight * change
    square = np.mean(linear.weight * linear.residual**2)
    precision = independent_share / max(square, LEAST_MEAN_SQUARE)
    likelihood = precision * weighted @ change.T

    rng = np.random.default_rng([seed, POSTERIOR_DRAWS])
    posterior = NormalInValues(parameters, chi, likelihood, unit)
    return posterior.sample(POSTERIOR_DRAWS, rng)


def share_of_blocks(linear: Linearisation) -> float:
    """Compute the share of independent residuals if each block counts as one."""
    return float(2 * (linear.block.max() + 1) / len(linear.residual))


def sample_least_squares_posterior(
    targets: Sequence[MatchingTarget], chi: np.ndarray, seed: int
) -> np.ndarray:
    """Draw exponents (K, P) around a solution (P,) of any method.

    The residuals are those of least squares at the solution.
    """
    trials = tuple(target.trial for target in targets)
    likelihood = Likelihood(TrialData(trials), trials[0].model)
    refined = with_refined_initial_states(likelihood, chi)
    linear = linearise(refined, chi)
    share = share_of_blocks(linear)
    return sample_posterior(refined.parameters, chi, linear, share, seed)
