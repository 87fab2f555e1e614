"""The error of the mesh in trials, as far as an estimate knows it.

An error has a part that three meshes agree on. The rest has a known shape and an
unknown amplitude, about which the trial itself says most. Where a string whips, the
rest may be larger than all else that is left of a trial.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.whitening import IndependentErrors


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
