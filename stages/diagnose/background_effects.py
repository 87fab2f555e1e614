"""Everything may be a little wrong everywhere: what that leaves of evidence and
intervals.

A library's other effects are never exactly absent. So beside the causes of a hypothesis
every effect, its own included, may move the tip by a normal deviation of W0 [m], the
same in all trials, which the data tell (SuSiE-inf: Cui et al. 2024, Nature Genetics 56,
162: a sparse sum and many small effects). It is linear about a fit, so it costs no
further one.
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

# [m] of W0: more is not small
BACKGROUND_SCALES_M = DISCREPANCY_SCALES_M[DISCREPANCY_SCALES_M < 2e-3]
PROBE_FRACTION = 0.01  # of the way from absent to the end of a range: about linear


@dataclass(frozen=True)
class BackgroundPosterior:
    """A fit with every effect a little wrong. centre, covariance: of its exponents
    (P,), (P, P).
    """

    mean: np.ndarray
    covariance: np.ndarray

    @property
    def standard_deviation(self) -> np.ndarray:
        """(P,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> np.ndarray:
        """(P, P)."""
        return self.covariance / np.outer(
            self.standard_deviation, self.standard_deviation
        )


def background_responses(
    data: TrialData, fit: Fit, effects: Sequence[type[Effect]]
) -> list[np.ndarray]:
    """What each effect does in each trial when it moves the tip by 1 m, over sigma, (E,
    2 n); none of those that depend on place, which do nothing but where they touch.
    """
    found = [[np.zeros((0, 2 * len(trial.s))) for trial in data.trials]]
    for effect in effects:
        if is_position_dependent(effect) or effect in fit.hypothesis.causes:
            continue
        hypothesis = fit.hypothesis.with_cause(effect)
        start = hypothesis.exponents_from(fit.exponents)
        size = hypothesis.parameter_indices(effect, amplitude_parameters(effect))
        end = np.where(start[size] > 0.5, 0.0, 1.0)
        chi = np.repeat(start[None], len(size), axis=0)
        chi[range(len(size)), size] += PROBE_FRACTION * (end - start[size])
        moved = [
            each - own
            for each, own in zip(
                data.residuals(hypothesis.model, chi), fit.residuals, strict=True
            )
        ]
        found.append(_per_metre_at_tip(data, moved))
    for cause in fit.hypothesis.causes:
        size = fit.hypothesis.parameter_indices(cause, amplitude_parameters(cause))
        found.append(_per_metre_at_tip(data, [slope[size] for slope in fit.slopes]))
    return [np.concatenate(each) for each in zip(*found, strict=True)]


def _per_metre_at_tip(data: TrialData, moved: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Displacements (C, 2 n) of each trial as if they moved the tip by 1 m, of those
    that can be simulated.
    """
    sizes = data.overall_tip_rms(moved)
    lost = np.any(
        [np.abs(each).max(axis=1) > DIVERGED_RESIDUAL / 2 for each in moved], axis=0
    )
    seen = ~lost & (sizes > 0)
    return [each[seen] / sizes[seen, None] for each in moved]


def posterior_with_background(
    data: TrialData, fit: Fit, small: Sequence[np.ndarray]
) -> BackgroundPosterior:
    """A fit with what small effects, (E, 2 n) over sigma in each trial, leave of it."""
    products, along = (
        np.sum(each, axis=0) for each in _normal_equations_by_trial(data, fit, small)
    )
    own = len(fit.chi)
    told, steps, normals = zip(
        *(_solve_at_scale(products, along, own, size) for size in BACKGROUND_SCALES_M),
        strict=True,
    )
    evidence = np.array(told) + log_scale_prior()[: len(BACKGROUND_SCALES_M)]
    weight = np.exp(evidence - logsumexp(evidence))
    shift = np.array(steps)[:, :own]
    centre = weight @ shift
    apart = shift - centre
    spread = (
        np.tensordot(weight, np.linalg.inv(normals)[:, :own, :own], 1)
        + (weight * apart.T) @ apart
    )
    return BackgroundPosterior(fit.chi + centre, spread)


def background_log_evidence_gains(
    data: TrialData, fit: Fit, small: Sequence[np.ndarray], often: np.ndarray
) -> np.ndarray:
    """By how much small effects raise a fit's log evidence if each trial counts so
    often (D, K), (D,).
    """
    parts, along_parts = _normal_equations_by_trial(data, fit, small)
    products, along = np.tensordot(often, parts, 1), often @ along_parts
    said = np.array(
        [
            _solve_at_scale(products, along, len(fit.chi), size)[0]
            for size in BACKGROUND_SCALES_M
        ]
    )
    return np.asarray(
        logsumexp(said + log_scale_prior()[: len(BACKGROUND_SCALES_M), None], axis=0)
        - said[0]
    )


def _normal_equations_by_trial(
    data: TrialData, fit: Fit, small: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Products of what parameters and small effects do in each trial, white, (K, M, M),
    and with what is left, (K, M): the fit's parameters first.
    """
    data = data.for_hypothesis(fit.hypothesis)
    residual = data.whiten_by_trial([r[None] for r in fit.residuals], fit.scale_indices)
    parts = data.whiten_by_trial(
        [np.concatenate(pair) for pair in zip(fit.slopes, small, strict=True)],
        fit.scale_indices,
    )
    along = [part @ left[0] for part, left in zip(parts, residual, strict=True)]
    return np.array([part @ part.T for part in parts]), np.array(along)


def _solve_at_scale(
    products: np.ndarray, along: np.ndarray, own: int, size: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log evidence (...), step (..., M) and curvature (..., M, M) with small effects of
    a size [m], after the first `own` parameters. products: (..., M, M). along: (...,
    M).
    """
    rest = along.shape[-1] - own
    scale, prior = (
        np.repeat([1.0, size], [own, rest]),
        np.repeat([PRIOR_PRECISION, 1.0], [own, rest]),
    )
    normal, pull = products * np.outer(scale, scale) + np.diag(prior), scale * along
    step = -np.linalg.solve(normal, pull[..., None])[..., 0]
    return (
        -0.5 * np.sum(step * pull, axis=-1) - 0.5 * np.linalg.slogdet(normal)[1],
        step,
        normal,
    )
