"""Detection limits: the least size at which trials would show each effect.

Starting from the base model fitted to the trials, each effect is simulated from a small
size to the end of its range. The part of its displacement that the string's parameters
cannot imitate, to first order, must be evident by the rule of a diagnosis: a Bayes
factor above 1/alpha without any one trial, in competition with a smooth discrepancy of
unknown scale. The evidence is the mean for data with the noise of these trials. Effects
that would explain the same displacement are its look-alikes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.common import Progress
from stringcast.stages.diagnose.evidence.linearisation import LinearisedFit
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.inference.discrepancy import Discrepancy
from stringcast.stages.inference.discrepancy_grid import marginal_log_likelihood
from stringcast.stages.inference.laplace import (
    Fit,
    log_size_density,
    tip_shift_density,
)
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import ByTrial, TrialData
from stringcast.stages.model.effect import (
    Effect,
    amplitude_parameters,
    is_position_dependent,
)
from stringcast.stages.model.parameter import Parameter

# Sizes of an effect as fractions of its range, with a ratio of about two
RANGE_FRACTIONS = np.geomspace(1e-5, 1.0, 18)
MIN_CONFUSABLE_COSINE = 0.5  # between the responses to two effects
NOISE_DRAWS = 3  # each is also used with the opposite sign
NEGLIGIBLE_RESPONSE = 1e-9  # [m] at the tip, or in standard deviations


@dataclass(frozen=True)
class DetectionLimit:
    """The least amplitude of an effect that trials would show.

    Attributes
    ----------
    absent_value : float
        The value at which the effect does nothing.
    detectable_value, detectable_tip_shift_m : float
        The nearest value that would be found, and its tip shift, root mean square over
        all trials [m]; both NaN if no value of the range would be found.
    max_tip_shift_m : float
        Tip shift at the end of the range [m].
    imitated_fraction : float
        Fraction of the squared white response that the string's parameters imitate.
    lookalikes : tuple of str
        Effects with which it may be confused at the detectable value.
    """

    effect: type[Effect]
    parameter: Parameter
    absent_value: float
    detectable_value: float
    detectable_tip_shift_m: float
    max_tip_shift_m: float
    imitated_fraction: float
    lookalikes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _EffectResponse:
    """Response of trials to an amplitude, at some fractions of its range.

    Attributes
    ----------
    chi, tip_shifts_m, imitated_fractions : numpy.ndarray, shape (C,)
    unimitated : list of numpy.ndarray, shape (C, 2 n)
        Displacements of each trial over sigma that the string's parameters cannot
        imitate.
    whitened : numpy.ndarray, shape (C, N)
        The same after whitening.
    """

    effect: type[Effect]
    parameter: Parameter
    absent_chi: float
    chi: np.ndarray
    tip_shifts_m: np.ndarray
    unimitated: list[np.ndarray]
    whitened: np.ndarray
    imitated_fractions: np.ndarray

    def index_near(self, tip_shift_m: float) -> int:
        """Find the index of the fraction with about a given tip shift [m]."""
        shifts_m = np.maximum(self.tip_shifts_m, NEGLIGIBLE_RESPONSE)
        return int(np.argmin(np.abs(np.log(shifts_m / tip_shift_m))))


def detection_limits(
    prepared: PreparedData,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    progress: Progress = lambda share: None,
) -> list[DetectionLimit]:
    """Compute the detection limit of each effect that does not depend on place.

    Effects whose simulation diverges are left out.

    Parameters
    ----------
    criteria : Criteria
        Criteria of the diagnosis.
    seed : int
        Seed of the noise.
    """
    rng = np.random.default_rng(seed)
    analysis = _SensitivityAnalysis(prepared.data, prepared.base_fit, rng)
    everywhere = [effect for effect in effects if not is_position_dependent(effect)]
    by_effect: dict[type[Effect], list[_EffectResponse]] = defaultdict(list)
    for number, effect in enumerate(everywhere, 1):
        for response in analysis.effect_responses(effect):
            by_effect[effect].append(response)
        progress(number / len(everywhere))
    limits = []
    for responses in by_effect.values():
        for response in responses:
            limits.append(_detection_limit(analysis, response, by_effect, criteria))
    return limits


def _detection_limit(
    analysis: _SensitivityAnalysis,
    response: _EffectResponse,
    by_effect: dict[type[Effect], list[_EffectResponse]],
    criteria: Criteria,
) -> DetectionLimit:
    siblings = [r for r in by_effect[response.effect] if r is not response]
    log_evidence = analysis.expected_log_evidence(response, siblings)
    excess = log_evidence - criteria.min_log_bayes_factor
    value, shift_m = _detection_threshold(response, excess, criteria.tip_tolerance_m)
    index = -1
    lookalikes = list[str]()
    if not np.isnan(value):
        index = response.index_near(shift_m)
        for effect, others in by_effect.items():
            if effect is not response.effect and analysis.is_confusable(
                response,
                shift_m,
                others,
                criteria,
            ):
                lookalikes.append(effect.name)
    parameter = response.parameter
    return DetectionLimit(
        effect=response.effect,
        parameter=parameter,
        absent_value=float(parameter.value(np.asarray(response.absent_chi))),
        detectable_value=value,
        detectable_tip_shift_m=shift_m,
        max_tip_shift_m=float(response.tip_shifts_m[-1]),
        imitated_fraction=float(response.imitated_fractions[index]),
        lookalikes=tuple(sorted(lookalikes)),
    )


def _detection_threshold(
    response: _EffectResponse,
    excess: np.ndarray,
    min_tip_shift_m: float,
) -> tuple[float, float]:
    """Interpolate the size from which both evidence and tip shift are sufficient.

    Parameters
    ----------
    excess : numpy.ndarray, shape (C,)
        Log evidence above the required one.

    Returns
    -------
    value, tip_shift_m : float
        NaN if they are never sufficient.
    """
    shifts_m = response.tip_shifts_m
    is_insufficient = (excess < 0) | (shifts_m < min_tip_shift_m)
    if is_insufficient[-1]:
        return np.nan, np.nan
    position = 0.0  # among the fractions of the range
    if is_insufficient.any():
        last = int(np.flatnonzero(is_insufficient)[-1])
        position = float(last)
        for values, needed in ((excess, 0.0), (shifts_m, min_tip_shift_m)):
            rise = values[last + 1] - values[last]
            if rise > 0:
                share = (needed - values[last]) / rise
                crossing = last + np.clip(share, 0.0, 1.0)
                position = max(position, float(crossing))
    positions = np.arange(len(shifts_m), dtype=float)
    chi = np.interp(position, positions, response.chi)
    value = response.parameter.value(chi)
    return float(value), float(np.interp(position, positions, shifts_m))


class _SensitivityAnalysis:
    """Trials at the base model's optimum, with noise and no discrepancy."""

    def __init__(self, data: TrialData, base: Fit, rng: np.random.Generator) -> None:
        no_discrepancy = np.zeros(len(data.trials), dtype=int)
        self.data = data
        self.base = replace(base, grid_points=no_discrepancy)
        self.linear = LinearisedFit(data, self.base)
        self.noise = [_noise_coefficients(t.discrepancy, rng) for t in data.trials]

    def effect_responses(self, effect: type[Effect]) -> list[_EffectResponse]:
        """Simulate each amplitude of an effect, up to the first that diverges."""
        hypothesis = self.base.hypothesis.with_cause(effect)
        start = hypothesis.exponents_from(self.base.exponents)
        parameters = amplitude_parameters(effect)
        responses = []
        indices = hypothesis.parameter_indices(effect, parameters)
        for index, parameter in zip(indices, parameters, strict=True):
            absent = start[index]
            end = 0.0 if absent > 0.5 else 1.0
            chi = np.repeat(start[None], len(RANGE_FRACTIONS), axis=0)
            chi[:, index] += RANGE_FRACTIONS * (end - absent)
            changes = self.linear.responses(hypothesis, chi)
            is_finite = (changes[0] != DIVERGED_RESIDUAL).all(axis=1)
            kept = np.logical_and.accumulate(is_finite)
            changes = [change[kept] for change in changes]
            shifts_m = self.data.overall_tip_rms(changes)
            if not len(shifts_m) or shifts_m[-1] <= NEGLIGIBLE_RESPONSE:
                continue

            steps, remainder = self.linear.parameter_steps(changes)
            white_changes = remainder - steps @ self.linear.white_slopes
            square = np.sum(white_changes**2, axis=1)
            square = np.maximum(square, NEGLIGIBLE_RESPONSE**2)
            unimitated = np.minimum(np.sum(remainder**2, axis=1) / square, 1.0)
            pairs = zip(changes, self.base.slopes, strict=True)
            response = _EffectResponse(
                effect,
                parameter,
                absent_chi=absent,
                chi=chi[kept, index],
                tip_shifts_m=shifts_m,
                unimitated=[change + steps @ slope for change, slope in pairs],
                whitened=remainder,
                imitated_fractions=1.0 - unimitated,
            )
            responses.append(response)
        return responses

    def expected_log_evidence(
        self,
        response: _EffectResponse,
        siblings: Sequence[_EffectResponse],
    ) -> np.ndarray:
        """Mean log evidence for an active effect without the strongest trial, (C,).

        Its other amplitudes are zero but have their Occam factors.
        """
        gains = self._expected_gains(response.unimitated)
        left_one_out = gains.sum(axis=0) - gains.max(axis=0)
        sibling_factor = sum(_log_occam_factor(sibling)[0] for sibling in siblings)
        relative_sizes = response.parameter.relative_size(response.chi)[:, None]
        log_prior = log_size_density(relative_sizes) + _log_occam_factor(response)
        log_prior = log_prior + sibling_factor
        return np.asarray(left_one_out + log_prior)

    def is_confusable(
        self,
        response: _EffectResponse,
        tip_shift_m: float,
        others: Sequence[_EffectResponse],
        criteria: Criteria,
    ) -> bool:
        """Return whether another effect explains a response about as well.

        Its amplitudes are fitted. It is confusable if it would be in the credible set.
        """
        index = response.index_near(tip_shift_m)
        white = response.whitened[index]
        indices = [other.index_near(tip_shift_m) for other in others]
        pairs = list(zip(others, indices, strict=True))
        other_white = np.array([other.whitened[i] for other, i in pairs])
        factors = np.linalg.lstsq(other_white.T, white, rcond=None)[0]
        explained_norm = np.linalg.norm(factors @ other_white)
        if explained_norm < MIN_CONFUSABLE_COSINE * np.linalg.norm(white):
            return False
        differences = []
        for k, displacement in enumerate(response.unimitated):
            explained = np.zeros(displacement.shape[1])
            for factor, (other, i) in zip(factors, pairs, strict=True):
                explained = explained + factor * other.unimitated[k][i]
            differences.append((displacement[index] - explained)[None])
        lost = self._expected_gains(differences).sum()
        return bool(lost < criteria.deciding_log_odds)

    def _expected_gains(self, displacements: ByTrial) -> np.ndarray:
        """Mean log-likelihood gained by explaining displacements (C, 2 n), (K, C)."""
        gains = []
        for k, trial in enumerate(self.data.trials):
            noise = self.noise[k]
            explained = _log_likelihood(trial.discrepancy, noise)
            coefficients = trial.discrepancy.coefficients(displacements[k])
            displaced = coefficients[:, None] + noise  # (C, draws, 2 M)
            flat = displaced.reshape(-1, displaced.shape[-1])
            unexplained = _log_likelihood(trial.discrepancy, flat)
            by_draw = unexplained.reshape(displaced.shape[:2])
            gains.append(explained.mean() - by_draw.mean(axis=1))
        return np.array(gains)


def _log_likelihood(discrepancy: Discrepancy, coefficients: np.ndarray) -> np.ndarray:
    by_grid_point = discrepancy.log_likelihood_by_grid_point(coefficients)
    return marginal_log_likelihood(by_grid_point)


def _log_occam_factor(response: _EffectResponse) -> np.ndarray:
    """Log of prior density times posterior width of an amplitude, (C,)."""
    norm = np.maximum(np.linalg.norm(response.whitened, axis=1), NEGLIGIBLE_RESPONSE)
    sigmas_per_metre = norm / response.tip_shifts_m
    density = tip_shift_density(response.tip_shifts_m, response.parameter)
    density = np.maximum(density, np.finfo(float).tiny)
    return np.asarray(np.log(density * np.sqrt(2 * np.pi) / sigmas_per_metre))


def _noise_coefficients(
    discrepancy: Discrepancy,
    rng: np.random.Generator,
) -> np.ndarray:
    """Draw coefficients (2 NOISE_DRAWS, 2 M) of a trial's noise and initial state."""
    size, modes = discrepancy.nuisance_coefficients.shape
    noise = rng.standard_normal((NOISE_DRAWS, size))
    amplitudes = rng.standard_normal((NOISE_DRAWS, modes))
    noise = noise + amplitudes @ discrepancy.nuisance_coefficients.T
    return np.concatenate([noise, -noise])
