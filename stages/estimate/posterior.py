"""Parameters that the trials leave possible about a solution.

Forces are linear in the values of most parameters. So the residuals are linear in the
values as well, also where one drag stands in for the other, which a line in exponents
leaves at once. Before the trials every exponent is equally likely. Were every value, a
damping that no trial shows would be large: of 58 looks, tips in random casts were then
13 mm off the median draw in the mean, and 10 mm with exponents.

A block of time counts as one measurement of each coordinate, as in the comparison of
causes. What a model misses, such as the error of its mesh, is alike within a block. It
shifts a solution by 4 to 40 standard errors of independent noise.
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
LEAST_MEAN_SQUARE = 1e-6  # of residuals over their noise: data may have none


def sample_posterior(
    parameters: Sequence[Parameter],
    chi: np.ndarray,
    linear: Linearisation,
    independent_share: float,
    seed: int,
) -> np.ndarray:
    """Draw POSTERIOR_DRAWS exponents (K, P) about a solution (P,), within ranges."""
    values = parameter_values(parameters, chi)
    unit = parameter_values(parameters, chi + linear.step) - values
    change = linear.step[:, None] * linear.slope  # of the residuals with a unit
    weighted = linear.weight * change
    square = np.mean(linear.weight * linear.residual**2)
    precision = independent_share / max(square, LEAST_MEAN_SQUARE)
    likelihood = precision * weighted @ change.T

    rng = np.random.default_rng([seed, POSTERIOR_DRAWS])
    posterior = NormalInValues(parameters, chi, likelihood, unit)
    return posterior.sample(POSTERIOR_DRAWS, rng)


def share_of_blocks(linear: Linearisation) -> float:
    """Compute the share of residuals that are independent if a block counts as one."""
    return float(2 * (linear.block.max() + 1) / len(linear.residual))


def sample_least_squares_posterior(
    targets: Sequence[MatchingTarget], chi: np.ndarray, seed: int
) -> np.ndarray:
    """Draw exponents (K, P) about a solution (P,), whichever way it was found.

    The residuals are those of least squares there.
    """
    trials = tuple(target.trial for target in targets)
    likelihood = Likelihood(TrialData(trials), trials[0].model)
    refined = with_refined_initial_states(likelihood, chi)
    linear = linearise(refined, chi)
    share = share_of_blocks(linear)
    return sample_posterior(refined.parameters, chi, linear, share, seed)
