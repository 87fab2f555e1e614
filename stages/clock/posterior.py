"""The offset given a fit, with every effect of the library possibly active.

Wind, a set or a lag that the model lacks would shift the offset. So each effect may
move the tip by a normal deviate, of one scale that all share and the data determine:
as in `background_effects` of a diagnosis, but up to the size of what a fit leaves
unexplained. This is linear about the fit.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.clock.fit import ClockFit
from stringcast.stages.diagnose.background_effects import (
    BackgroundPosterior,
    mixture_over_scales,
)
from stringcast.stages.inference.discrepancy_grid import (
    DISCREPANCY_SCALES_M,
    log_scale_prior,
)
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.trial_data import ByTrial

MAX_SCALE_M = 0.1  # of the effects' displacement of the tip
SCALES_M = DISCREPANCY_SCALES_M[DISCREPANCY_SCALES_M < MAX_SCALE_M]
LOG_SCALE_PRIOR = log_scale_prior()[: len(SCALES_M)]


def time_slopes(clock: ClockFit) -> ByTrial:
    """Return how residuals over sigma change with the offset, (2 n,) [1/s] by trial."""
    fit, index = clock.fit, clock.index
    parameter = fit.hypothesis.parameters[index]
    seconds_per_exponent = float(parameter.slope(np.asarray(fit.chi[index])))
    return [slopes[index] / seconds_per_exponent for slopes in fit.slopes]


def clock_posterior(
    clock: ClockFit, background: ByTrial, clock_columns: ByTrial, precision: np.ndarray
) -> BackgroundPosterior:
    """Compute the posterior of clock parameters, less those of the fit.

    It is averaged over background scales.

    Parameters
    ----------
    clock : ClockFit
        The fit; the clock columns replace its offset.
    background : sequence of numpy.ndarray, shape (E, 2 n)
        Displacements of each trial over sigma by effects, per metre at the tip.
    clock_columns : sequence of numpy.ndarray, shape (Q, 2 n)
        Slopes of residuals with the clock parameters.
    precision : numpy.ndarray, shape (Q,)
        Of the clock parameters' normal priors about the fit.
    """
    fit = clock.fit
    clock_count = len(precision)
    string_count = len(fit.chi) - 1
    effect_count = len(background[0])
    size = clock_count + string_count + effect_count
    normal = np.zeros((size, size))
    gradient = np.zeros(size)
    for k, trial in enumerate(clock.data.trials):
        string_columns = np.delete(fit.slopes[k], clock.index, axis=0)
        rows = np.concatenate([clock_columns[k], string_columns, background[k]])
        grid_point = fit.grid_points[k]
        white = trial.error_model.whiten(rows, grid_point)
        residual = trial.error_model.whiten(fit.residuals[k][None], grid_point)[0]
        normal += white @ white.T
        gradient += white @ residual

    string_precision = np.full(string_count, PRIOR_PRECISION)
    prior = np.concatenate([precision, string_precision, np.ones(effect_count)])
    log_evidence = []
    steps = []
    covariances = []
    for scale_m in SCALES_M:
        scale = np.ones(size)
        scale[clock_count + string_count :] = scale_m
        curvature = normal * np.outer(scale, scale) + np.diag(prior)
        inverse = np.linalg.inv(curvature)
        step = -inverse @ (scale * gradient)
        gain = -0.5 * float(step @ (scale * gradient))
        log_evidence.append(gain - 0.5 * np.linalg.slogdet(curvature)[1])
        steps.append(step[:clock_count])
        covariances.append(inverse[:clock_count, :clock_count])

    log_weight = np.array(log_evidence) + LOG_SCALE_PRIOR
    return mixture_over_scales(log_weight, steps, covariances)
