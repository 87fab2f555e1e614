"""Hypotheses fitted to trials, and the evidence for each by Laplace's approximation.

    ln p(y | h) = sum_k ln p(y_k | theta, h)      log likelihood of the trials
                + ln p(theta | h)                 log prior of the causes' amplitudes
                + P/2 ln 2 pi - 1/2 ln |H|        log volume of the posterior

y_k are the coefficients of trial k, with the onset and scale of its discrepancy
integrated out (`discrepancy`); H is the curvature at the best theta. The prior of an
amplitude of a cause is one of its tip shift: the root mean square, over all frames of
all trials, of how far it moves the tip [m]. It is half-normal of several widths. So
causes of any unit are equally likely, and one that moves nothing is no worse than none.

All other exponents are uniform in [0, 1]. In H, and for those of the base model in the
fit, a normal of the same variance stands for that: it gives a finite volume to what the
data do not determine.

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
from stringcast.stages.model.parameter import Parameter

# Widths of the prior of how far a cause moves the tip [m], each as likely
TIP_SHIFT_WIDTHS_M = np.array([1e-3, 3e-3, 1e-2, 3e-2])
SCREENING_ITERATIONS = 2  # iterations of several starts, before the best alone goes on
DISCREPANCY_DRAWS = 400  # of a discrepancy: a probability is known to 0.025
ABSENCE_TOLERANCE = 1e-9  # of a range: an amplitude so near to its start is absent
AMPLITUDE_PRECISION = 1e-9  # none, but keeps the curvature positive


@dataclass(frozen=True)
class Fit:
    """A hypothesis at its best.

    Parameters
    ----------
    hypothesis
        That was fitted.
    chi
        Exponents, (P,).
    residuals
        Of each trial, over sigma, (2 n,).
    slopes
        Of the residuals with chi, (P, 2 n) of each trial.
    width
        Of chi, over which these were differenced, (P,).
    grid_points
        The most probable onset and scale of each trial's discrepancy, (K,): indices of
        the grid (`discrepancy_grid`).
    log_likelihood_by_trial
        Log-likelihood of each trial, whatever these are, (K,).
    log_evidence
        Ln p(y | h).
    log_evidence_error
        By how much it may be wrong because the fit has not converged: the gain of the
        log-likelihood that one more Gauss-Newton step promises (half the square of the
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
    def values(self) -> dict[str, float]:
        """The parameters' values by name."""
        return self.hypothesis.model.values_at(self.chi)

    def cause_parameters(self, cause: type[Effect]) -> dict[str, float]:
        """Look up a cause's parameters by their own names."""
        values = self.values
        return {p.name: values[cause.qualified_name(p)] for p in cause.parameters}

    @property
    def has_diverged(self) -> bool:
        """Whether a trial could not be simulated."""
        return any((residual == DIVERGED_RESIDUAL).any() for residual in self.residuals)


def fit_hypothesis(
    data: TrialData,
    hypothesis: Hypothesis,
    starts: np.ndarray,
    grid_points: np.ndarray,
    min_gain: float = solver.MIN_GAIN,
) -> Fit:
    """Fit a hypothesis: its parameters and where discrepancies are on their grid.

    Parameters
    ----------
    starts
        Exponents, (C, P).
    grid_points
        The onset and scale of each discrepancy to start with, (K,).
    min_gain
        A step that gains less of the log-likelihood ends its turn.
    """
    chi, width = best_exponents(data, hypothesis, starts, grid_points, min_gain)
    return evaluate_fit(data, hypothesis, chi, width)


@keep_results
def best_exponents(
    data: TrialData,
    hypothesis: Hypothesis,
    starts: np.ndarray,
    grid_points: np.ndarray,
    min_gain: float = solver.MIN_GAIN,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the exponents of a fit (P,), and over which widths (P,) to difference them.

    Parameters as of `fit_hypothesis`.
    """
    data = data.for_hypothesis(hypothesis)
    model = hypothesis.model
    uniform = hypothesis.base_indices

    # Several starts side by side; the best of them goes on
    likelihood = Likelihood(data, model, grid_points, uniform_indices=uniform)
    starts = solver.distinct_starts(likelihood, starts)
    iterations = SCREENING_ITERATIONS if len(starts) > 1 else 0
    runs = solver.fit_least_squares(likelihood, starts, iterations, min_gain)
    by_grid_point = data.log_likelihood_by_grid_point(data.residuals(model, runs.chi))
    best = int(np.argmax(marginal_log_likelihood(by_grid_point).sum(axis=0)))
    run = runs.select(best)
    updated = most_likely_grid_point(by_grid_point[:, best])

    # The grid points and one step of the parameters in turn
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
    return run.chi[0], run.width[0]


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
    """Evaluate a hypothesis and its log evidence at exponents (P,).

    width: over which to difference them, (P,), where it is known from a fit.
    """
    data = data.for_hypothesis(hypothesis)
    rows = data.residuals(hypothesis.model, chi[None])
    residuals = [row[0] for row in rows]

    # Log likelihood of the trials
    by_grid_point = data.log_likelihood_by_grid_point(rows)[:, 0]
    grid_points = most_likely_grid_point(by_grid_point)
    by_trial = marginal_log_likelihood(by_grid_point)

    # Slopes, and residuals with each of the A amplitudes absent in turn
    amplitudes: list[int] = []
    for cause in hypothesis.causes:
        amplitudes += hypothesis.amplitude_indices(cause)
    absent = hypothesis.exponents_from({})
    is_absent = np.eye(len(chi), dtype=bool)[amplitudes]  # (A, P)
    without_one = np.where(is_absent, absent, chi)
    if width is None:  # the first differences say how wide the second should be
        width = np.full(len(chi), solver.FIRST_DIFFERENCE)
        slopes, _ = _residual_slopes(
            data, hypothesis, chi, width, residuals, without_one
        )
        white = data.whiten(slopes, grid_points)
        width = solver.difference_widths(white[None], np.ones(1))[0]
    slopes, others = _residual_slopes(
        data, hypothesis, chi, width, residuals, without_one
    )

    # Log prior of the amplitudes
    tip_shifts = data.overall_tip_rms(subtract_by_trial(residuals, others))
    tip_slopes = data.overall_tip_rms([slope[amplitudes] for slope in slopes])
    prior = 0.0
    for number, index in enumerate(amplitudes):
        prior += log_prior(
            hypothesis.parameters[index],
            abs(chi[index] - absent[index]),
            tip_shifts[number],
            tip_slopes[number],
        )

    # Log volume of the posterior
    precision = np.full(len(chi), PRIOR_PRECISION)
    precision[amplitudes] = AMPLITUDE_PRECISION
    white_slopes = data.whiten(slopes, grid_points)
    curvature = white_slopes @ white_slopes.T + np.diag(precision)
    volume = log_volume(curvature)

    # What one more step promises
    white_residual = data.whiten([row[:1] for row in rows], grid_points)[0]
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
        float(by_trial.sum() + prior + volume),
        solver.promised_gain(curvature, gradient, chi),
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
        Of the exponent from where the cause is absent.
    tip_shift
        Of the cause [m].
    tip_slope
        Slope of the tip shift with the exponent, where the cause is absent [m].
    """
    if distance > ABSENCE_TOLERANCE:
        tip_slope = tip_shift / distance
    else:
        tip_shift = 0.0
    density = float(tip_shift_density(np.asarray(tip_shift), amplitude) * tip_slope)
    return float(np.log(max(density, np.finfo(float).tiny)))


def tip_shift_density(tip_shift: np.ndarray, amplitude: Parameter) -> np.ndarray:
    """Compute the prior density [1/m] of tip shifts (...) [m] by an amplitude.

    Of an amplitude that can have either sign it is half to either side.
    """
    is_two_sided = amplitude.low < amplitude.start < amplitude.high
    normal = np.exp(-0.5 * (tip_shift[..., None] / TIP_SHIFT_WIDTHS_M) ** 2)
    density = np.sqrt(2 / np.pi) / TIP_SHIFT_WIDTHS_M * normal
    return np.asarray(density.mean(axis=-1) * (0.5 if is_two_sided else 1.0))


def log_volume(curvature: np.ndarray) -> float:
    """Compute the log volume of a normal posterior of this curvature (P, P)."""
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
    """Draw discrepancies given the data, and compute their size at each tip.

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
    hypothesis: Hypothesis,
    chi: np.ndarray,
    width: np.ndarray,
    residuals: ByTrial,
    further_chi: np.ndarray,
) -> tuple[ByTrial, ByTrial]:
    """Difference each trial's residuals (2 n,) by the exponents (P,) over a width (P,).

    Returns slopes (P, 2 n), and residuals (A, 2 n) at further exponents (A, P): more
    lanes of a batch cost little.
    """
    count = len(chi)
    offset = np.where(chi > 0.5, -width, width)
    points = np.concatenate([chi + np.diag(offset), further_chi])
    simulated = data.residuals(hypothesis.model, points)
    slopes = []
    for rows, residual in zip(simulated, residuals, strict=True):
        moved = rows[:count]
        diverged = (moved == DIVERGED_RESIDUAL) | (residual == DIVERGED_RESIDUAL)
        change = np.where(diverged, 0.0, moved - residual)
        slopes.append(change / offset[:, None])
    return slopes, [rows[count:] for rows in simulated]
