"""Least squares on the centre-line, with a 95 % interval of each parameter.

The best of random strings are refined together on a growing part of the trials
(`inference.search`), with a robust loss. The intervals come from a jackknife over
blocks of time (`inference.covariance`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import PositiveInt

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.stages.common import Progress, rms
from stringcast.stages.estimate.matching import (
    Matching,
    matching_rate,
    matching_targets,
)
from stringcast.stages.estimate.posterior import sample_posterior, share_of_blocks
from stringcast.stages.estimate.result import (
    Candidates,
    Interval,
    build_estimate,
    describe_correlated,
    describe_undetermined,
    start_chi,
    within_range,
)
from stringcast.stages.inference.covariance import (
    Covariance,
    linearise,
    parameter_covariance,
    variance_inflation,
)
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import discretisation_error
from stringcast.stages.inference.mesh_limit import (
    MISFIT_RATIO,
    loss_at_noise,
    refine_at_mesh_limit,
    subtract_uncertain_error,
)
from stringcast.stages.inference.search import (
    refine_solution,
    screen_candidates,
    search_parameters,
)
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.model import Model
from stringcast.stages.spec import declare_string_counts

UNDETERMINED_WIDTH = 0.3  # width in chi from which an interval determines nothing
STRINGS_PER_ITERATION = 10  # for slopes by the parameters, and for the step


def _string_counts(settings: Mapping[str, Any]) -> Mapping[str, float]:
    iterations = settings["starts"] * settings["iterations"]
    return {
        "screening": settings["screening"],
        "starts": STRINGS_PER_ITERATION * iterations,
    }


@declare_string_counts(_string_counts)
def estimate(
    model: Model,
    observations: Sequence[Observation],
    previous: Estimate | None,
    *,
    seed: int,
    cast_number: PositiveInt,
    starts: PositiveInt,
    screening: PositiveInt,
    iterations: PositiveInt,
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Estimate:
    """Fit the parameters to the measured points, with 95 % intervals.

    The intervals cover noise, but not model error. The sentence of the estimate warns
    if the residual exceeds the noise.

    Parameters
    ----------
    previous
        Estimate of the last cast; always refined on the whole trials.
    seed, cast_number
        Seeds of the random candidates.
    starts
        Number of candidates that are refined.
    screening
        Number of random candidates from which the starts are chosen.
    iterations
        Largest number for each start, before the whole trials are fitted.
    matching
        Settings of E, which is computed for all candidates.
    """
    targets = matching_targets(model, observations, matching)
    before = start_chi(model, previous)
    rng = np.random.default_rng([seed, cast_number])
    drawn = rng.uniform(0, 1, (screening, len(before)))
    # Known values of added effects are refined, but not drawn: elsewhere in its range,
    # dry friction, for example, needs a hundred times as many steps.
    for index, name in enumerate(model.names):
        if "." in name and name in model.start_values:
            drawn[:, index] = before[index]
    tried = np.concatenate([before[None], drawn])

    trials = tuple(target.trial for target in targets)
    likelihood = Likelihood(TrialData(trials), model)
    chosen = screen_candidates(likelihood, tried, starts)
    known = None if previous is None else before
    best = search_parameters(likelihood, chosen, iterations, progress, known)
    likelihood, best = refine_solution(likelihood, best)
    on_mesh = likelihood
    likelihood, best = _refine_at_mesh_limit(on_mesh, best, known)
    is_at_limit = likelihood is not on_mesh

    corrected_trials = likelihood.data.trials
    if is_at_limit:
        corrected_trials = tuple(subtract_uncertain_error(likelihood, best))
    mesh_errors = []
    for number, trial in enumerate(corrected_trials):
        mesh_errors.append(trial.points - on_mesh.data.trials[number].points)
        targets[number] = replace(targets[number], trial=trial)
    tried = np.concatenate([tried, best[None]])
    search = Candidates("least squares", tried, matching_rate(targets, tried))
    linear = linearise(likelihood, best)
    interval = _parameter_intervals(likelihood, best, parameter_covariance(linear))
    if is_at_limit:
        share = 1 / variance_inflation(linear)
    else:
        sentence = interval.sentence + _describe_mesh(likelihood, best)
        interval = replace(interval, sentence=sentence)
        share = share_of_blocks(linear)
    draws = sample_posterior(likelihood.parameters, best, linear, share, seed)
    return build_estimate(targets, before, best, search, interval, draws, mesh_errors)


def _refine_at_mesh_limit(
    on_mesh: Likelihood, chi: np.ndarray, earlier: np.ndarray | None
) -> tuple[Likelihood, np.ndarray]:
    """Refine a solution (P,) at the mesh limit, if necessary from earlier exponents.

    A coarse mesh may lead to a solution that cannot be corrected, or only to a worse
    one: string D became twice as stiff in a look and a cast. So the correction begins
    again at the earlier estimate if it leaves more than noise.
    """
    corrected = refine_at_mesh_limit(on_mesh, chi)
    if earlier is None or _largest_residual_ratio(*corrected) < MISFIT_RATIO:
        return corrected
    from_earlier = refine_at_mesh_limit(on_mesh, chi, earlier)
    losses = []
    for likelihood, solution in (corrected, from_earlier):
        losses.append(loss_at_noise(likelihood, solution, on_mesh.noise_scales))
    return from_earlier if losses[1] < losses[0] else corrected


def _largest_residual_ratio(likelihood: Likelihood, chi: np.ndarray) -> float:
    """Compute the largest residual of a trial over its points' sigma, at chi (P,).

    Unlike the robust scale of the noise, it counts late frames, where strings whip.
    """
    whitened = likelihood.residuals_by_trial(chi[None])
    ratios = []
    for scale, residual in zip(likelihood.noise_scales, whitened, strict=True):
        ratios.append(scale * rms(residual))
    return max(ratios)


def _parameter_intervals(
    likelihood: Likelihood, best: np.ndarray, covariance: Covariance
) -> Interval:
    """Compute 95 % intervals around the solution (P,), and describe their limits."""
    parameters = likelihood.parameters
    low = np.clip(best - covariance.half_width_95, 0, 1)
    high = np.clip(best + covariance.half_width_95, 0, 1)
    is_narrow = high - low < UNDETERMINED_WIDTH
    is_inside = within_range(best, low, high)
    determined = is_narrow & is_inside
    sentence = describe_undetermined(
        parameters, is_narrow, is_inside, "This data determines every parameter."
    )
    sentence += describe_correlated(parameters, determined, covariance.correlation)
    sentence += _describe_misfit(max(likelihood.noise_scales))
    return Interval(low, high, determined, sentence)


def _describe_misfit(scale: float) -> str:
    """Warn of a residual above the noise. scale: residual over the points' sigma."""
    if scale < MISFIT_RATIO:
        return ""
    return (
        f" The residual is up to {scale:.1f} times the points' uncertainty: the model "
        "is incomplete, and the intervals do not cover its error."
    )


def _describe_mesh(likelihood: Likelihood, chi: np.ndarray) -> str:
    """Warn of a discretisation error that exceeds the noise, at parameters (P,)."""
    error = discretisation_error(likelihood, chi)
    sigmas = []
    for trial in likelihood.data.trials:
        sigmas.append(trial.error_model.scale * np.median(trial.sigma))
    noise = np.sqrt(2) * np.median(sigmas)
    if not error > noise:
        return ""
    return (
        f" Discretisation error is {1e3 * error:.1f} mm rms (noise {1e3 * noise:.1f} "
        "mm). The fitted parameters partly compensate for it and may not transfer to "
        f"other motions. Use string.points={2 * likelihood.model.string.points - 1} to "
        "reduce it."
    )
