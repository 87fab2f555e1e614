"""Hypotheses fitted to trials, and the evidence for each by Laplace's approximation.

    ln p(y | h) = sum_k ln p(y_k | theta, h)      log likelihood of the trials
                + ln p(theta | h)                 log prior of the causes' amplitudes
                + P/2 ln 2 pi - 1/2 ln |H|        log volume of the posterior

y_k are the coefficients of trial k, with the scale of its discrepancy integrated out
(`discrepancy`); H is the curvature at the best theta. Before the data speak every
exponent in its range is equally likely, except the amplitude of a cause. The prior of
an amplitude is one of how far it moves the tip [m]: half-normal of several widths. So
causes of any unit are equally likely, and one that moves nothing is no worse than none.

References
----------
MacKay 2003, Information Theory, Inference, and Learning Algorithms, chapter 27.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.stages.inference import solver
from stringcast.stages.inference.discrepancy import (
    best_scale_index,
    marginal_log_likelihood,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import PRIOR_PRECISION, Likelihood
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect, amplitude_parameters
from stringcast.stages.model.parameter import Parameter

# Widths of the prior of how far a cause moves the tip [m], each as likely
TIP_SHIFT_WIDTHS_M = np.array([1e-3, 3e-3, 1e-2, 3e-2])
MAX_SCALE_ROUNDS = 6  # of parameters and scales in turn, at most; it mostly takes three
SCREENING_ITERATIONS = 4  # iterations of several starts, before the best alone goes on
DISCREPANCY_DRAWS = 400  # of a discrepancy: a probability is known to 0.025
ABSENCE_TOLERANCE = 1e-9  # of a range: an amplitude so near to its start is absent


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
    scale_indices
        The index of the most likely scale of each trial's discrepancy, (K,).
    log_likelihood_by_trial
        Log-likelihood of each trial, whatever that scale, (K,).
    log_evidence
        Ln p(y | h).
    """

    hypothesis: Hypothesis
    chi: np.ndarray
    residuals: tuple[np.ndarray, ...]
    slopes: tuple[np.ndarray, ...]
    scale_indices: np.ndarray
    log_likelihood_by_trial: np.ndarray
    log_evidence: float

    @property
    def exponents(self) -> dict[str, float]:
        """The exponents by parameter name."""
        return dict(zip(self.hypothesis.model.names, self.chi.tolist(), strict=True))

    @property
    def values(self) -> dict[str, float]:
        """The parameters' values by name."""
        pairs = zip(self.hypothesis.parameters, self.chi, strict=True)
        return {p.name: float(p.value(chi)) for p, chi in pairs}

    def cause_parameters(self, cause: type[Effect]) -> dict[str, float]:
        """Look up a cause's parameters by their own names."""
        values = self.values
        return {p.name: values[cause.qualified_name(p)] for p in cause.parameters}

    @property
    def diverged(self) -> bool:
        """Whether a trial could not be simulated."""
        return any((residual == DIVERGED_RESIDUAL).any() for residual in self.residuals)


def fit_hypothesis(
    data: TrialData,
    hypothesis: Hypothesis,
    starts: np.ndarray,
    sizes: np.ndarray,
    enough: float = solver.MIN_GAIN,
) -> Fit:
    """Fit a hypothesis: its parameters and the discrepancies' scales in turn.

    Parameters
    ----------
    starts
        Exponents, (C, P).
    sizes
        Indices of the scales to start with, (K,).
    enough
        A step that gains less of the log-likelihood ends its turn.
    """
    chi = best_exponents(data, hypothesis, starts, sizes, enough)
    return evaluate_fit(data, hypothesis, chi)


def best_exponents(
    data: TrialData,
    hypothesis: Hypothesis,
    starts: np.ndarray,
    sizes: np.ndarray,
    enough: float = solver.MIN_GAIN,
) -> np.ndarray:
    """Find the exponents (P,) of a fit. Parameters as of `fit_hypothesis`."""
    data, model = data.for_hypothesis(hypothesis), hypothesis.model

    def likelihood() -> Likelihood:
        return Likelihood(data, model, sizes, uniform_indices=hypothesis.base_indices)

    first = solver.fit_least_squares(likelihood(), starts, SCREENING_ITERATIONS, enough)
    # (K, C, S)
    by_scale = data.log_likelihood_by_scale(data.residuals(model, first.chi))
    best = int(np.argmax(marginal_log_likelihood(by_scale).sum(axis=0)))
    chi, sizes = first.chi[best], best_scale_index(by_scale[:, best])
    for _ in range(MAX_SCALE_ROUNDS - 1):
        chi = solver.fit_least_squares(likelihood(), chi[None], enough=enough).chi[0]
        residuals = data.residuals(model, chi[None])
        updated = best_scale_index(data.log_likelihood_by_scale(residuals)[:, 0])
        if (updated == sizes).all():
            break
        sizes = updated
    return np.asarray(chi)


def evaluate_fit(data: TrialData, hypothesis: Hypothesis, chi: np.ndarray) -> Fit:
    """Evaluate a hypothesis and its log evidence at exponents (P,)."""
    data = data.for_hypothesis(hypothesis)
    rows = data.residuals(hypothesis.model, chi[None])
    by_scale = data.log_likelihood_by_scale(rows)[:, 0]
    sizes, by_trial = best_scale_index(by_scale), marginal_log_likelihood(by_scale)
    residuals = [row[0] for row in rows]

    amplitudes: list[int] = []
    for cause in hypothesis.causes:
        amplitudes += hypothesis.parameter_indices(cause, amplitude_parameters(cause))
    start = hypothesis.exponents_from({})
    without_one = np.where(np.eye(len(chi), dtype=bool)[amplitudes], start, chi)
    slopes, others = _residual_slopes(
        data, hypothesis, chi, residuals, sizes, without_one
    )

    shifts = [r - other for r, other in zip(residuals, others, strict=True)]
    tip_shifts = data.overall_tip_rms(shifts)
    tip_slopes = data.overall_tip_rms([slope[amplitudes] for slope in slopes])
    prior = 0.0
    for number, index in enumerate(amplitudes):
        distance = abs(chi[index] - start[index])
        shift, slope = tip_shifts[number], tip_slopes[number]
        prior += log_prior(hypothesis.parameters[index], distance, shift, slope)

    precision = np.full(len(chi), PRIOR_PRECISION)
    precision[amplitudes] = ABSENCE_TOLERANCE
    white = data.whiten(slopes, sizes)
    volume = log_volume(white @ white.T + np.diag(precision))
    evidence = float(by_trial.sum() + prior + volume)
    return Fit(
        hypothesis, chi, tuple(residuals), tuple(slopes), sizes, by_trial, evidence
    )


def log_prior(
    amplitude: Parameter, distance: float, tip_shift: float, tip_slope: float
) -> float:
    """Compute the log density of a cause's amplitude in its exponent.

    It is the density of how far the tip moves, times how far it moves by the exponent.

    Parameters
    ----------
    distance
        Of the exponent from where the cause is absent.
    tip_shift
        How far the cause moves the tip [m].
    tip_slope
        The same by the exponent, where it is absent [m].
    """
    two_sided = amplitude.low < amplitude.start < amplitude.high
    shift, slope = 0.0, tip_slope
    if distance > ABSENCE_TOLERANCE:
        shift, slope = tip_shift, tip_shift / distance
    density = float(tip_shift_density(np.asarray(shift), two_sided) * slope)
    return float(np.log(max(density, np.finfo(float).tiny)))


def tip_shift_density(moves: np.ndarray, two_sided: bool) -> np.ndarray:
    """Compute the prior density [1/m] of how far a cause moves the tip (...) [m].

    Of a cause that can have either sign it is half to either side.
    """
    normal = np.exp(-0.5 * (moves[..., None] / TIP_SHIFT_WIDTHS_M) ** 2)
    density = np.sqrt(2 / np.pi) / TIP_SHIFT_WIDTHS_M * normal
    return np.asarray(density.mean(axis=-1) * (0.5 if two_sided else 1.0))


def log_volume(curvature: np.ndarray) -> float:
    """Compute the log volume of a normal posterior of this curvature (P, P)."""
    log_determinant = np.linalg.slogdet(curvature)[1]
    return float(0.5 * (len(curvature) * np.log(2 * np.pi) - log_determinant))


def mean_discrepancy(data: TrialData, fit: Fit) -> list[np.ndarray]:
    """Compute the most likely discrepancy of each trial, over sigma, (2 n,)."""
    trials = data.for_hypothesis(fit.hypothesis).trials
    means = []
    for trial, residual, size in zip(
        trials, fit.residuals, fit.scale_indices, strict=True
    ):
        coefficients = trial.discrepancy.coefficients(residual[None])[0]
        means.append(trial.discrepancy.posterior_mean(coefficients, int(size)))
    return means


def sample_discrepancy_tip_rms(
    data: TrialData, fit: Fit, rng: np.random.Generator
) -> np.ndarray:
    """Draw discrepancies given the data, and compute their size at each tip.

    Returns root mean squares [m], (K, DISCREPANCY_DRAWS).
    """
    data = data.for_hypothesis(fit.hypothesis)
    draws = []
    for number, trial in enumerate(data.trials):
        residual, size = fit.residuals[number], int(fit.scale_indices[number])
        coefficients = trial.discrepancy.coefficients(residual[None])[0]
        sample = trial.discrepancy.sample_posterior
        draws.append(sample(coefficients, size, DISCREPANCY_DRAWS, rng))
    return data.tip_rms_by_trial(draws)


def _residual_slopes(
    data: TrialData,
    hypothesis: Hypothesis,
    chi: np.ndarray,
    residuals: Sequence[np.ndarray],
    sizes: np.ndarray,
    more: np.ndarray,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Difference each trial's residuals (2 n,) by the exponents (P,).

    Returns slopes (P, 2 n), and residuals (A, 2 n) at more exponents (A, P): further
    lanes of a batch cost little.
    """
    width = np.full(len(chi), solver.FIRST_DIFFERENCE)
    for _ in range(2):  # the first differences say how wide the second should be
        offset = np.where(chi > 0.5, -width, width)
        points = np.concatenate([chi + np.diag(offset), more])
        slopes, others = [], []
        simulated = data.residuals(hypothesis.model, points)
        for rows, residual in zip(simulated, residuals, strict=True):
            moved = rows[: len(chi)]
            lost = (moved == DIVERGED_RESIDUAL) | (residual == DIVERGED_RESIDUAL)
            slopes.append(np.where(lost, 0.0, moved - residual) / offset[:, None])
            others.append(rows[len(chi) :])
        white = data.whiten(slopes, sizes)[None]
        width = solver.difference_widths(white, np.ones(1))[0]
    return slopes, others
