"""Hypotheses fitted to trials, and the evidence for each by Laplace's approximation.

    ln p(y | h) = sum_k ln p(y_k | theta, h)      log likelihood of the trials
                + ln p(theta | h)                 log prior of the causes' amplitudes
                + P/2 ln 2 pi - 1/2 ln |H|        log volume of the posterior

y_k are the coefficients of trial k; the course and scale of its discrepancy are
integrated out (`discrepancy`). H is the curvature at the best theta.

The prior of a cause's amplitude is a prior of its tip shift [m]: the root mean square,
over all frames of all trials, of the tip displacement that it causes. It is a mixture
of half-normals. So units do not matter, and a cause that moves nothing has no penalty.
It is multiplied by the density of the cause's size in its own unit, relative to that of
a small one (`log_size_prior`): a wind of 3 m/s is less common than a draught.

All other exponents have uniform priors in [0, 1]. In H, and for the base model also in
the fit, a normal of the same variance replaces them: it gives a finite volume to
parameters that the data do not determine.

References
----------
MacKay 2003, Information Theory, Inference, and Learning Algorithms, chapter 27.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.inference import solver
from stringcast.stages.inference.discrepancy_grid import (
    marginal_log_likelihood,
    most_likely_grid_point,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import PRIOR_PRECISION, Likelihood
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import (
    ByTrial,
    TrialData,
    subtract_by_trial,
)
from stringcast.stages.kept_results import keep_results
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter

# Widths of the half-normals, of equal weight
TIP_SHIFT_WIDTHS_M = np.array([1e-3, 3e-3, 1e-2, 3e-2])
SCREENING_ITERATIONS = 2  # of all starts, before only the best goes on
DISCREPANCY_DRAWS = 400  # gives probabilities within 0.025
ABSENCE_TOLERANCE = 1e-9  # of a range: with an amplitude so small a cause is absent
AMPLITUDE_PRECISION = 1e-9  # negligible, but keeps the curvature positive definite


@dataclass(frozen=True)
class Fit:
    """A hypothesis at its optimum.

    Parameters
    ----------
    hypothesis
        The fitted hypothesis.
    chi
        Exponents, (P,).
    residuals
        Residuals of each trial over sigma, (2 n,).
    slopes
        Derivatives of each trial's residuals by chi, (P, 2 n).
    width
        Widths of chi of their finite differences, (P,).
    grid_points
        The most probable course and scale of each trial's discrepancy, (K,): indices of
        the grid (`discrepancy_grid`).
    log_likelihood_by_trial
        Log-likelihood of each trial, integrated over course and scale, (K,).
    log_evidence
        Ln p(y | h).
    log_evidence_error
        Error of the log evidence because the fit has not converged: the gain in
        log-likelihood that the next Gauss-Newton step predicts (half the square of the
        Newton decrement: Boyd and Vandenberghe 2004, Convex Optimization, 9.5.1).
    """

    hypothesis: Hypothesis
    chi: np.ndarray
    residuals: ByTrial
    slopes: ByTrial
    width: np.ndarray
    grid_points: np.ndarray
    log_likelihood_by_trial: np.ndarray
    log_evidence: float
    log_evidence_error: float = 0.0

    @property
    def exponents(self) -> dict[str, float]:
        """The exponents by parameter name."""
        return dict(zip(self.hypothesis.model.names, self.chi.tolist(), strict=True))

    @property
    def widths(self) -> dict[str, float]:
        """The difference widths by parameter name."""
        return dict(zip(self.hypothesis.model.names, self.width.tolist(), strict=True))

    @property
    def values(self) -> dict[str, float]:
        """The parameters' values by name."""
        return self.hypothesis.model.values_at(self.chi)

    def cause_parameters(self, cause: type[Effect]) -> dict[str, float]:
        """Look up a cause's parameters by their own names."""
        values = self.values
        return {p.name: values[cause.qualified_name(p)] for p in cause.parameters}

    @property
    def has_diverged(self) -> bool:
        """Whether the simulation of a trial diverged."""
        return any((residual == DIVERGED_RESIDUAL).any() for residual in self.residuals)


def fit_hypothesis(
    data: TrialData,
    hypothesis: Hypothesis,
    starts: np.ndarray,
    grid_points: np.ndarray,
    min_gain: float = solver.MIN_GAIN,
    width: np.ndarray | None = None,
) -> Fit:
    """Fit the parameters of a hypothesis, and each discrepancy's course and scale.

    Parameters
    ----------
    starts
        Exponents, (C, P).
    grid_points
        Initial course and scale of each discrepancy, (K,).
    min_gain
        A step that gains less log-likelihood is slow (`solver`).
    width
        Difference widths (P,), if an earlier fit has chosen them. Differences that it
        simulated are not simulated again.
    """
    chi, width = best_exponents(data, hypothesis, starts, grid_points, min_gain, width)
    return evaluate_fit(data, hypothesis, chi, width)


def hypothesis_likelihood(
    data: TrialData, hypothesis: Hypothesis, grid_points: np.ndarray
) -> Likelihood:
    """Return the likelihood of a hypothesis at grid points (K,), for the solver.

    Parameters of the base model have their prior; those of causes have none.
    """
    return Likelihood(
        data.for_hypothesis(hypothesis),
        hypothesis.model,
        grid_points,
        uniform_indices=hypothesis.base_indices,
    )


@keep_results
def best_exponents(
    data: TrialData,
    hypothesis: Hypothesis,
    starts: np.ndarray,
    grid_points: np.ndarray,
    min_gain: float = solver.MIN_GAIN,
    width: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the best exponents (P,) and their difference widths (P,).

    Parameters as of `fit_hypothesis`.
    """
    likelihood = hypothesis_likelihood(data, hypothesis, grid_points)
    data = likelihood.data
    model = hypothesis.model

    # Screen the starts
    starts = solver.distinct_starts(likelihood, starts)
    iterations = SCREENING_ITERATIONS if len(starts) > 1 else 0
    runs = solver.fit_least_squares(
        likelihood, starts, iterations, min_gain, solver.MAX_GAINS_BEHIND, width=width
    )
    by_grid_point = data.log_likelihood_by_grid_point(data.residuals(model, runs.chi))
    best = int(np.argmax(marginal_log_likelihood(by_grid_point).sum(axis=0)))
    run = runs.select(best)
    updated = most_likely_grid_point(by_grid_point[:, best])

    # Alternate between grid points and one step of the parameters
    for _ in range(solver.MAX_ITERATIONS):
        if (updated != likelihood.grid_points).any():
            likelihood = replace(likelihood, grid_points=updated)
            run.reweight(likelihood)
        elif not run.active.any():
            break
        solver.iterate_runs(likelihood, run, min_gain)
        by_grid_point = data.log_likelihood_by_grid_point(
            data.residuals(model, run.chi)
        )
        updated = most_likely_grid_point(by_grid_point[:, 0])
    # The last differences, if they belong to these exponents, need not be repeated
    width = run.width[0] if run.stale[0] else run.used_width[0]
    return run.chi[0], width


def log_likelihoods(
    data: TrialData, hypothesis: Hypothesis, chi: np.ndarray
) -> np.ndarray:
    """Compute the log-likelihood of each trial at exponents (C, P), (K, C)."""
    data = data.for_hypothesis(hypothesis)
    residuals = data.residuals(hypothesis.model, chi)
    return marginal_log_likelihood(data.log_likelihood_by_grid_point(residuals))


def evaluate_fit(
    data: TrialData,
    hypothesis: Hypothesis,
    chi: np.ndarray,
    width: np.ndarray | None = None,
) -> Fit:
    """Evaluate a hypothesis and its log evidence at some exponents.

    Parameters
    ----------
    data
        Trials with their error models.
    hypothesis
        The hypothesis; its optimum should be near.
    chi
        Exponents, (P,).
    width
        Difference widths (P,) where a fit has chosen them.
    """
    data = data.for_hypothesis(hypothesis)
    model = hypothesis.model
    rows = data.residuals(model, chi[None])

    # Log likelihood of the trials
    by_grid_point = data.log_likelihood_by_grid_point(rows)[:, 0]  # (K, W S)
    grid_points = most_likely_grid_point(by_grid_point)
    by_trial = marginal_log_likelihood(by_grid_point)  # (K,)

    # Slopes, and residuals without each of the A amplitudes
    amplitudes = hypothesis.all_amplitude_indices
    absent = hypothesis.exponents_from({})
    is_absent = np.eye(len(chi), dtype=bool)[amplitudes]  # (A, P)
    without_one = np.where(is_absent, absent, chi)
    if width is None:  # trial differences give the scale of the slopes
        width = np.full(len(chi), solver.FIRST_DIFFERENCE)
        slopes, _ = _residual_slopes(data, model, chi, width, without_one)
        white = data.whiten(slopes, grid_points)
        width = solver.difference_widths(white[None], np.ones(1))[0]
    slopes, others = _residual_slopes(data, model, chi, width, without_one)

    # Log prior of the amplitudes
    residuals = [row[0] for row in rows]
    tip_shifts_m = data.overall_tip_rms(subtract_by_trial(residuals, others))
    tip_slopes_m = data.overall_tip_rms([slope[amplitudes] for slope in slopes])
    prior = 0.0
    for index, shift_m, slope_m in zip(
        amplitudes, tip_shifts_m, tip_slopes_m, strict=True
    ):
        distance = abs(chi[index] - absent[index])
        prior += log_prior(hypothesis.parameters[index], distance, shift_m, slope_m)
    for cause in hypothesis.causes:
        prior += log_size_prior(hypothesis, cause, chi)

    # Log volume of the posterior
    precision = np.full(len(chi), PRIOR_PRECISION)
    precision[amplitudes] = AMPLITUDE_PRECISION
    white_slopes = data.whiten(slopes, grid_points)  # (P, N)
    curvature = white_slopes @ white_slopes.T + np.diag(precision)  # (P, P)
    volume = log_volume(curvature)

    # Predicted gain of one more step
    white_residual = data.whiten([row[:1] for row in rows], grid_points)[0]  # (N,)
    gradient = white_slopes @ white_residual
    base = hypothesis.base_indices
    gradient[base] += PRIOR_PRECISION * (chi[base] - 0.5)

    return Fit(
        hypothesis,
        chi,
        residuals,
        slopes,
        width,
        grid_points,
        by_trial,
        log_evidence=float(by_trial.sum() + prior + volume),
        log_evidence_error=solver.predicted_gain(curvature, gradient, chi),
    )


def log_prior(
    amplitude: Parameter,
    distance: float,
    tip_shift: float,
    tip_slope: float,
) -> float:
    """Compute the log density of a cause's amplitude in its exponent.

    It is the density of the tip shift, times the tip shift per exponent.

    Parameters
    ----------
    distance
        Distance of the exponent from that without the cause.
    tip_shift
        Tip shift by the cause [m].
    tip_slope
        Tip shift per exponent at small amplitudes [m].
    """
    if distance > ABSENCE_TOLERANCE:
        tip_slope = tip_shift / distance
    else:
        tip_shift = 0.0
    density = float(tip_shift_density(np.asarray(tip_shift), amplitude) * tip_slope)
    return float(np.log(max(density, np.finfo(float).tiny)))


def tip_shift_density(tip_shift: np.ndarray, amplitude: Parameter) -> np.ndarray:
    """Compute the prior density [1/m] of tip shifts (...) [m] by an amplitude.

    For an amplitude of either sign, each sign has half of it.
    """
    is_two_sided = amplitude.low < amplitude.start < amplitude.high
    normal = np.exp(-0.5 * (tip_shift[..., None] / TIP_SHIFT_WIDTHS_M) ** 2)
    density = np.sqrt(2 / np.pi) / TIP_SHIFT_WIDTHS_M * normal
    return np.asarray(density.mean(axis=-1) * (0.5 if is_two_sided else 1.0))


def log_size_prior(
    hypothesis: Hypothesis, cause: type[Effect], chi: np.ndarray
) -> float:
    """Compute the log density of a cause's size at exponents (P,).

    It is relative to that of a small size.
    """
    sizes = []
    for index in hypothesis.amplitude_indices(cause):
        sizes.append(hypothesis.parameters[index].relative_size(chi[index]))
    return float(log_size_density(np.array(sizes)))


def log_size_density(relative_sizes: np.ndarray) -> np.ndarray:
    """Compute the log density of sizes (..., A), relative to that of small ones, (...).

    Amplitudes have a Cauchy distribution with their typical sizes: small ones are
    common, and large ones possible (Gelman et al., Ann. Appl. Stat. 2, 1360, 2008).

    relative_sizes: of A amplitudes, over their typical sizes.
    """
    return np.asarray(-np.log1p(np.sum(relative_sizes**2, axis=-1)))


def log_volume(curvature: np.ndarray) -> float:
    """Compute the log volume of a normal posterior from its curvature (P, P)."""
    log_determinant = np.linalg.slogdet(curvature)[1]
    return float(0.5 * (len(curvature) * np.log(2 * np.pi) - log_determinant))


def mean_discrepancy(data: TrialData, fit: Fit) -> ByTrial:
    """Compute the most likely discrepancy of each trial, over sigma, (2 n,)."""
    means = []
    for k, trial in enumerate(data.for_hypothesis(fit.hypothesis).trials):
        discrepancy = trial.discrepancy
        coefficients = discrepancy.coefficients(fit.residuals[k][None])[0]
        means.append(discrepancy.posterior_mean(coefficients, fit.grid_points[k]))
    return means


def sample_discrepancy_tip_rms(
    data: TrialData,
    fit: Fit,
    rng: np.random.Generator,
) -> np.ndarray:
    """Draw discrepancies from their posterior and compute their tip displacement.

    Returns root mean squares [m], (K, DISCREPANCY_DRAWS).
    """
    by_trial = []
    for k, trial in enumerate(data.for_hypothesis(fit.hypothesis).trials):
        discrepancy = trial.discrepancy
        coefficients = discrepancy.coefficients(fit.residuals[k][None])[0]
        at_tip = discrepancy.sample_posterior(
            coefficients,
            fit.grid_points[k],
            DISCREPANCY_DRAWS,
            rng,
            trial.is_tip,
        )
        by_trial.append(trial.tip_rms(at_tip))
    return np.stack(by_trial)


def _residual_slopes(
    data: TrialData,
    model: Model,
    chi: np.ndarray,
    width: np.ndarray,
    further_chi: np.ndarray,
) -> tuple[ByTrial, ByTrial]:
    """Compute slopes of each trial's residuals (2 n,) over widths (P,) of exponents.

    Returns slopes (P, 2 n), and residuals (A, 2 n) at further exponents (A, P), which
    cost little in the same batch.
    """
    differenced, offset = solver.difference_exponents(chi, width)
    count = len(differenced)
    slopes = []
    others = []
    for rows in data.residuals(model, np.concatenate([differenced, further_chi])):
        change = solver.residual_changes(rows[1:count], rows[0])
        slopes.append(change / offset[:, None])
        others.append(rows[count:])
    return slopes, others
