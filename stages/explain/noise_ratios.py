"""What causes leave, compared with the noise where the mesh resolves the string."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.stages.common import rms
from stringcast.stages.explain.comparison import (
    MIN_EXPLAINED_FRACTION,
    SCREENING_ITERATIONS,
    noise_m,
    rms_m,
)
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import (
    discretisation_error,
    resolved_frames,
    with_corrected_points,
)
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.solver import fit_least_squares
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.extension import extend_model
from stringcast.stages.model.model import Model

# Of the residual to the noise, where causes are named: right ones leave 1.00 to 1.05,
# others, which stand in for two of three causes, 1.18 to 1.21
MAX_NOISE_RATIO = 1.1
# Of the error of the mesh to the noise. A quarter of it may be left after correction.
MAX_MESH_ERROR_RATIO = 1.0
CORRECTION_PASSES = 3


@dataclass(frozen=True)
class NoiseRatios:
    """Residuals over the noise where the mesh resolves the string; 1 for noise alone.

    Parameters
    ----------
    without : of the model as it was
    left : of the model with causes
    mesh_fraction : of the mean square that causes leave in whole trials beyond noise,
        as much as the error of the mesh has
    """

    without: float
    left: float
    mesh_fraction: float = 0.0

    @property
    def are_noise(self) -> bool:
        """Whether nothing but noise is left."""
        return self.left < MAX_NOISE_RATIO

    @property
    def explain_half(self) -> bool:
        """Whether the causes explain half of the mean square misfit."""
        return (self.left / self.without) ** 2 <= 1 - MIN_EXPLAINED_FRACTION

    @property
    def leave_mesh_error(self) -> bool:
        """Whether nothing but noise and the error of the mesh is left."""
        return self.are_noise and self.mesh_fraction >= MIN_EXPLAINED_FRACTION

    @property
    def explain_all(self) -> bool:
        """Whether the causes explain the misfit and leave nothing but noise."""
        return self.are_noise and self.explain_half


def compare_with_noise(
    model: Model, observations: Sequence[Observation], estimates: Sequence[Estimate]
) -> NoiseRatios:
    """Compare what estimates leave with the noise.

    The first estimate is of the model without causes, the last of that with causes.
    They may be the same. The end of a trial does not count if the mesh of one of them
    errs by more than the noise there. False parameters without causes may err so much
    that hardly anything counts. So nothing more may be left where the model with causes
    is resolved.
    """
    fits = [likelihood_at(model, observations, estimate) for estimate in estimates]
    counts = [resolved_frames(*fit, MAX_MESH_ERROR_RATIO) for fit in fits]
    where_both = np.min(counts, axis=0)  # frames of each trial
    residuals = [first_frames_residual(*fit, where_both) for fit in fits]
    left = residuals[-1]
    if (counts[-1] > where_both).any():
        left = max(left, first_frames_residual(*fits[-1], counts[-1]))
    share = mesh_fraction(*fits[-1], estimates[-1], observations)
    return NoiseRatios(residuals[0], left, share)


def mesh_fraction(
    likelihood: Likelihood,
    chi: np.ndarray,
    estimate: Estimate,
    observations: Sequence[Observation],
) -> float:
    """Compare the error of the mesh with what an estimate leaves beyond noise.

    Returns the ratio of mean squares; NaN where the finer string diverges, and 0 if the
    estimate has subtracted the error.
    """
    if estimate.mesh_error_m > 0:
        return 0.0
    misfit = rms_m(estimate) ** 2 - noise_m(observations) ** 2
    error = discretisation_error(likelihood, chi)
    return error**2 / max(misfit, float(np.finfo(float).tiny))


def first_frames_residual(
    likelihood: Likelihood, chi: np.ndarray, frames: np.ndarray
) -> float:
    """Compute the residual over sigma in the first frames (K,) of each trial."""
    pairs = zip(likelihood.data.trials, frames, strict=True)
    trials = [trial.first_frames(int(count)) for trial, count in pairs]
    return corrected_residual(likelihood.with_trials(trials), chi)


def likelihood_at(
    model: Model, observations: Sequence[Observation], estimate: Estimate
) -> tuple[Likelihood, np.ndarray]:
    """Return the likelihood of the model of an estimate, and its exponents (P,)."""
    extended = extend_model(model, estimate.values())
    trials = [prepare_trial(extended, observation) for observation in observations]
    fitted = estimate.parameters.set_index("name")["chi"]
    chi = fitted.loc[list(extended.names)].to_numpy()
    return Likelihood(TrialData(tuple(trials)), extended), chi


def corrected_residual(likelihood: Likelihood, chi: np.ndarray) -> float:
    """Compute the residual over sigma without the error of the mesh.

    That error is subtracted, and the parameters (P,), which compensated for it, are
    fitted again, in turn. The least residual counts: with friction the error of a
    string that is fitted well is hardly known.
    """
    least = rms(likelihood.residuals(chi[None])[0])
    for _ in range(CORRECTION_PASSES):
        corrected = with_corrected_points(likelihood, chi)
        runs = fit_least_squares(corrected, chi[None], SCREENING_ITERATIONS)
        chi = runs.chi[0]
        least = min(least, rms(runs.residual[0]))
    return least
