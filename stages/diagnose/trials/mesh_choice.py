"""The choice of mesh and time step: the cheapest that is accurate.

The errors of segments and time steps are extrapolated and corrected together
(`discretisation`). Half of the segments suffice for a stiff string, and long steps for
a gentle motion. Both cost accuracy if the string whips. A fast vibration that is hardly
damped needs short steps.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from stringcast.stages.common import MM_PER_M
from stringcast.stages.diagnose.trials.discretisation import discretisation_uncertainty
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import likelihood_on_mesh

log = logging.getLogger(__name__)

SHORTER_STEP = 0.5  # factor of the time step
# Factors of segments and of the time step (`with_second_order_mesh`), the cheapest
# first. The last one is only cheaper than shorter steps.
MESHES = ((0.5, 4), (0.5, 2), (1, 4), (0.5, 1), (1, 2), (0.5, SHORTER_STEP))
# Of the tolerance: uncertainty of a trial's correction that a coarser mesh may add
MAX_ADDED_UNCERTAINTY = 0.1


def choose_mesh(
    likelihood: Likelihood,
    chi: np.ndarray,
    tolerance_m: float,
    may_be_coarser: bool = True,
) -> Likelihood:
    """Choose the cheapest mesh that resolves the trials as well as the given one.

    Steps are halved if that resolves more trials. If no trial is resolved, the given
    mesh stays.

    Parameters
    ----------
    chi : numpy.ndarray, shape (P,)
        Exponents of the fit.
    tolerance_m : float
        Tolerance to which simulation must resolve the tip of a trial [m].
    may_be_coarser : bool
        Whether a coarser mesh than the given one may be chosen.
    """
    chosen = likelihood
    cost = 1.0  # of simulation, relative to that on the given mesh
    uncertainty_m = _tip_uncertainty(chosen, chi)
    is_resolved = uncertainty_m < tolerance_m
    if not is_resolved.all():
        with_shorter_steps = _with_mesh(likelihood, 1, SHORTER_STEP)
        shorter_m = _tip_uncertainty(with_shorter_steps, chi)
        if (shorter_m < tolerance_m).sum() > is_resolved.sum():
            chosen = with_shorter_steps
            cost = 1 / SHORTER_STEP
            uncertainty_m = shorter_m
            is_resolved = shorter_m < tolerance_m
    if not may_be_coarser or not is_resolved.any():
        return chosen

    allowed_m = uncertainty_m + MAX_ADDED_UNCERTAINTY * tolerance_m
    for segments_factor, step_factor in MESHES:
        if segments_factor / step_factor >= cost:
            break
        coarser = _with_mesh(likelihood, segments_factor, step_factor)
        coarser_m = _tip_uncertainty(coarser, chi)
        if (coarser_m <= allowed_m)[is_resolved].all():
            return coarser
    return chosen


def _with_mesh(
    likelihood: Likelihood, segments_factor: float, step_factor: float
) -> Likelihood:
    model = likelihood_on_mesh(likelihood, segments_factor).model
    step_s = step_factor * likelihood.model.string.largest_step
    string = replace(model.string, largest_step=step_s)
    return likelihood.with_model(replace(model, string=string))


def _tip_uncertainty(likelihood: Likelihood, chi: np.ndarray) -> np.ndarray:
    """Compute the uncertainty of the discretisation error at each tip [m], (K,)."""
    hypothesis = Hypothesis(likelihood.model)
    trials = likelihood.data.trials
    uncertainty_m = discretisation_uncertainty(trials, hypothesis, chi)
    log.info(
        "%d segments, steps of %g s: tips are uncertain by %s mm",
        likelihood.model.string.points - 1,
        likelihood.model.string.largest_step,
        np.round(MM_PER_M * uncertainty_m, 2),
    )
    return uncertainty_m
