"""Estimation of noise and removal of outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.data.trial_faults import MIN_FRAMES
from stringcast.stages.diagnose.evidence.measures import residuals_without_nuisance
from stringcast.stages.diagnose.trials.prepared_data import (
    PreparedData,
    with_initial_states_of,
)
from stringcast.stages.inference.initial_modes import trials_with_reestimated_start
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.noise import (
    WHITE_NOISE,
    fit_noise_model,
    noise_track,
    remove_smooth_motion,
)
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import ByTrial, TrialData
from stringcast.stages.model.model import Model

# Estimated over given noise: above this ratio the estimate replaces the given noise
OVERRULING_NOISE_RATIO = 1.3
OUTLIER_SIGMAS = 6.0  # from smooth motion: one point in 5e8 by chance
OUTLIER_PASSES = 3  # one outlier may hide another
# If a better fit leaves a smaller share of the outliers, they were misfit
OUTLIER_RETENTION = 0.5


def estimate_initial_noise(
    likelihood: Likelihood,
    chi: np.ndarray,
    noise_is_given: bool,
) -> tuple[tuple[PreparedTrial, ...], tuple[PreparedTrial, ...]]:
    """Set the noise of all trials from the residuals of the base model.

    Smooth motion is first removed from the residuals: it is misfit of the model.
    Returns the trials with outliers and without.
    """
    measured = likelihood.data.trials
    kept, residuals, levels = remove_outliers(measured, likelihood.model, chi)
    level = float(np.median(levels))
    if noise_is_given and not level > OVERRULING_NOISE_RATIO:
        level = 1.0
    trials = _scale_sigma(kept, level)
    scaled_residuals = [residual / level for residual in residuals]
    trials = estimate_noise(trials, scaled_residuals, noise_is_given)
    return _scale_sigma(measured, level), trials


def _scale_sigma(
    trials: Sequence[PreparedTrial],
    factor: float,
) -> tuple[PreparedTrial, ...]:
    return tuple(replace(trial, sigma=factor * trial.sigma) for trial in trials)


def reestimate_noise(prepared: PreparedData, fit: Fit) -> PreparedData:
    """Re-estimate the noise, and reconsider outliers, from a better fit's residuals.

    Misfit of a poorer model inflates the noise estimate, and fast motion that it
    misses looks like outliers. Outliers are restored if the better fit explains at
    least half of them.
    """
    if prepared.outlier_count:
        restarted = trials_with_reestimated_start(prepared.data, fit)
        measured = with_initial_states_of(prepared.trials_with_outliers, restarted)
        kept, residuals, _ = remove_outliers(measured, fit.hypothesis.model, fit.chi)
        reconsidered = replace(
            prepared,
            trials_with_outliers=measured,
            trials=kept,
            data=replace(prepared.data, mesh_correction=None),
        )
        if reconsidered.outlier_count < OUTLIER_RETENTION * prepared.outlier_count:
            trials = estimate_noise(kept, residuals, prepared.noise_is_given)
            return replace(reconsidered, trials=trials)
    # Initial states displace points to first order, which may look like noise
    residuals = residuals_without_nuisance(prepared.data, fit)
    trials = estimate_noise(prepared.trials, residuals, prepared.noise_is_given)
    return replace(prepared, trials=trials)


def estimate_noise(
    trials: Sequence[PreparedTrial],
    residuals: ByTrial,
    noise_is_given: bool,
) -> tuple[PreparedTrial, ...]:
    """Set the correlated noise of trials from residuals over sigma.

    Parameters
    ----------
    residuals : sequence of numpy.ndarray, shape (n, 2) or (2 n,)
    noise_is_given : bool
        Whether to keep white noise if less noise is found than is given.
    """
    tracks = []
    for trial, residual in zip(trials, residuals, strict=True):
        tracks.append(noise_track(trial, residual.reshape(-1, 2)))
    noise = fit_noise_model(tracks)
    if noise_is_given and noise.variance_of_means < 1:
        noise = WHITE_NOISE
    return tuple(replace(trial, noise=noise) for trial in trials)


def remove_outliers(
    trials: Sequence[PreparedTrial],
    model: Model,
    chi: np.ndarray,
) -> tuple[tuple[PreparedTrial, ...], ByTrial, list[float]]:
    """Remove points whose residual at exponents (P,) is far from smooth motion.

    Returns
    -------
    trials : tuple of PreparedTrial
    residuals : list of numpy.ndarray, shape (n, 2)
        Residuals of the remaining points over sigma.
    levels : list of float
        Noise of each trial over sigma.
    """
    all_residuals = TrialData(tuple(trials)).residuals(model, chi[None])
    kept = []
    residuals = []
    levels = []
    for trial, flat_residual in zip(trials, all_residuals, strict=True):
        rest, residual, level = _remove_trial_outliers(
            trial, flat_residual.reshape(-1, 2)
        )
        kept.append(rest)
        residuals.append(residual)
        levels.append(level)
    return tuple(kept), residuals, levels


def _remove_trial_outliers(
    trial: PreparedTrial,
    residual: np.ndarray,
) -> tuple[PreparedTrial, np.ndarray, float]:
    level = float("nan")
    for _ in range(OUTLIER_PASSES):
        rough, level = remove_smooth_motion(trial, residual)
        near = np.linalg.norm(rough, axis=1) < OUTLIER_SIGMAS * level
        if near.all() or len(np.unique(trial.frame[near])) < MIN_FRAMES:
            break
        trial = trial.select_points(near)
        residual = residual[near]
    return trial, residual, level
