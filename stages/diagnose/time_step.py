"""The choice of the time step: as long as accuracy allows.

The error of time steps is extrapolated and corrected together with that of segments
(`discretisation`). In gentle motion, the uncertainty of this correction comes from the
segments, and longer steps save time. They cost accuracy if the string whips, or if
damping is so strong that long steps ring.
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

# Of the tolerance: uncertainty of a trial's correction that longer steps may add
MAX_ADDED_UNCERTAINTY = 0.1


def lengthen_steps_while_accurate(
    likelihood: Likelihood,
    chi: np.ndarray,
    tolerance_m: float,
    longest_step_s: float,
) -> Likelihood:
    """Double the time step while that adds little to the uncertainty at the tips.

    Only trials that the given step resolves are considered. If there are none, the
    step stays.

    Parameters
    ----------
    chi : numpy.ndarray, shape (P,)
        Exponents of the fit.
    tolerance_m : float
        Tolerance to which simulation must resolve the tip of a trial [m].
    longest_step_s : float
        Upper limit of the step [s].
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
    """Compute the uncertainty of the discretisation error at each tip [m], (K,)."""
    hypothesis = Hypothesis(likelihood.model)
    return discretisation_uncertainty(likelihood.data.trials, hypothesis, chi)
