"""The time step of simulations: as long as accuracy allows.

The error of steps is extrapolated and corrected together with that of segments
(`discretisation`). In gentle motion, segments decide how uncertain this correction is:
longer steps save time and cost nothing. In a whip they do, and where a string is damped
so strongly that long steps ring.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from stringcast.stages.common import MM_PER_M
from stringcast.stages.diagnose.discretisation import discretisation_uncertainty
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import Likelihood

log = logging.getLogger(__name__)

# Of the tolerance: what longer steps may add to the uncertainty of a trial's correction
MAX_ADDED_UNCERTAINTY = 0.1


def lengthen_steps_while_accurate(
    likelihood: Likelihood,
    chi: np.ndarray,
    tolerance_m: float,
    longest_step_s: float,
) -> Likelihood:
    """Double the steps while that adds little to the uncertainty at the tips.

    Trials that the steps as they are do not resolve do not count. If there are no
    others, the steps stay.

    Parameters
    ----------
    likelihood : Likelihood
    chi : numpy.ndarray, shape (P,)
        Exponents of the fit.
    tolerance_m : float
        To which the tip of a trial must be resolved [m].
    longest_step_s : float
        To which steps are doubled at most [s].
    """
    uncertainty_m = _tip_uncertainty(likelihood, chi)
    is_resolved = uncertainty_m < tolerance_m
    if not is_resolved.any():
        return likelihood
    accurate = likelihood
    while 2 * accurate.model.string.largest_step <= longest_step_s:
        longer = _with_doubled_step(accurate)
        added_m = _tip_uncertainty(longer, chi) - uncertainty_m
        added_m = added_m[is_resolved]
        step_s = longer.model.string.largest_step
        added_mm = np.round(MM_PER_M * added_m, 2)
        log.info("steps of %g s: tips are less certain by %s mm", step_s, added_mm)
        if added_m.max() > MAX_ADDED_UNCERTAINTY * tolerance_m:
            break
        accurate = longer
    return accurate


def _with_doubled_step(likelihood: Likelihood) -> Likelihood:
    model = likelihood.model
    string = replace(model.string, largest_step=2 * model.string.largest_step)
    return likelihood.with_model(replace(model, string=string))


def _tip_uncertainty(likelihood: Likelihood, chi: np.ndarray) -> np.ndarray:
    """Compute how uncertain the discretisation error of each tip is [m], (K,)."""
    hypothesis = Hypothesis(likelihood.model)
    return discretisation_uncertainty(likelihood.data.trials, hypothesis, chi)
