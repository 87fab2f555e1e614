"""Model hypotheses fitted to trials, and the evidence for each (Laplace's
approximation: MacKay 2003, chapter 27).

    ln p(y | h) = sum_k ln p(y_k | theta, h) + ln p(theta | h) + P/2 ln 2 pi - 1/2 ln
    |H|

y_k are the coefficients of trial k, with the size of its discrepancy integrated out
(`discrepancy`); H the curvature at the best theta. Before the data speak every exponent
in its range is equally likely, but for the size of a cause: of that it is how far it
moves the tip [m], half-normal of several widths. So a cause of whatever unit pays the
same for being there, and one that moves nothing is no worse than none.
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

# [m] by which a cause may well move the tip, each as likely
TIP_SHIFT_WIDTHS_M = np.array([1e-3, 3e-3, 1e-2, 3e-2])
# at most, in turns with the sizes of discrepancies: it mostly takes three
MAX_SCALE_ROUNDS = 6
SCREENING_ITERATIONS = 4  # iterations of several starts, before the best alone goes on
DISCREPANCY_DRAWS = 400  # of what may be lacking: a probability is told to 0.025
ABSENCE_TOLERANCE = 1e-9  # of a range: nearer than that is not there


@dataclass(frozen=True)
class Fit:
    """A hypothesis at its best. chi: (P,). residuals: over sigma, of each trial (2 n,);
    slopes: of them with chi, (P, 2 n). sizes: (K,) likeliest number of SIZES of each
    discrepancy. by_trial: (K,) log-likelihood of each trial, whatever that is.
    evidence: ln p(y | h).
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
        """Exponents by name."""
        return {
            p.name: float(chi)
            for p, chi in zip(self.hypothesis.parameters, self.chi, strict=True)
        }

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name."""
        return {
            p.name: float(p.value(chi))
            for p, chi in zip(self.hypothesis.parameters, self.chi, strict=True)
        }

    def cause_parameters(self, cause: type[Effect]) -> dict[str, float]:
        """A cause's parameters by their own names."""
        return {p.name: self.values[cause.qualified_name(p)] for p in cause.parameters}

    @property
    def diverged(self) -> bool:
        """Whether a trial could not be simulated."""
        return any((each == DIVERGED_RESIDUAL).any() for each in self.residuals)


def fit_hypothesis(
    data: TrialData,
    hypothesis: Hypothesis,
    starts: np.ndarray,
    sizes: np.ndarray,
    enough: float = solver.MIN_GAIN,
) -> Fit:
    """A hypothesis at its best from these starts (C, P), in turns with the sizes of the
    discrepancies, from (K,) on.

    enough: a step that gains less of the log-likelihood is the last of its turn.
    """
    return evaluate_fit(
        data, hypothesis, best_exponents(data, hypothesis, starts, sizes, enough)
    )


def best_exponents(
    data: TrialData,
    hypothesis: Hypothesis,
    starts: np.ndarray,
    sizes: np.ndarray,
    enough: float = solver.MIN_GAIN,
) -> np.ndarray:
    """Exponents (P,) of `fitted`."""
    data = data.for_hypothesis(hypothesis)
    first = solver.fit_least_squares(
        _likelihood_of(data, hypothesis, sizes), starts, SCREENING_ITERATIONS, enough
    )
    told = data.log_likelihood_by_scale(data.residuals(hypothesis.model, first.chi))
    best = int(np.argmax(marginal_log_likelihood(told).sum(axis=0)))
    chi, sizes = first.chi[best], best_scale_index(told[:, best])
    for _ in range(MAX_SCALE_ROUNDS - 1):
        chi = solver.fit_least_squares(
            _likelihood_of(data, hypothesis, sizes), chi[None], enough=enough
        ).chi[0]
        new = best_scale_index(
            data.log_likelihood_by_scale(data.residuals(hypothesis.model, chi[None]))[
                :, 0
            ]
        )
        if (new == sizes).all():
            break
        sizes = new
    return np.asarray(chi)


def evaluate_fit(data: TrialData, hypothesis: Hypothesis, chi: np.ndarray) -> Fit:
    """What a hypothesis says of the data where it is, exponents (P,)."""
    data = data.for_hypothesis(hypothesis)
    raw = [each[0] for each in data.residuals(hypothesis.model, chi[None])]
    told = data.log_likelihood_by_scale([each[None] for each in raw])[:, 0]
    sizes, by_trial = best_scale_index(told), marginal_log_likelihood(told)
    places = [
        place
        for cause in hypothesis.causes
        for place in hypothesis.parameter_indices(cause, amplitude_parameters(cause))
    ]
    # one size each
    absent = np.where(
        np.eye(len(chi), dtype=bool)[places], hypothesis.exponents_from({}), chi
    )
    slopes, without = _residual_slopes(data, hypothesis, chi, raw, sizes, absent)
    white = data.whiten(slopes, sizes)
    moved = [r - w for r, w in zip(raw, without, strict=True)]
    prior, bounded = _log_prior(data, hypothesis, chi, places, moved, slopes)
    normal = white @ white.T + np.diag(bounded)
    occam = 0.5 * (len(chi) * np.log(2 * np.pi) - np.linalg.slogdet(normal)[1])
    evidence = float(by_trial.sum() + prior + occam)
    return Fit(hypothesis, chi, tuple(raw), tuple(slopes), sizes, by_trial, evidence)


def mean_discrepancy(data: TrialData, fit: Fit) -> list[np.ndarray]:
    """Compute the most likely discrepancy of each trial, over sigma, (2 n,)."""
    means = []
    for trial, residual, size in zip(
        data.for_hypothesis(fit.hypothesis).trials,
        fit.residuals,
        fit.scale_indices,
        strict=True,
    ):
        coefficients = trial.discrepancy.coefficients(residual[None])[0]
        means.append(trial.discrepancy.posterior_mean(coefficients, int(size)))
    return means


def sample_discrepancy_tip_rms(
    data: TrialData, fit: Fit, rng: np.random.Generator
) -> np.ndarray:
    """Draw discrepancies as likely as the data leave them, and compute their root mean
    squares at each tip [m], (K, DRAWS).
    """
    data = data.for_hypothesis(fit.hypothesis)
    draws = []
    for trial, residual, size in zip(
        data.trials, fit.residuals, fit.scale_indices, strict=True
    ):
        coefficients = trial.discrepancy.coefficients(residual[None])[0]
        draws.append(
            trial.discrepancy.sample_posterior(
                coefficients, int(size), DISCREPANCY_DRAWS, rng
            )
        )
    return data.tip_rms_by_trial(draws)


def _likelihood_of(
    data: TrialData, hypothesis: Hypothesis, sizes: np.ndarray
) -> Likelihood:
    """The trials as a hypothesis explains them. sizes: (K,) of the discrepancies."""
    return Likelihood(
        data, hypothesis.model, sizes, uniform_indices=hypothesis.base_indices
    )


def _residual_slopes(
    data: TrialData,
    hypothesis: Hypothesis,
    chi: np.ndarray,
    raw: Sequence[np.ndarray],
    sizes: np.ndarray,
    more: np.ndarray,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Slopes (P, 2 n) of each trial's residuals (2 n,): forward differences as wide as
    the solver's. Beside them residuals at more exponents (A, P), (A, 2 n): lanes of a
    batch cost next to nothing.
    """
    width = np.full(len(chi), solver.FIRST_DIFFERENCE)
    for _ in range(2):  # the first differences say how wide the second should be
        offset = np.where(chi > 0.5, -width, width)
        found = data.residuals(
            hypothesis.model, np.concatenate([chi + np.diag(offset), more])
        )
        beside, others = zip(
            *((each[: len(chi)], each[len(chi) :]) for each in found), strict=True
        )
        pairs = zip(beside, raw, strict=True)
        slopes = [
            np.where((b == DIVERGED_RESIDUAL) | (r == DIVERGED_RESIDUAL), 0.0, b - r)
            / offset[:, None]
            for b, r in pairs
        ]
        width = solver.difference_widths(data.whiten(slopes, sizes)[None], np.ones(1))[
            0
        ]
    return slopes, list(others)


def _log_prior(
    data: TrialData,
    hypothesis: Hypothesis,
    chi: np.ndarray,
    places: Sequence[int],
    moved: Sequence[np.ndarray],
    slopes: Sequence[np.ndarray],
) -> tuple[float, np.ndarray]:
    """Log density of the causes' sizes at exponents (P,), and the curvature (P,) that
    stands for the ranges of all other parameters. places: of the causes' sizes, (A,).
    moved: what each of them does in each trial, (A, 2 n).
    """
    total, bounded = 0.0, np.full(len(chi), PRIOR_PRECISION)
    bounded[places] = ABSENCE_TOLERANCE
    far, by_slope = (
        np.abs(chi - hypothesis.exponents_from({}))[places],
        data.overall_tip_rms([slope[places] for slope in slopes]),
    )
    for place, off, moves, rise in zip(
        places, far, data.overall_tip_rms(moved), by_slope, strict=True
    ):
        size = hypothesis.parameters[place]
        there, per_chi = (
            (moves, moves / off) if off > ABSENCE_TOLERANCE else (0.0, rise)
        )
        density = (
            tip_shift_density(np.asarray(there), size.low < size.start < size.high)
            * per_chi
        )
        total += float(np.log(max(density, np.finfo(float).tiny)))
    return total, bounded


def tip_shift_density(moves: np.ndarray, two_sided: bool) -> np.ndarray:
    """Density, before the data speak, of how far a cause moves the tip [m], (...)
    [1/m]; to either side it is half.
    """
    each = (
        np.sqrt(2 / np.pi)
        / TIP_SHIFT_WIDTHS_M
        * np.exp(-0.5 * (moves[..., None] / TIP_SHIFT_WIDTHS_M) ** 2)
    )
    return np.asarray(each.mean(axis=-1) * (0.5 if two_sided else 1.0))
