"""Evidence and intervals with a small amount of every effect in the background.

No effect of the library is exactly absent. In addition to the causes of a hypothesis,
every effect may move the tip by a normal deviate. Its scale [m] is less than the
tolerance, common to all effects and trials, and estimated from the data (SuSiE-inf, a
sparse sum and many small effects: Cui et al., Nature Genetics 56, 162, 2024). This is
linearised at a fit, so that no further fit is needed.
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

PROBE_FRACTION = 0.01  # size of a probe as a fraction of the range: about linear


@dataclass(frozen=True)
class Background:
    """Small amounts of every effect.

    Attributes
    ----------
    responses : sequence of numpy.ndarray, shape (E, 2 n)
        Displacements of each trial over sigma, per metre at the tip.
    scales_m : numpy.ndarray, shape (S,)
        Possible scales: the first ones of DISCREPANCY_SCALES_M [m].
    """

    responses: ByTrial
    scales_m: np.ndarray


@dataclass(frozen=True)
class BackgroundPosterior:
    """A normal posterior of parameters, such as exponents, with background effects.

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


def find_background(
    data: TrialData,
    fit: Fit,
    effects: Sequence[type[Effect]],
    max_scale_m: float,
) -> Background:
    """Find the background at a fit, of scales up to a largest one."""
    scales_m = DISCREPANCY_SCALES_M[max_scale_m > DISCREPANCY_SCALES_M]
    return Background(_responses(data, fit, effects), scales_m)


def _responses(
    data: TrialData,
    fit: Fit,
    effects: Sequence[type[Effect]],
) -> ByTrial:
    """Compute the response to each effect at a fit, scaled to 1 m at the tip.

    Effects that depend on place are left out, because they act only where they touch.

    Returns
    -------
    list of numpy.ndarray, shape (E, 2 n)
        Responses of each trial over sigma.
    """
    by_effect: list[ByTrial] = [[np.zeros((0, 2 * len(t.s))) for t in data.trials]]
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
        by_effect.append(_scale_to_one_metre(data, changes))
    for cause in fit.hypothesis.causes:
        amplitudes = fit.hypothesis.amplitude_indices(cause)
        slopes = [slope[amplitudes] for slope in fit.slopes]
        by_effect.append(_scale_to_one_metre(data, slopes))
    return [np.concatenate(rows) for rows in zip(*by_effect, strict=True)]


def _scale_to_one_metre(data: TrialData, changes: ByTrial) -> ByTrial:
    """Scale displacements (C, 2 n) to 1 m at the tip; leave out those that diverge."""
    shift_m = data.overall_tip_rms(changes)
    largest = np.max([np.abs(change).max(axis=1) for change in changes], axis=0)
    kept = (largest <= DIVERGED_RESIDUAL / 2) & (shift_m > 0)
    return [change[kept] / shift_m[kept, None] for change in changes]


def posterior_with_background(
    data: TrialData,
    fit: Fit,
    background: Background,
) -> BackgroundPosterior:
    """Compute the posterior of a fit's exponents, averaged over background scales."""
    precision = np.full(len(fit.chi), PRIOR_PRECISION)
    steps = posterior_of_steps(data, fit, fit.slopes, precision, background)
    return replace(steps, mean=fit.chi + steps.mean)


def posterior_of_steps(
    data: TrialData,
    fit: Fit,
    slopes: ByTrial,
    precision: np.ndarray,
    background: Background,
) -> BackgroundPosterior:
    """Compute the posterior of steps of parameters from a fit, to first order.

    Parameters
    ----------
    slopes : sequence of numpy.ndarray, shape (P, 2 n)
        Derivatives of each trial's residuals over sigma by the parameters.
    precision : numpy.ndarray, shape (P,)
        Precision of the steps' normal priors.
    """
    by_trial, gradient_by_trial = _normal_equations_by_trial(
        data, fit, slopes, background.responses
    )
    products = np.sum(by_trial, axis=0)
    gradient = np.sum(gradient_by_trial, axis=0)
    count = len(precision)
    log_evidence = []
    means = []
    covariances = []
    for scale_m in background.scales_m:
        value, step, normal = _solve_at_scale(products, gradient, precision, scale_m)
        log_evidence.append(value)
        means.append(step[:count])
        covariances.append(np.linalg.inv(normal)[:count, :count])

    log_weight = np.array(log_evidence) + log_scale_prior()[: len(means)]
    return mix_normals(np.array(means), np.array(covariances), log_weight)


def mix_normals(
    means: np.ndarray, covariances: np.ndarray, log_weight: np.ndarray
) -> BackgroundPosterior:
    """Compute the moments of a mixture of normals (L, P) and (L, P, P).

    log_weight: of each normal, up to a constant, (L,).
    """
    weight = np.exp(log_weight - logsumexp(log_weight))
    mean = weight @ means
    spread = means - mean
    within = np.tensordot(weight, covariances, 1)
    between = (weight * spread.T) @ spread
    return BackgroundPosterior(mean, within + between)


def background_log_evidence_gains(
    data: TrialData,
    fit: Fit,
    background: Background,
    weights: np.ndarray,
) -> np.ndarray:
    """Gain of a fit's log evidence by the background, (D,).

    Parameters
    ----------
    weights : numpy.ndarray, shape (D, K)
        Bootstrap weights of the trials.
    """
    by_trial, gradient_by_trial = _normal_equations_by_trial(
        data, fit, fit.slopes, background.responses
    )
    products = np.tensordot(weights, by_trial, 1)
    gradient = weights @ gradient_by_trial
    # Also for amplitudes of causes, to keep the equations solvable
    precision = np.full(len(fit.chi), PRIOR_PRECISION)
    by_scale = []
    for scale_m in background.scales_m:
        value, _, _ = _solve_at_scale(products, gradient, precision, scale_m)
        by_scale.append(value)
    log_evidence = np.array(by_scale)
    log_prior = log_scale_prior()[: len(by_scale)]
    total = logsumexp(log_evidence + log_prior[:, None], axis=0)
    return np.asarray(total - log_evidence[0])


def _normal_equations_by_trial(
    data: TrialData,
    fit: Fit,
    slopes: ByTrial,
    responses: ByTrial,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute normal equations of parameters, then background, M in all.

    Returns
    -------
    products : numpy.ndarray, shape (K, M, M)
        Products of white slopes.
    gradients : numpy.ndarray, shape (K, M)
        White slopes times the white residual.
    """
    data = data.for_hypothesis(fit.hypothesis)
    grid_points = fit.grid_points
    pairs = zip(slopes, responses, strict=True)
    rows = [np.concatenate(pair) for pair in pairs]
    residuals = [residual[None] for residual in fit.residuals]
    white_rows = data.whiten_by_trial(rows, grid_points)
    white_residuals = data.whiten_by_trial(residuals, grid_points)
    products = []
    gradients = []
    for white, residual in zip(white_rows, white_residuals, strict=True):
        products.append(white @ white.T)
        gradients.append(white @ residual[0])
    return np.array(products), np.array(gradients)


def _solve_at_scale(
    products: np.ndarray,
    gradient: np.ndarray,
    precision: np.ndarray,
    scale_m: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve the normal equations (..., M, M) with a background of one scale.

    precision: precision of the parameters' normal priors, centred at the fit, (P,).

    Returns
    -------
    log_evidence : numpy.ndarray, shape (...)
    step : numpy.ndarray, shape (..., M)
    normal : numpy.ndarray, shape (..., M, M)
    """
    effects = gradient.shape[-1] - len(precision)
    scale = np.concatenate([np.ones(len(precision)), np.full(effects, scale_m)])
    prior = np.concatenate([precision, np.ones(effects)])
    normal = products * np.outer(scale, scale) + np.diag(prior)
    scaled = scale * gradient
    step = -np.linalg.solve(normal, scaled[..., None])[..., 0]
    gain = -0.5 * np.sum(step * scaled, axis=-1)
    log_volume = -0.5 * np.linalg.slogdet(normal)[1]
    return gain + log_volume, step, normal
