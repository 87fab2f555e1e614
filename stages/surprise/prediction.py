"""Predict the tip in a trial from the estimate before it.

The hand moves as the joints report, so that an arm that does not follow its commands is
no surprise. If the hand were uncertain, the test would detect little.
"""

from __future__ import annotations

import numpy as np

from stringcast.data.artifacts import Motion
from stringcast.data.estimates import Estimate
from stringcast.stages.generate.curves import curves_from_motion
from stringcast.stages.generate.hit_probability import tip_errors
from stringcast.stages.generate.repeated_misfit import find_repeated_misfit
from stringcast.stages.inference.likelihood import BLOCK_S
from stringcast.stages.inference.mesh import (
    EXTRAPOLATED_MESHES,
    extrapolate_error,
    refine_mesh,
)
from stringcast.stages.inference.prepared_trial import PreparedTrial

# Error of the tip, one sigma of a coordinate: time-correlated errors of film and mesh
# bias the parameters by more than their posterior spread. Measured: see
# stages/explain/README.md
SLOW_ERROR_M = 5e-4


def predict_tips(
    trial: PreparedTrial,
    motion: Motion,
    last_motion: Motion | None,
    estimate: Estimate,
    rng: np.random.Generator,
) -> np.ndarray:
    """Predict the tip at a trial's frames under draws of an estimate, (K, F, 2) [m].

    Draws whose simulation diverges are omitted.

    Parameters
    ----------
    trial : PreparedTrial
        The trial; only the motion of its joints is used.
    motion : Motion
        The planned motion.
    last_motion : Motion or None
        The cast before.
    estimate : Estimate
        The estimate from earlier trials.
    rng : numpy.random.Generator
        Source of randomness.
    """
    model = trial.model
    draws = estimate.draws.to_dict("records")
    values = np.stack([model.values(draw) for draw in draws])
    best = model.values(estimate.values())[None]
    tips = _simulate_tips(trial, values)
    tips = tips[np.isfinite(tips).all(axis=(1, 2))]

    mesh_error, uncertain_error = _extrapolate_mesh_error(trial, best)
    if estimate.mesh_error_m > 0:
        tips -= mesh_error
    else:
        # the parameters compensate an unknown part of the mesh error
        uncertain_error = mesh_error
    tips += rng.standard_normal((len(tips), 1, 1)) * uncertain_error
    for coordinate in range(2):
        slow_noise = draw_slow_noise(rng, len(tips), trial.times)
        tips[..., coordinate] += SLOW_ERROR_M * slow_noise

    misfit = find_repeated_misfit(model.arm, model.string.length, last_motion, estimate)
    if misfit is not None:
        misfit = misfit.without_mesh_error(estimate)
    # variance of the residual without the noise of the points
    noise = np.median(trial.sigma)
    variance = max(estimate.model_error_m**2 / 2 - noise**2, 0.0)
    normal = rng.standard_normal((len(tips), 2))
    curves = curves_from_motion(motion)
    errors = tip_errors(misfit, curves, float(np.sqrt(variance)), normal)
    ticks = np.round(trial.times / model.arm.tick).astype(int)
    tips += errors[:, np.clip(ticks, 0, errors.shape[1] - 1)]

    # the last misfit contains measurement noise
    if misfit is not None:
        correlation = misfit.correlation(curves, float(curves.duration.max()))[0]
        sigma = noise * correlation[np.clip(ticks, 0, len(correlation) - 1)]
        tips += sigma[:, None] * rng.standard_normal(tips.shape)
    return np.asarray(tips)


def draw_slow_noise(
    rng: np.random.Generator, count: int, times: np.ndarray
) -> np.ndarray:
    """Draw normal noise of variance 1 at times (F,) [s], (count, F).

    Its correlation decays over a block of time, like model error
    (`stages.estimate.posterior`).
    """
    noise = rng.standard_normal((count, len(times)))
    kept = np.exp(-np.diff(times) / BLOCK_S)
    for frame, share in enumerate(kept):
        fresh = np.sqrt(1 - share**2) * noise[:, frame + 1]
        noise[:, frame + 1] = share * noise[:, frame] + fresh
    return noise


def _extrapolate_mesh_error(
    trial: PreparedTrial, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Extrapolate the mesh error of the tip at values (1, P), (1, F, 2) [m].

    Also returns its uncertainty. Both are 0 where a simulation diverges.
    """
    tips = []
    for factor in EXTRAPOLATED_MESHES:
        _, refined = refine_mesh(trial.model, [trial], factor)
        tips.append(_simulate_tips(refined[0], values))
    error, uncertainty = extrapolate_error(*tips)
    return np.nan_to_num(-error), np.nan_to_num(uncertainty)


def _simulate_tips(trial: PreparedTrial, values: np.ndarray) -> np.ndarray:
    """Simulate the tip of candidates (C, P) at the frames, (C, F, 2) [m]."""
    tips = [motion.points[:, :, -1] for _, motion in trial.simulate(values)]
    return np.concatenate(tips)
