"""Compare residuals with the noise where the mesh resolves the string."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.stages.common import mean_square_over_trials, rms
from stringcast.stages.explain.comparer import SCREENING_ITERATIONS
from stringcast.stages.explain.comparison import MIN_EXPLAINED_FRACTION, NOISE_RATIO
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import (
    normalised_discretisation_errors,
    normalised_discretisation_uncertainties,
    resolved_frames,
    with_corrected_points,
)
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.solver import fit_least_squares
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.extension import extend_model
from stringcast.stages.model.model import Model

# Residual over noise up to which causes are named. Right causes give 1.00 to 1.05, two
# wrong ones in place of three 1.18 to 1.21.
MAX_NOISE_RATIO = 1.1
# Mesh error over noise up to which a string is resolved; a quarter may remain after
# correction
MAX_MESH_ERROR_RATIO = 1.0
CORRECTION_PASSES = 3


@dataclass(frozen=True)
class NoiseRatios:
    """Residuals over the noise where the mesh resolves the string; 1 for noise alone.

    Parameters
    ----------
    without_causes : ratio of the original model
    with_causes : ratio of the model with causes
    mesh_fraction : mean square mesh error over the mean square residual beyond noise,
        with causes and in whole trials
    """

    without_causes: float
    with_causes: float
    mesh_fraction: float = 0.0

    @property
    def leave_only_noise(self) -> bool:
        """Whether only noise is left."""
        return self.with_causes < MAX_NOISE_RATIO

    @property
    def explain_half(self) -> bool:
        """Whether the causes explain half of the mean square misfit."""
        square_ratio = (self.with_causes / self.without_causes) ** 2
        return square_ratio <= 1 - MIN_EXPLAINED_FRACTION

    @property
    def leave_only_mesh_error(self) -> bool:
        """Whether only noise and the error of the mesh are left."""
        return self.leave_only_noise and self.mesh_fraction >= MIN_EXPLAINED_FRACTION

    @property
    def explain_all(self) -> bool:
        """Whether the causes explain half of the misfit and leave only noise."""
        return self.leave_only_noise and self.explain_half


def compare_with_noise(
    model: Model, observations: Sequence[Observation], estimates: Sequence[Estimate]
) -> NoiseRatios:
    """Compare the residuals of estimates with the noise.

    The first estimate is without causes, the last with causes; they may be the same. A
    trial counts only until the mesh error of either exceeds the noise. Without causes,
    wrong parameters may end this early. So the larger residual counts for the last
    estimate: until then, or as long as it is resolved itself.
    """
    fits = [likelihood_at(model, observations, estimate) for estimate in estimates]
    counts = []  # resolved frames of each trial, (K,)
    errors = []  # mesh errors over sigma of each trial
    for (likelihood, chi), estimate in zip(fits, estimates, strict=True):
        errors = remaining_mesh_errors(likelihood, chi, estimate)
        trials = likelihood.data.trials
        counts.append(resolved_frames(trials, errors, MAX_MESH_ERROR_RATIO))
    common_counts = np.min(counts, axis=0)
    residuals = []
    for likelihood, chi in fits:
        residuals.append(first_frames_residual(likelihood, chi, common_counts))

    likelihood, chi = fits[-1]
    with_causes = residuals[-1]
    if (counts[-1] > common_counts).any():
        own_residual = first_frames_residual(likelihood, chi, counts[-1])
        with_causes = max(with_causes, own_residual)
    misfit = estimates[-1].residual_ratio ** 2 - NOISE_RATIO**2
    misfit = max(misfit, float(np.finfo(float).tiny))
    mesh_fraction = mean_square_over_trials(errors) / misfit
    return NoiseRatios(residuals[0], with_causes, mesh_fraction)


def remaining_mesh_errors(
    likelihood: Likelihood, chi: np.ndarray, estimate: Estimate
) -> list[np.ndarray]:
    """Compute the mesh error over sigma that an estimate leaves in each trial, (2 n,).

    If the estimate subtracted the error, only the part remains on which meshes
    disagree. NaN if a finer string diverges.

    Parameters
    ----------
    likelihood : Likelihood
        The trials and the mesh of the estimate.
    chi : numpy.ndarray, shape (P,)
        Exponents of the estimate.
    estimate : Estimate
        The estimate.
    """
    if estimate.mesh_error_m > 0:
        return normalised_discretisation_uncertainties(likelihood, chi)
    return normalised_discretisation_errors(likelihood, chi)


def first_frames_residual(
    likelihood: Likelihood, chi: np.ndarray, frames: np.ndarray
) -> float:
    """Compute the residual over sigma in the first `frames` (K,) of K trials."""
    pairs = zip(likelihood.data.trials, frames, strict=True)
    trials = [trial.first_frames(int(count)) for trial, count in pairs]
    return corrected_residual(likelihood.with_trials(trials), chi)


def likelihood_at(
    model: Model, observations: Sequence[Observation], estimate: Estimate
) -> tuple[Likelihood, np.ndarray]:
    """Return the likelihood of an estimate's model, and its exponents (P,)."""
    extended = extend_model(model, estimate.values())
    trials = [prepare_trial(extended, observation) for observation in observations]
    fitted = estimate.parameters.set_index("name")["chi"]
    chi = fitted.loc[list(extended.names)].to_numpy()
    return Likelihood(TrialData(tuple(trials)), extended), chi


def corrected_residual(likelihood: Likelihood, chi: np.ndarray) -> float:
    """Compute the residual over sigma without the error of the mesh.

    In turn, the error is subtracted and the parameters (P,), which compensated for it,
    are fitted again. The least residual counts, because with friction the mesh error is
    hardly known.
    """
    least = rms(likelihood.residuals(chi[None])[0])
    for _ in range(CORRECTION_PASSES):
        corrected = with_corrected_points(likelihood, chi)
        runs = fit_least_squares(corrected, chi[None], SCREENING_ITERATIONS)
        chi = runs.chi[0]
        least = min(least, rms(runs.residual[0]))
    return least
