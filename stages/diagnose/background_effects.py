"""Every effect may be a little wrong everywhere: evidence and intervals with that.

The effects of a library are never exactly absent. In addition to the causes of a
hypothesis, every effect may move the tip by a normal deviate of one small scale [m]
that all trials share and the data determine (SuSiE-inf: Cui et al., Nature Genetics 56,
162, 2024: a sparse sum and many small effects). This is linear about a fit and costs no
further fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from stringcast.stages.inference.discrepancy_grid import (
    DISCREPANCY_SCALES_M,
    log_scale_prior,
)
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import (
    ByTrial,
    TrialData,
    subtract_by_trial,
)
from stringcast.stages.model.effect import Effect, is_position_dependent

# The smaller scales of the discrepancy, with the same prior
BACKGROUND_SCALES_M = DISCREPANCY_SCALES_M[DISCREPANCY_SCALES_M < 2e-3]
LOG_SCALE_PRIOR = log_scale_prior()[: len(BACKGROUND_SCALES_M)]
PROBE_FRACTION = 0.01  # of the way from absent to the end of a range: about linear


@dataclass(frozen=True)
class BackgroundPosterior:
    """Parameters of a fit, such as its exponents, with every effect a little wrong.

    Attributes
    ----------
    mean : numpy.ndarray, shape (P,)
    covariance : numpy.ndarray, shape (P, P)
    """

    mean: np.ndarray
    covariance: np.ndarray

    @property
    def standard_deviation(self) -> np.ndarray:
        """Standard deviation of each parameter, (P,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of each pair of parameters, (P, P)."""
        deviation = self.standard_deviation
        return self.covariance / np.outer(deviation, deviation)


def background_responses(
    data: TrialData,
    fit: Fit,
    effects: Sequence[type[Effect]],
) -> ByTrial:
    """Simulate what each effect does about a fit, scaled to 1 m at the tip.

    Effects that depend on place are left out: they do nothing but where they touch.

    Returns
    -------
    list of numpy.ndarray, shape (E, 2 n)
        Of each trial, over sigma.
    """
    responses = [[np.zeros((0, 2 * len(trial.s)))] for trial in data.trials]
    for effect in effects:
        if is_position_dependent(effect) or effect in fit.hypothesis.causes:
            continue
        hypothesis = fit.hypothesis.with_cause(effect)
        start = hypothesis.exponents_from(fit.exponents)
        amplitudes = hypothesis.amplitude_indices(effect)
        count = len(amplitudes)
        absent = start[amplitudes]
        end = np.where(absent > 0.5, 0.0, 1.0)
        chi = np.repeat(start[None], count, axis=0)
        chi[range(count), amplitudes] += PROBE_FRACTION * (end - absent)
        residuals = data.residuals(hypothesis.model, chi)
        changes = subtract_by_trial(residuals, fit.residuals)
        _append_scaled(responses, data, changes)
    for cause in fit.hypothesis.causes:
        amplitudes = fit.hypothesis.amplitude_indices(cause)
        _append_scaled(responses, data, [slope[amplitudes] for slope in fit.slopes])
    return [np.concatenate(each) for each in responses]


def _append_scaled(
    responses: Sequence[list[np.ndarray]],
    data: TrialData,
    changes: ByTrial,
) -> None:
    """Append displacements (C, 2 n) per metre at the tip, if they can be simulated."""
    shift_m = data.overall_tip_rms(changes)
    largest = np.max([np.abs(change).max(axis=1) for change in changes], axis=0)
    kept = (largest <= DIVERGED_RESIDUAL / 2) & (shift_m > 0)
    for trial_responses, change in zip(responses, changes, strict=True):
        trial_responses.append(change[kept] / shift_m[kept, None])


def posterior_with_background(
    data: TrialData,
    fit: Fit,
    background: ByTrial,
) -> BackgroundPosterior:
    """Compute the posterior of a fit's exponents, averaged over background scales."""
    by_trial, gradient_by_trial = _normal_equations_by_trial(data, fit, background)
    products = np.sum(by_trial, axis=0)
    gradient = np.sum(gradient_by_trial, axis=0)
    count = len(fit.chi)
    log_evidence = []
    steps = []
    covariances = []
    for scale_m in BACKGROUND_SCALES_M:
        value, step, normal = _solve_at_scale(products, gradient, count, scale_m)
        log_evidence.append(value)
        steps.append(step[:count])
        covariances.append(np.linalg.inv(normal)[:count, :count])

    log_weight = np.array(log_evidence) + LOG_SCALE_PRIOR
    mixture = mixture_over_scales(log_weight, steps, covariances)
    return replace(mixture, mean=fit.chi + mixture.mean)


def mixture_over_scales(
    log_weight: np.ndarray,
    means: Sequence[np.ndarray],
    covariances: Sequence[np.ndarray],
) -> BackgroundPosterior:
    """Compute the moments of a mixture of normal posteriors, one of each scale.

    Parameters
    ----------
    log_weight : numpy.ndarray, shape (S,)
        Of the scales, up to a constant.
    means : sequence of numpy.ndarray, shape (P,)
    covariances : sequence of numpy.ndarray, shape (P, P)
    """
    weight = np.exp(log_weight - logsumexp(log_weight))
    mean = weight @ np.array(means)
    spread = np.array(means) - mean
    within = np.tensordot(weight, np.array(covariances), 1)
    between = (weight * spread.T) @ spread
    return BackgroundPosterior(mean, within + between)


def background_log_evidence_gains(
    data: TrialData,
    fit: Fit,
    background: ByTrial,
    weights: np.ndarray,
) -> np.ndarray:
    """Gain of a fit's log evidence by the background, (D,), over none of it.

    Parameters
    ----------
    weights : numpy.ndarray, shape (D, K)
        How often each trial counts.
    """
    by_trial, gradient_by_trial = _normal_equations_by_trial(data, fit, background)
    products = np.tensordot(weights, by_trial, 1)
    gradient = weights @ gradient_by_trial
    by_scale = []
    for scale_m in BACKGROUND_SCALES_M:
        value, _, _ = _solve_at_scale(products, gradient, len(fit.chi), scale_m)
        by_scale.append(value)
    log_evidence = np.array(by_scale)
    total = logsumexp(log_evidence + LOG_SCALE_PRIOR[:, None], axis=0)
    return np.asarray(total - log_evidence[0])


def _normal_equations_by_trial(
    data: TrialData,
    fit: Fit,
    background: ByTrial,
) -> tuple[np.ndarray, np.ndarray]:
    """Multiply white slopes of parameters and background, M in all.

    Returns
    -------
    products : numpy.ndarray, shape (K, M, M)
        Those of parameters first.
    gradients : numpy.ndarray, shape (K, M)
        Slopes times the white residual.
    """
    data = data.for_hypothesis(fit.hypothesis)
    grid_points = fit.grid_points
    pairs = zip(fit.slopes, background, strict=True)
    slopes = [np.concatenate(pair) for pair in pairs]
    residuals = [residual[None] for residual in fit.residuals]
    white_slopes = data.whiten_by_trial(slopes, grid_points)
    white_residuals = data.whiten_by_trial(residuals, grid_points)
    products = []
    gradients = []
    for slope, residual in zip(white_slopes, white_residuals, strict=True):
        products.append(slope @ slope.T)
        gradients.append(slope @ residual[0])
    return np.array(products), np.array(gradients)


def _solve_at_scale(
    products: np.ndarray,
    gradient: np.ndarray,
    parameters: int,
    scale_m: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve the normal equations (..., M, M) with a background of one scale.

    All exponents have the normal prior of a uniform one, amplitudes of causes as well:
    it only keeps the equations solvable.

    Returns
    -------
    log_evidence : numpy.ndarray, shape (...)
    step : numpy.ndarray, shape (..., M)
    normal : numpy.ndarray, shape (..., M, M)
    """
    counts = [parameters, gradient.shape[-1] - parameters]
    scale = np.repeat([1.0, scale_m], counts)
    prior = np.repeat([PRIOR_PRECISION, 1.0], counts)
    normal = products * np.outer(scale, scale) + np.diag(prior)
    scaled = scale * gradient
    step = -np.linalg.solve(normal, scaled[..., None])[..., 0]
    gain = -0.5 * np.sum(step * scaled, axis=-1)
    log_volume = -0.5 * np.linalg.slogdet(normal)[1]
    return gain + log_volume, step, normal
