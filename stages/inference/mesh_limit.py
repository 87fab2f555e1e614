"""Parameters without the bias of a coarse mesh.

In a slow trial the error of a mesh is systematic, and a fit attributes it to
parameters: in looks at strings A to D with 20 points, the bending stiffness was wrong
by 1 to 50 %, many times its standard error. So the error of the mesh at a solution is
subtracted from the measured points and the solution is refined, until the error
settles (deferred correction). The first error is computed at the solution on a far
finer mesh. From the solution on the given mesh, corrections of a soft string converge
to a worse one: string D, which bends over the length of a segment, kept twice the
noise.

Three meshes agree on a part of the error. The uncertain rest has a known shape and an
unknown amplitude, which is estimated from the trial. If the string whips, this rest may
be the largest part of the misfit.

References
----------
Stetter 1978, Numer. Math. 29, 425.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.inference.huber import huber_loss
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import (
    EXTRAPOLATED_MESHES,
    extrapolate_errors,
    likelihood_on_mesh,
)
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.search import (
    refine_exponents,
    with_refined_initial_states,
)
from stringcast.stages.inference.trial_data import ByTrial

FINE_ITERATIONS = 3  # on the finest mesh; more do not change the corrected solution
MAX_CORRECTIONS = 12  # three to nine are enough for strings that the mesh resolves
CORRECTION_ITERATIONS = 3  # for the parameters, between two corrections
# Number of corrections over which the change of the error must fall. Over one or two it
# may grow even if it settles later
COMPARED_CORRECTIONS = 3
MISFIT_RATIO = 1.5  # residual over sigma from which the residual is not noise alone
# Sum of squares of whitened residuals: a smaller change of the error moves no parameter
# by more than a standard error
SETTLED_CHANGE = 1.0


def refine_at_mesh_limit(
    likelihood: Likelihood, chi: np.ndarray, start: np.ndarray | None = None
) -> tuple[Likelihood, np.ndarray]:
    """Refine a solution (P,) as if the string had been fitted on a far finer mesh.

    The given solution is kept if the corrected one misfits more: no mesh resolves a
    string that whips, and the data may come from a chain of mass points. It is not kept
    if it leaves more than noise and the corrections settle: the mesh resolves the
    string, whose model is incomplete, and its error only happens to hide misfit.

    start: exponents (P,) from which the correction begins, if not from the solution.

    Returns the likelihood of the corrected points and its best exponents.
    """
    measured = [trial.points for trial in likelihood.data.trials]
    subtracted = [np.zeros_like(points) for points in measured]
    plain = corrected = likelihood  # without and with the uncertain error
    best = _refine_on_finest_mesh(likelihood, chi if start is None else start)
    changes: list[float] = []  # sum of squared changes of residuals, per correction
    for _ in range(MAX_CORRECTIONS):
        trials = plain.data.trials
        extrapolated, uncertainties = extrapolate_errors(plain.model, trials, best)
        # (n, 2) [m] of each trial; zero where a simulation diverges
        errors = [np.nan_to_num(error) for error in extrapolated]
        moved = []
        differences = []  # of residuals over sigma, (1, 2 n) of each trial
        for number, trial in enumerate(trials):
            moved.append(replace(trial, points=measured[number] - errors[number]))
            difference = (errors[number] - subtracted[number]) / trial.sigma[:, None]
            differences.append(difference.reshape(1, -1))
        subtracted = errors
        plain = plain.with_trials(moved)
        corrected = _with_uncertain_errors(plain, uncertainties)

        whitened = corrected.data.whiten(differences, np.zeros(len(trials), dtype=int))
        changes.append(float(np.sum(whitened**2)))
        is_growing = (
            len(changes) > COMPARED_CORRECTIONS
            and changes[-1] > changes[-1 - COMPARED_CORRECTIONS]
        )
        if changes[-1] < SETTLED_CHANGE or is_growing:
            break
        best = refine_exponents(corrected, best, CORRECTION_ITERATIONS)
        plain = with_refined_initial_states(plain, best)

    scales = likelihood.noise_scales
    loss = loss_at_noise(likelihood, chi, scales)
    is_better = loss_at_noise(corrected, best, scales) < loss
    is_settled = changes[-1] < SETTLED_CHANGE
    leaves_misfit = max(scales) > MISFIT_RATIO
    if is_better or (is_settled and leaves_misfit):
        return corrected, best
    return likelihood, chi


def loss_at_noise(
    likelihood: Likelihood, chi: np.ndarray, noise_scales: tuple[float, ...]
) -> float:
    """Compute the loss at exponents (P,) with a given noise scale for each trial."""
    trials = []
    for trial, scale in zip(likelihood.data.trials, noise_scales, strict=True):
        errors = replace(trial.independent_errors, scale=scale)
        trials.append(replace(trial, error_model=errors))
    residual = likelihood.with_trials(trials).residuals(chi[None])
    return float(huber_loss(residual, likelihood.limit)[0])


def subtract_uncertain_error(
    at_limit: Likelihood, chi: np.ndarray
) -> list[PreparedTrial]:
    """Subtract the most likely uncertain error at exponents (P,) from measured points.

    at_limit: the result of `refine_at_mesh_limit`. Its points are without the certain
    error; the shape of the uncertain one is the last column of each trial's nuisance.
    """
    trials = []
    residuals = at_limit.data.residuals(at_limit.model, chi[None])
    for trial, residual in zip(at_limit.data.trials, residuals, strict=True):
        errors = trial.independent_errors
        assert errors.nuisance is not None
        shapes = errors.nuisance  # over sigma, (2 n, M)
        scaled = residual[0] / errors.scale
        amplitudes = likely_amplitudes(shapes / errors.scale, scaled)
        uncertain = (amplitudes[-1] * shapes[:, -1]).reshape(-1, 2)  # over sigma
        points = trial.points + uncertain * trial.sigma[:, None]
        trials.append(replace(trial, points=points))
    return trials


def likely_amplitudes(shapes: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Find the most likely amplitudes (M,) of shapes (N, M) in a residual (N,).

    Prior amplitudes and noise are N(0, 1).
    """
    precision = np.eye(shapes.shape[1]) + shapes.T @ shapes
    return np.linalg.solve(precision, shapes.T @ residual)


def _refine_on_finest_mesh(likelihood: Likelihood, chi: np.ndarray) -> np.ndarray:
    """Refine exponents (P,) on the finest mesh from which errors are extrapolated."""
    on_finest = likelihood_on_mesh(likelihood, max(EXTRAPOLATED_MESHES))
    return refine_exponents(on_finest, chi, FINE_ITERATIONS)


def _with_uncertain_errors(
    likelihood: Likelihood, uncertainties: ByTrial
) -> Likelihood:
    """Add shapes of uncertain errors over sigma (2 n,) to the nuisance of trials."""
    trials = []
    for trial, uncertainty in zip(likelihood.data.trials, uncertainties, strict=True):
        shape = np.nan_to_num(uncertainty)[:, None]
        errors = trial.independent_errors.with_nuisance(shape)
        trials.append(replace(trial, error_model=errors))
    return likelihood.with_trials(trials)
