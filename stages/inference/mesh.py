"""The ladder of meshes, and how far one is from its limit.

Each mesh has half as many segments as the last and steps twice as long. A coarser
string costs a quarter and is good enough to rank starts: of 24 sets of casts all end in
the same minimum, searched with 20 points or with 11. Parameters are the material's, so
that they mean the same on every mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.inference.batch import measured_points
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.prepared_trial import PreparedTrial, with_model
from stringcast.stages.model.engine.accuracy import richardson_limit
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values

MIN_SEGMENTS = 10  # segments: with fewer the string's second bend is lost
# times finer stands for the limit: of second order, 1/16 of the error is left
REFERENCE_REFINEMENT = 4
EXTRAPOLATED_MESHES = (1, 2, 4)  # times as many segments


def mesh_ladder(likelihood: Likelihood) -> list[Likelihood]:
    """List the same trials on coarser and coarser meshes, the given one first."""
    ladder = [likelihood]
    while ladder[-1].model.string.points - 1 >= 2 * MIN_SEGMENTS - 1:
        ladder.append(likelihood_on_mesh(likelihood, 0.5 ** len(ladder)))
    return ladder


def discretisation_error(likelihood: Likelihood, chi: np.ndarray) -> float:
    """Compute how far the string of parameters (P,) is from one of a far finer mesh.

    Returns the root mean square at the measured points [m]; NaN where that diverges.
    """
    errors = np.concatenate(_errors_by_trial(likelihood, chi))
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))


def with_corrected_points(likelihood: Likelihood, chi: np.ndarray) -> Likelihood:
    """Subtract the discretisation error at parameters (P,) from the measured points.

    Simulations of nearby parameters on this mesh are then compared as on a far finer
    one (deferred correction).
    """
    trials = []
    errors = _errors_by_trial(likelihood, chi)
    for trial, error in zip(likelihood.data.trials, errors, strict=True):
        trials.append(replace(trial, points=trial.points + np.nan_to_num(error)))
    return likelihood.with_trials(tuple(trials))


def resolved_frames(
    likelihood: Likelihood, chi: np.ndarray, max_error: float
) -> np.ndarray:
    """Count the frames of each trial until its discretisation error is large, (K,).

    Where a string whips, the error grows until no mesh shows what the string does. Two
    frames count in any case.

    Parameters
    ----------
    likelihood
        The trials and their mesh.
    chi
        Exponents of the parameters, (P,).
    max_error
        Of the points of a frame, root mean square of a coordinate over its sigma.
    """
    counts = []
    errors = _errors_by_trial(likelihood, chi)
    for trial, error in zip(likelihood.data.trials, errors, strict=True):
        squares = np.mean((error / trial.sigma[:, None]) ** 2, axis=1)  # (n,)
        sums = np.bincount(trial.frame, squares)
        is_resolved = sums <= max_error**2 * np.bincount(trial.frame)
        is_large = np.append(~is_resolved, True)  # also where it diverges
        counts.append(max(int(np.argmax(is_large)), 2))
    return np.array(counts)


def _errors_by_trial(likelihood: Likelihood, chi: np.ndarray) -> list[np.ndarray]:
    """Compute simulated less far finer simulated points of each trial, (n, 2) [m]."""
    values = parameter_values(likelihood.parameters, chi[None])
    reference = likelihood_on_mesh(likelihood, REFERENCE_REFINEMENT)
    coarse, fine = (
        measured_points(each.model, each.data.trials, values)
        for each in (likelihood, reference)
    )
    return [ours[0] - limit[0] for ours, limit in zip(coarse, fine, strict=True)]


def refine_mesh(
    model: Model,
    trials: Sequence[PreparedTrial],
    factor: float,
) -> tuple[Model, tuple[PreparedTrial, ...]]:
    """Divide a model's string, and that of trials, into `factor` times the segments.

    Steps are as much shorter.
    """
    string = model.string
    # The small number rounds a half up
    segments = round(factor * (string.points - 1) + 1e-9)
    step = string.largest_step / factor
    finer_string = replace(string, points=segments + 1, largest_step=step)
    finer = replace(model, string=finer_string)
    return finer, with_model(trials, finer)


def simulate_on_meshes(
    model: Model,
    trials: Sequence[PreparedTrial],
    chi: np.ndarray,
    factors: Sequence[int],
) -> list[tuple[np.ndarray, ...]]:
    """Simulate the measured points of each trial, (C, n, 2) [m], on finer meshes.

    chi: exponents, (C, P). factors: times as many segments, of each mesh.
    """
    values = parameter_values(model.parameters, chi)
    by_mesh = []
    for factor in factors:
        finer, refined = refine_mesh(model, trials, factor)
        by_mesh.append(measured_points(finer, refined, values))
    return list(zip(*by_mesh, strict=True))


def extrapolate_errors(
    model: Model, trials: Sequence[PreparedTrial], chi: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Extrapolate the discretisation error at exponents (P,) from three meshes.

    It is NaN in trials in which the simulation on one of them diverges.

    Returns
    -------
    errors : list of numpy.ndarray, shape (n, 2)
        Limit less simulation of the measured points of each trial [m].
    uncertainties : list of numpy.ndarray, shape (2 n,)
        By how much two meshes extrapolate otherwise, over sigma.
    """
    errors = []
    uncertainties = []
    meshes = simulate_on_meshes(model, trials, chi[None], EXTRAPOLATED_MESHES)
    for trial, (coarse, finer, finest) in zip(trials, meshes, strict=True):
        error, uncertainty = extrapolate_error(coarse[0], finer[0], finest[0])
        errors.append(error)
        uncertainties.append((uncertainty / trial.sigma[:, None]).ravel())
    return errors, uncertainties


def extrapolate_error(
    coarse: np.ndarray, finer: np.ndarray, finest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Extrapolate the error of the coarsest of EXTRAPOLATED_MESHES [m].

    Returns the limit less what it shows, and by how much two meshes extrapolate
    otherwise.
    """
    limit = richardson_limit(finer, finest)
    return limit - coarse, limit - richardson_limit(coarse, finer)


def likelihood_on_mesh(likelihood: Likelihood, factor: float) -> Likelihood:
    """Divide the strings of a likelihood into `factor` times the segments."""
    model, trials = refine_mesh(likelihood.model, likelihood.data.trials, factor)
    return replace(likelihood.with_trials(trials), model=model)
