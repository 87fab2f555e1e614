"""The error of the mesh in an estimate: what is known of it, and what trials show.

It is subtracted from the measured points (`inference.mesh_limit`). This begins at the
solution on a far finer mesh. From the solution on the mesh itself, the correction of a
soft string ends elsewhere: of string D, which bends over a segment, it left twice the
noise, or more than without a correction.

An error has a part that three meshes agree on. The rest has a known shape and an
unknown amplitude, about which the trial itself says most. Where a string whips, the
rest may be larger than all else that is left of a trial.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.inference.huber import huber_loss
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import EXTRAPOLATED_MESHES, refine_mesh
from stringcast.stages.inference.mesh_limit import refine_at_mesh_limit
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.search import refine_exponents
from stringcast.stages.inference.whitening import IndependentErrors

FINE_ITERATIONS = 3  # on the finest mesh: more move no correction's end


def solve_at_mesh_limit(
    on_mesh: Likelihood, chi: np.ndarray
) -> tuple[Likelihood, np.ndarray]:
    """Find the parameters (P,) of the string itself from those of it on its mesh.

    The solution stays as it is if the corrected one leaves more.

    Returns the likelihood of the corrected points and the exponents there.
    """
    finest = max(EXTRAPOLATED_MESHES)
    model, trials = refine_mesh(on_mesh.model, on_mesh.data.trials, finest)
    on_finest = replace(on_mesh.with_trials(trials), model=model)
    start = refine_exponents(on_finest, chi, FINE_ITERATIONS)

    at_limit, best = refine_at_mesh_limit(on_mesh, start)
    if at_limit is on_mesh:
        return on_mesh, chi
    same_noise = with_noise_of(at_limit, on_mesh)
    if mean_loss(same_noise, best) > mean_loss(on_mesh, chi):
        return on_mesh, chi
    return at_limit, best


def with_noise_of(likelihood: Likelihood, other: Likelihood) -> Likelihood:
    """Return a likelihood whose trials have the noise scales of those of another."""
    trials = []
    for trial, scale in zip(likelihood.data.trials, other.noise_scales, strict=True):
        errors = trial.error_model
        assert isinstance(errors, IndependentErrors)
        trials.append(replace(trial, error_model=replace(errors, scale=scale)))
    return likelihood.with_trials(trials)


def mean_loss(likelihood: Likelihood, chi: np.ndarray) -> float:
    """Compute the loss that least squares minimises, at exponents (P,)."""
    residual = likelihood.residuals(chi[None])
    return float(huber_loss(residual, likelihood.limit)[0])


def subtract_uncertain_error(
    at_limit: Likelihood, chi: np.ndarray
) -> list[PreparedTrial]:
    """Subtract the most likely uncertain error at exponents (P,) from measured points.

    at_limit: of `inference.mesh_limit`, whose points are without the certain error. The
    shape of the uncertain one is the last of each trial's nuisance.
    """
    trials = []
    residuals = at_limit.data.residuals(at_limit.model, chi[None])
    for trial, residual in zip(at_limit.data.trials, residuals, strict=True):
        errors = trial.error_model
        assert isinstance(errors, IndependentErrors)
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

    Before it, amplitudes are N(0, 1); noise is N(0, 1) as well.
    """
    precision = np.eye(shapes.shape[1]) + shapes.T @ shapes
    return np.linalg.solve(precision, shapes.T @ residual)
