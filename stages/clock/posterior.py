"""The posterior of the offset, with a small amount of every effect of the library.

Missing effects such as wind, a set or a lag would shift the offset. So each effect may
move the tip by a normal deviate. Its scale is common to all effects and estimated from
the data, as in `background_effects` of a diagnosis, but with larger scales, up to the
size of unexplained misfit. This is linearised at the fit.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.clock.fit import ClockFit
from stringcast.stages.diagnose.background_effects import (
    BackgroundPosterior,
    posterior_of_steps,
)
from stringcast.stages.inference.discrepancy_grid import DISCREPANCY_SCALES_M
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.trial_data import ByTrial

MAX_SCALE_M = 0.1  # of the tip displacement by effects
SCALES_M = DISCREPANCY_SCALES_M[DISCREPANCY_SCALES_M < MAX_SCALE_M]


def time_slopes(clock: ClockFit) -> ByTrial:
    """Return derivatives of each trial's residuals by the offset, (2 n,) [1/s]."""
    fit, index = clock.fit, clock.index
    parameter = fit.hypothesis.parameters[index]
    seconds_per_exponent = float(parameter.slope(np.asarray(fit.chi[index])))
    return [slopes[index] / seconds_per_exponent for slopes in fit.slopes]


def clock_posterior(
    clock: ClockFit, background: ByTrial, clock_columns: ByTrial, precision: np.ndarray
) -> BackgroundPosterior:
    """Compute the posterior of clock parameters relative to the fit.

    Parameters
    ----------
    clock : ClockFit
        The fit; the clock columns replace its offset.
    background : sequence of numpy.ndarray, shape (E, 2 n)
        Displacements of each trial over sigma by effects, per metre at the tip.
    clock_columns : sequence of numpy.ndarray, shape (Q, 2 n)
        Derivatives of residuals by the clock parameters.
    precision : numpy.ndarray, shape (Q,)
        Precision of the clock parameters' normal priors, centred at the fit.
    """
    fit = clock.fit
    slopes = []
    for columns, fit_slopes in zip(clock_columns, fit.slopes, strict=True):
        string_slopes = np.delete(fit_slopes, clock.index, axis=0)
        slopes.append(np.concatenate([columns, string_slopes]))
    string_precision = np.full(len(fit.chi) - 1, PRIOR_PRECISION)
    steps = posterior_of_steps(
        clock.data,
        fit,
        slopes,
        np.concatenate([precision, string_precision]),
        background,
        SCALES_M,
    )
    count = len(precision)
    return BackgroundPosterior(steps.mean[:count], steps.covariance[:count, :count])
