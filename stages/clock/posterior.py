"""The offset given a fit, with every effect of the library possibly active.

Wind, a set or a lag that the model lacks would shift the offset. So each effect may
move the tip by a normal deviate, of one scale that all share and the data determine:
as in `background_effects` of a diagnosis, but up to the size of what a fit leaves
unexplained. This is linear about the fit.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.diagnose.background_effects import (
    BackgroundPosterior,
    mixture_over_scales,
)
from stringcast.stages.inference.discrepancy import (
    DISCREPANCY_SCALES_M,
    log_scale_prior,
)
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.trial_data import ByTrial, TrialData

MAX_SCALE_M = 0.1  # of the effects' displacement of the tip
SCALES_M = DISCREPANCY_SCALES_M[DISCREPANCY_SCALES_M < MAX_SCALE_M]
LOG_SCALE_PRIOR = log_scale_prior()[: len(SCALES_M)]


def time_slopes(fit: Fit, index: int) -> ByTrial:
    """Return how residuals change with the offset, over sigma, (2 n,) [1/s].

    index: of the offset among the parameters.
    """
    parameter = fit.hypothesis.parameters[index]
    slope = float(parameter.slope(np.asarray(fit.chi[index])))
    return [slopes[index] / slope for slopes in fit.slopes]


def clock_posterior(
    data: TrialData,
    fit: Fit,
    index: int,
    background: ByTrial,
    clock_columns: ByTrial,
    precision: np.ndarray,
) -> BackgroundPosterior:
    """Compute the posterior of clock parameters, less those of the fit.

    It is averaged over background scales.

    Parameters
    ----------
    index : int
        Of the offset among the fit's parameters; the clock columns replace it.
    background : sequence of numpy.ndarray, shape (E, 2 n)
        Displacements of each trial over sigma by effects, per metre at the tip.
    clock_columns : sequence of numpy.ndarray, shape (Q, 2 n)
        Slopes of residuals with the clock parameters.
    precision : numpy.ndarray, shape (Q,)
        Of the clock parameters' normal priors about the fit.
    """
    count = len(precision)
    others = len(fit.chi) - 1
    size = count + others + len(background[0])
    normal = np.zeros((size, size))
    gradient = np.zeros(size)
    for k in range(len(fit.residuals)):
        material = np.delete(fit.slopes[k], index, axis=0)
        rows = np.concatenate([clock_columns[k], material, background[k]])
        error_model = data.trials[k].error_model
        white = error_model.whiten(rows, fit.scale_indices[k])
        residual = error_model.whiten(fit.residuals[k][None], fit.scale_indices[k])[0]
        normal += white @ white.T
        gradient += white @ residual

    effects = size - count - others
    prior = np.concatenate(
        [precision, np.full(others, PRIOR_PRECISION), np.ones(effects)]
    )
    log_evidence = []
    steps = []
    covariances = []
    for scale_m in SCALES_M:
        scale = np.concatenate([np.ones(count + others), np.full(effects, scale_m)])
        curvature = normal * np.outer(scale, scale) + np.diag(prior)
        inverse = np.linalg.inv(curvature)
        step = -inverse @ (scale * gradient)
        gain = -0.5 * float(step @ (scale * gradient))
        log_evidence.append(gain - 0.5 * np.linalg.slogdet(curvature)[1])
        steps.append(step[:count])
        covariances.append(inverse[:count, :count])

    log_weight = np.array(log_evidence) + LOG_SCALE_PRIOR
    return mixture_over_scales(log_weight, steps, covariances)
