"""Every effect may be a little wrong everywhere: evidence and intervals with that.

The effects of a library are never exactly absent. In addition to the causes of a
hypothesis, every effect may move the tip by a normal deviate of one small scale [m]
that all trials share and the data determine (SuSiE-inf: Cui et al., Nature Genetics 56,
162, 2024: a sparse sum and many small effects). This is linear about a fit and costs no
further fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from stringcast.stages.inference.discrepancy import (
    DISCREPANCY_SCALES_M,
    log_scale_prior,
)
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import (
    Effect,
    amplitude_parameters,
    is_position_dependent,
)

BACKGROUND_SCALES_M = DISCREPANCY_SCALES_M[DISCREPANCY_SCALES_M < 2e-3]
PROBE_FRACTION = 0.01  # of the way from absent to the end of a range: about linear


@dataclass(frozen=True)
class BackgroundPosterior:
    """The exponents of a fit with every effect a little wrong.

    Attributes
    ----------
    mean : numpy.ndarray, shape (P,)
    covariance : numpy.ndarray, shape (P, P)
    """

    mean: np.ndarray
    covariance: np.ndarray

    @property
    def standard_deviation(self) -> np.ndarray:
        """Standard deviation of each exponent, (P,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of each pair of exponents, (P, P)."""
        deviation = self.standard_deviation
        return self.covariance / np.outer(deviation, deviation)


def background_responses(
    data: TrialData, fit: Fit, effects: Sequence[type[Effect]]
) -> list[np.ndarray]:
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
        amplitudes = hypothesis.parameter_indices(effect, amplitude_parameters(effect))
        absent = start[amplitudes]
        end = np.where(absent > 0.5, 0.0, 1.0)
        chi = np.repeat(start[None], len(amplitudes), axis=0)
        chi[range(len(amplitudes)), amplitudes] += PROBE_FRACTION * (end - absent)
        residuals = data.residuals(hypothesis.model, chi)
        pairs = zip(residuals, fit.residuals, strict=True)
        changes = [residual - before for residual, before in pairs]
        _append_scaled(responses, data, changes)
    for cause in fit.hypothesis.causes:
        parameters = amplitude_parameters(cause)
        amplitudes = fit.hypothesis.parameter_indices(cause, parameters)
        _append_scaled(responses, data, [slope[amplitudes] for slope in fit.slopes])
    return [np.concatenate(each) for each in responses]


def _append_scaled(
    responses: Sequence[list[np.ndarray]],
    data: TrialData,
    changes: Sequence[np.ndarray],
) -> None:
    """Append displacements (C, 2 n) per metre at the tip, if they can be simulated."""
    shift_m = data.overall_tip_rms(changes)
    largest = [np.abs(change).max(axis=1) for change in changes]
    diverged = np.any(np.array(largest) > DIVERGED_RESIDUAL / 2, axis=0)
    kept = ~diverged & (shift_m > 0)
    for trial_responses, change in zip(responses, changes, strict=True):
        trial_responses.append(change[kept] / shift_m[kept, None])


def posterior_with_background(
    data: TrialData, fit: Fit, background: Sequence[np.ndarray]
) -> BackgroundPosterior:
    """Compute the posterior of a fit's exponents, averaged over background scales."""
    by_trial = _normal_equations_by_trial(data, fit, background)
    products, gradient = (np.sum(each, axis=0) for each in by_trial)
    count = len(fit.chi)
    log_evidence = []
    shifts = []
    covariances = []
    for scale_m in BACKGROUND_SCALES_M:
        value, step, normal = _solve_at_scale(products, gradient, count, scale_m)
        log_evidence.append(value)
        shifts.append(step[:count])
        covariances.append(np.linalg.inv(normal)[:count, :count])
    log_weight = np.array(log_evidence) + log_scale_prior()[: len(shifts)]
    weight = np.exp(log_weight - logsumexp(log_weight))
    shift = np.array(shifts)
    mean = weight @ shift
    spread = shift - mean
    within = np.tensordot(weight, np.array(covariances), 1)
    covariance = within + (weight * spread.T) @ spread
    return BackgroundPosterior(fit.chi + mean, covariance)


def background_log_evidence_gains(
    data: TrialData, fit: Fit, background: Sequence[np.ndarray], weights: np.ndarray
) -> np.ndarray:
    """Gain of a fit's log evidence by the background, (D,).

    Parameters
    ----------
    weights : numpy.ndarray, shape (D, K)
        How often each trial counts.
    """
    by_trial, gradient_by_trial = _normal_equations_by_trial(data, fit, background)
    products = np.tensordot(weights, by_trial, 1)
    gradient = weights @ gradient_by_trial
    log_evidence = np.array(
        [
            _solve_at_scale(products, gradient, len(fit.chi), scale_m)[0]
            for scale_m in BACKGROUND_SCALES_M
        ]
    )
    prior = log_scale_prior()[: len(BACKGROUND_SCALES_M), None]
    return np.asarray(logsumexp(log_evidence + prior, axis=0) - log_evidence[0])


def _normal_equations_by_trial(
    data: TrialData, fit: Fit, background: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Multiply white slopes of parameters and background, the parameters first.

    Returns
    -------
    products : numpy.ndarray, shape (K, M, M)
    gradients : numpy.ndarray, shape (K, M)
        Slopes times the white residual.
    """
    data = data.for_hypothesis(fit.hypothesis)
    scales = fit.scale_indices
    residuals = data.whiten_by_trial([r[None] for r in fit.residuals], scales)
    pairs = zip(fit.slopes, background, strict=True)
    slopes = [np.concatenate(pair) for pair in pairs]
    products = []
    gradients = []
    for white, residual in zip(
        data.whiten_by_trial(slopes, scales), residuals, strict=True
    ):
        products.append(white @ white.T)
        gradients.append(white @ residual[0])
    return np.array(products), np.array(gradients)


def _solve_at_scale(
    products: np.ndarray, gradient: np.ndarray, parameters: int, scale_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve the normal equations (..., M, M) with a background of one scale.

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
    occam = 0.5 * np.linalg.slogdet(normal)[1]
    return -0.5 * np.sum(step * scaled, axis=-1) - occam, step, normal
