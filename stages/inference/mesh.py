"""Coarser and finer meshes, and the discretisation error.

Each mesh of the ladder has half as many segments as the one before and steps twice as
long. It costs a quarter and suffices to rank starts: all of 24 sets of casts reach the
same minimum with 20 points and with 11. Parameters are those of the material, and so
have the same meaning on every mesh.
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

MIN_SEGMENTS = 10  # with fewer, the string's second bend is not resolved
# A mesh this many times finer replaces the limit: at second order it has 1/16 of the
# error
REFERENCE_REFINEMENT = 4
EXTRAPOLATED_MESHES = (1, 2, 4)  # factors of the number of segments


def mesh_ladder(likelihood: Likelihood) -> list[Likelihood]:
    """List the likelihood on ever coarser meshes, the given one first."""
    ladder = [likelihood]
    while ladder[-1].model.string.points - 1 >= 2 * MIN_SEGMENTS - 1:
        ladder.append(likelihood_on_mesh(likelihood, 0.5 ** len(ladder)))
    return ladder


def discretisation_error(likelihood: Likelihood, chi: np.ndarray) -> float:
    """Compute the discretisation error of the string at parameters (P,).

    Returns the root mean square at the measured points [m]; NaN if a simulation
    diverges.
    """
    errors = np.concatenate(_errors_by_trial(likelihood, chi))
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))


def normalised_discretisation_errors(
    likelihood: Likelihood, chi: np.ndarray
) -> list[np.ndarray]:
    """Compute the discretisation error over sigma of each trial, (2 n,).

    It is NaN at parameters (P,) where a simulation diverges.
    """
    errors = []
    pairs = zip(likelihood.data.trials, _errors_by_trial(likelihood, chi), strict=True)
    for trial, error in pairs:
        errors.append((error / trial.sigma[:, None]).ravel())
    return errors


def normalised_discretisation_uncertainties(
    likelihood: Likelihood, chi: np.ndarray
) -> list[np.ndarray]:
    """Compute what three meshes disagree on, over sigma of each trial, (2 n,).

    It is NaN at parameters (P,) where a simulation diverges.
    """
    trials = likelihood.data.trials
    _, uncertainties = extrapolate_errors(likelihood.model, trials, chi)
    return uncertainties


def with_corrected_points(likelihood: Likelihood, chi: np.ndarray) -> Likelihood:
    """Subtract the discretisation error at parameters (P,) from the measured points.

    Near these parameters, residuals are then those of a far finer mesh (deferred
    correction).
    """
    trials = []
    errors = _errors_by_trial(likelihood, chi)
    for trial, error in zip(likelihood.data.trials, errors, strict=True):
        trials.append(replace(trial, points=trial.points + np.nan_to_num(error)))
    return likelihood.with_trials(tuple(trials))


def resolved_frames(
    trials: Sequence[PreparedTrial], errors: Sequence[np.ndarray], max_error: float
) -> np.ndarray:
    """Count the frames of each trial before its discretisation error is large, (K,).

    The error of a string that whips grows until no mesh resolves its motion. The count
    is at least two.

    Parameters
    ----------
    trials
        The trials.
    errors
        Error over sigma of each trial, (2 n,).
    max_error
        Largest root mean square error of a frame's coordinates over sigma.
    """
    counts = []
    for trial, error in zip(trials, errors, strict=True):
        squares = np.mean(error.reshape(-1, 2) ** 2, axis=1)  # (n,)
        sums = np.bincount(trial.frame, squares)
        is_resolved = sums <= max_error**2 * np.bincount(trial.frame)
        is_large = np.append(~is_resolved, True)  # also if NaN
        counts.append(max(int(np.argmax(is_large)), 2))
    return np.array(counts)


def _errors_by_trial(likelihood: Likelihood, chi: np.ndarray) -> list[np.ndarray]:
    """Compute points on this mesh minus those on a far finer one, (n, 2) [m]."""
    values = parameter_values(likelihood.parameters, chi[None])
    reference = likelihood_on_mesh(likelihood, REFERENCE_REFINEMENT)
    coarse = measured_points(likelihood.model, likelihood.data.trials, values)
    fine = measured_points(reference.model, reference.data.trials, values)
    return [points[0] - limit[0] for points, limit in zip(coarse, fine, strict=True)]


def refine_mesh(
    model: Model,
    trials: Sequence[PreparedTrial],
    factor: float,
) -> tuple[Model, tuple[PreparedTrial, ...]]:
    """Multiply the segments of the string by a factor, in a model and in trials.

    Time steps are divided by it.
    """
    string = model.string
    # The small number makes halves round up
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

    chi: exponents, (C, P). factors: of the number of segments.
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

    It is NaN in trials in which one of the simulations diverges.

    Returns
    -------
    errors : list of numpy.ndarray, shape (n, 2)
        Limit minus simulation at the measured points of each trial [m].
    uncertainties : list of numpy.ndarray, shape (2 n,)
        Difference between the limits from the finer and the coarser two meshes, over
        sigma.
    """
    errors = []
    uncertainties = []
    meshes = simulate_on_meshes(model, trials, chi[None], EXTRAPOLATED_MESHES)
    for trial, (coarse, finer, finest) in zip(trials, meshes, strict=True):
        error, uncertainty = extrapolate_error(coarse[0], finer[0], finest[0])
        errors.append(error)
        uncertainties.append((uncertainty / trial.sigma[:, None]).ravel())
    return errors, uncertainties


def extrapolate_error(*meshes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Extrapolate the error of the coarsest of two or three EXTRAPOLATED_MESHES [m].

    Returns the limit minus the coarsest simulation, and the difference between the
    limits from the finer and the coarser two meshes.
    """
    coarse, second = meshes[:2]
    last_but_one, finest = meshes[-2:]
    limit = richardson_limit(last_but_one, finest)
    return limit - coarse, limit - richardson_limit(coarse, second)


def likelihood_on_mesh(likelihood: Likelihood, factor: float) -> Likelihood:
    """Multiply the segments of a likelihood's string by a factor."""
    model, trials = refine_mesh(likelihood.model, likelihood.data.trials, factor)
    return replace(likelihood.with_trials(trials), model=model)
