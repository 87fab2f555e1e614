"""What trials can tell, before causes are sought in them: from which size on each
effect would be found, and which effects would be taken for one another.

Beside the base model, fitted to the trials, each effect is simulated from little to the
end of its range. What it moves that the string's parameters cannot imitate, to first
order, would have to be evident as a diagnosis asks it: by a Bayes factor above 1/alpha,
whichever trial is left out, where a smooth discrepancy of unknown size may explain it
as well (`stages.inference.discrepancy`). That is the mean for data with the noise that
these have.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.common import Progress
from stringcast.stages.diagnose.linearisation import LinearisedFit
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.inference.discrepancy import Discrepancy, marginal_log_likelihood
from stringcast.stages.inference.laplace import Fit, tip_shift_density
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import (
    Effect,
    amplitude_parameters,
    is_position_dependent,
)
from stringcast.stages.model.parameter import Parameter

# of the way from absent to the end of a range: each twice the last
RANGE_FRACTIONS = np.geomspace(1e-5, 1.0, 18)
# cosine between what two effects do, below which they are not taken for one another
MIN_CONFUSABLE_COSINE = 0.5
NOISE_DRAWS = 3  # of noise, each with its opposite
NEGLIGIBLE_RESPONSE = 1e-9  # [m] at the tip, or of noises: it does nothing


@dataclass(frozen=True)
class DetectionLimit:
    """What trials would say of one parameter that is an effect's size.

    absent: its value where the effect does nothing. found: the nearest value at which
    it would be found, and tip: how far that moves the string's tip, root mean square
    over all trials [m]; both NaN where no value of its range would be. most: how far
    the end of its range moves the tip [m]. imitated: share of what it does, in noises
    squared, that the string's parameters can imitate, and alike: names of effects for
    which it may be taken, both at the size found.
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
    """A parameter of an effect at some SHARES of its range. chi: its exponents (C,).
    tip: how far they move it [m], (C,). left: what the string's parameters leave of
    that, over sigma, of each trial (C, 2 n). white: the same, white, (C, N). imitated:
    share of it that they do not leave, (C,).
    """

    effect: type[Effect]
    parameter: Parameter
    absent_chi: float
    chi: np.ndarray
    tip_shifts_m: np.ndarray
    unimitated: list[np.ndarray]
    whitened: np.ndarray
    imitated_fractions: np.ndarray

    def index_near(self, tip: float) -> int:
        """The number at which it moves the tip about that far [m]."""
        return int(
            np.argmin(
                np.abs(np.log(np.maximum(self.tip_shifts_m, NEGLIGIBLE_RESPONSE) / tip))
            )
        )


def detection_limits(
    prepared: PreparedData,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    progress: Progress = lambda share: None,
) -> list[DetectionLimit]:
    """What prepared trials would say of each effect that acts wherever the string is,
    by name; none of those that cannot be simulated. criteria: what decides in a
    diagnosis. seed: of noise.
    """
    trials = _SensitivityAnalysis(
        prepared.data, prepared.base_fit, np.random.default_rng(seed)
    )
    anywhere = [effect for effect in effects if not is_position_dependent(effect)]
    acting: list[_EffectResponse] = []
    for number, effect in enumerate(anywhere, 1):
        acting += trials.effect_responses(effect)
        progress(number / len(anywhere))
    return [_detection_limit(trials, each, acting, criteria) for each in acting]


def _detection_limit(
    trials: _SensitivityAnalysis,
    own: _EffectResponse,
    acting: Sequence[_EffectResponse],
    criteria: Criteria,
) -> DetectionLimit:
    """What is said of one of them."""
    siblings = [
        each for each in acting if each.effect is own.effect and each is not own
    ]
    found, tip = _detection_threshold(
        own,
        trials.expected_log_evidence(own, siblings) - criteria.min_log_bayes_factor,
        criteria.min_tip_shift_m,
    )
    said = (
        own.effect,
        own.parameter,
        float(own.parameter.value(np.asarray(own.absent_chi))),
        found,
        tip,
        float(own.tip_shifts_m[-1]),
    )
    if np.isnan(found):
        return DetectionLimit(*said, float(own.imitated_fractions[-1]), ())
    others = {
        each.effect: [o for o in acting if o.effect is each.effect] for each in acting
    }
    rivals = [
        e.name
        for e, o in others.items()
        if e is not own.effect and trials.is_confusable(own, tip, o, criteria)
    ]
    return DetectionLimit(
        *said, float(own.imitated_fractions[own.index_near(tip)]), tuple(sorted(rivals))
    )


def _detection_threshold(
    own: _EffectResponse, evident: np.ndarray, least: float
) -> tuple[float, float]:
    """The value from which on it is evident (C,) and moves the tip by the least that
    counts [m], and how far it moves the tip there; NaN where it never does.
    """
    place = np.arange(len(evident), dtype=float)
    if evident[-1] < 0 or own.tip_shifts_m[-1] < least:
        return np.nan, np.nan
    # number that is not enough
    last = (
        int(
            np.flatnonzero(np.append(True, (evident < 0) | (own.tip_shifts_m < least)))[
                -1
            ]
        )
        - 1
    )
    if last < 0:
        return float(own.parameter.value(own.chi[0])), float(own.tip_shifts_m[0])
    rises = [
        (-evident[last], evident[last + 1] - evident[last]),
        (
            least - own.tip_shifts_m[last],
            own.tip_shifts_m[last + 1] - own.tip_shifts_m[last],
        ),
    ]
    at = last + max(np.clip(way / rise, 0.0, 1.0) for way, rise in rises if rise > 0)
    return float(own.parameter.value(np.interp(at, place, own.chi))), float(
        np.interp(at, place, own.tip_shifts_m)
    )


class _SensitivityAnalysis:
    """Trials at the base model's best, with noise and nothing lacking."""

    def __init__(self, data: TrialData, base: Fit, rng: np.random.Generator) -> None:
        self.data, self.base = (
            data,
            replace(base, scale_indices=np.zeros(len(data.trials), dtype=int)),
        )
        self.linear = LinearisedFit(data, self.base)
        self.noise = [
            _noise_coefficients(trial.discrepancy, rng) for trial in data.trials
        ]

    def effect_responses(self, effect: type[Effect]) -> Iterator[_EffectResponse]:
        """Each parameter that is an effect's size, at SHARES of its range; up to where
        it cannot be simulated.
        """
        hypothesis = self.base.hypothesis.with_cause(effect)
        start = hypothesis.exponents_from(self.base.exponents)
        for place, parameter in zip(
            hypothesis.parameter_indices(effect, amplitude_parameters(effect)),
            amplitude_parameters(effect),
            strict=True,
        ):
            chi = np.repeat(start[None], len(RANGE_FRACTIONS), axis=0)
            chi[:, place] += RANGE_FRACTIONS * (
                (0.0 if start[place] > 0.5 else 1.0) - start[place]
            )
            responses = self.linear.responses(hypothesis, chi)
            good = np.logical_and.accumulate(
                (responses[0] != DIVERGED_RESIDUAL).all(axis=1)
            )
            moved = [each[good] for each in responses]
            tip = self.data.overall_tip_rms(moved)
            if len(tip) and tip[-1] > NEGLIGIBLE_RESPONSE:
                yield _EffectResponse(
                    effect,
                    parameter,
                    start[place],
                    chi[good, place],
                    tip,
                    *self._unimitated_part(moved),
                )

    def _unimitated_part(
        self, moved: Sequence[np.ndarray]
    ) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """What the string's parameters leave of displacements, the same white, and the
        share that they do not.
        """
        step, left = self.linear.parameter_steps(moved)
        parts = [
            each + step @ slope
            for each, slope in zip(moved, self.base.slopes, strict=True)
        ]
        whole = np.maximum(
            np.sum((left - step @ self.linear.white_slopes) ** 2, axis=1),
            NEGLIGIBLE_RESPONSE**2,
        )
        return parts, left, 1.0 - np.minimum(np.sum(left**2, axis=1) / whole, 1.0)

    def expected_log_evidence(
        self, own: _EffectResponse, siblings: Sequence[_EffectResponse]
    ) -> np.ndarray:
        """Mean gain of the log evidence by an effect that is there, without the trial
        that says most, (C,). siblings: the effect's other components, which are not,
        and cost what they could explain of noise.
        """
        gains = self._expected_gains(own.unimitated)
        return np.asarray(
            gains.sum(axis=0)
            - gains.max(axis=0)
            + _log_prior_cost(own)
            + sum(_log_prior_cost(each)[0] for each in siblings)
        )

    def is_confusable(
        self,
        own: _EffectResponse,
        tip: float,
        theirs: Sequence[_EffectResponse],
        criteria: Criteria,
    ) -> bool:
        """Whether another effect, all of its components at the size that suits, is as
        likely as one that moves the tip that far [m]: outside a credible set it has no
        more than what that leaves.
        """
        here, there = own.index_near(tip), [each.index_near(tip) for each in theirs]
        others = np.array(
            [each.whitened[at] for each, at in zip(theirs, there, strict=True)]
        )
        size = np.linalg.lstsq(others.T, own.whitened[here], rcond=None)[0]
        if np.linalg.norm(size @ others) < MIN_CONFUSABLE_COSINE * np.linalg.norm(
            own.whitened[here]
        ):
            return False
        pairs = list(zip(size, theirs, there, strict=True))
        explained = [
            sum(s * each.unimitated[k][[at]] for s, each, at in pairs)
            for k in range(len(own.unimitated))
        ]
        apart = [
            part[[here]] - other
            for part, other in zip(own.unimitated, explained, strict=True)
        ]
        return bool(
            self._expected_gains(apart).sum()
            < np.log(criteria.coverage / (1 - criteria.coverage))
        )

    def _expected_gains(self, left: Sequence[np.ndarray]) -> np.ndarray:
        """Mean log-likelihood that each trial loses with displacements (C, 2 n) over
        sigma that nobody explains, (K, C).
        """
        found = []
        for trial, noise, part in zip(self.data.trials, self.noise, left, strict=True):
            told = trial.discrepancy
            seen = told.coefficients(part)[:, None] + noise
            likely = marginal_log_likelihood(
                told.log_likelihood_by_scale(seen.reshape(-1, seen.shape[-1]))
            ).reshape(seen.shape[:2])
            found.append(
                marginal_log_likelihood(told.log_likelihood_by_scale(noise)).mean()
                - likely.mean(axis=1)
            )
        return np.array(found)


def _log_prior_cost(own: _EffectResponse) -> np.ndarray:
    """Log evidence that an effect of these sizes has before the data speak of it, (C,);
    as of `stages.inference.laplace`.
    """
    # noises by one metre at the tip
    rise = (
        np.maximum(np.linalg.norm(own.whitened, axis=1), NEGLIGIBLE_RESPONSE)
        / own.tip_shifts_m
    )
    two_sided = own.parameter.low < own.parameter.start < own.parameter.high
    prior = np.maximum(
        tip_shift_density(own.tip_shifts_m, two_sided), np.finfo(float).tiny
    )
    return np.asarray(np.log(prior * np.sqrt(2 * np.pi) / rise))


def _noise_coefficients(told: Discrepancy, rng: np.random.Generator) -> np.ndarray:
    """Coefficients (2 DRAWS, 2 M) of a trial's noise and beginning, each draw with its
    opposite.
    """
    size, modes = told.nuisance_coefficients.shape
    drawn = (
        rng.standard_normal((NOISE_DRAWS, size))
        + rng.standard_normal((NOISE_DRAWS, modes)) @ told.nuisance_coefficients.T
    )
    return np.concatenate([drawn, -drawn])
