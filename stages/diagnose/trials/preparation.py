"""From observed trials to corrected data with a fitted base model."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.data.schema import DataError
from stringcast.stages.common import Progress
from stringcast.stages.diagnose.evidence.measures import refit, unexplained_tip_rms
from stringcast.stages.diagnose.rules import STRONG_LOG_EVIDENCE
from stringcast.stages.diagnose.trials.base_model import (
    fit_base_model,
    fit_from_beginnings,
)
from stringcast.stages.diagnose.trials.discrepancy_model import with_growth
from stringcast.stages.diagnose.trials.discretisation import (
    correct_data_at,
    corrected_data_of,
    exclude_chaotic_trials,
    names_of_chaotic_trials,
    refine_to_convergence,
    subtract_discretisation_error,
    with_second_order_mesh,
    without_trials,
)
from stringcast.stages.diagnose.trials.mesh_choice import choose_mesh
from stringcast.stages.diagnose.trials.noise import (
    estimate_initial_noise,
    remove_outliers,
)
from stringcast.stages.diagnose.trials.prepared_data import (
    PreparedData,
    with_initial_states_of,
)
from stringcast.stages.diagnose.trials.used_frames import (
    thin_frames,
    trim_trailing_rest,
    warn_of_long_trials,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.initial_modes import (
    reset_initial_state_linear,
    trials_with_reestimated_start,
)
from stringcast.stages.inference.laplace import Fit, evaluate_fit
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.prepared_trial import (
    prepare_trial,
    with_model,
)
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.model import Model

INITIAL_NOISE_M = 1e-3  # before noise is estimated

log = logging.getLogger(__name__)


def usable_trials(
    model: Model,
    observations: Sequence[Observation],
) -> tuple[list[Observation], dict[str, str]]:
    """Separate trials that can be prepared from those that cannot.

    Returns
    -------
    usable : list of Observation
    faults : dict
        For each other trial, by name, why it cannot be used.
    """
    usable = []
    faults = {}
    for observation in observations:
        try:
            prepare_trial(model, observation)
            usable.append(observation)
        except DataError as error:
            prefix = f"trial {observation.trial}: "
            faults[observation.trial] = str(error).removeprefix(prefix)
    return usable, faults


def prepare_data(
    model: Model,
    observations: Sequence[Observation],
    tolerance_m: float,
    rng: np.random.Generator,
    starts: int,
    progress: Progress,
    mesh_may_be_coarser: bool = True,
    keep_if_chaotic: Sequence[str] = (),
) -> PreparedData:
    """Fit the base model to the trials and correct their noise and numerical error.

    Parameters
    ----------
    observations : sequence of Observation, length K
    tolerance_m : float
        Tolerance to which simulation must resolve the tip of a trial [m].
    starts : int
        Number of starts of the search for the base model's parameters.
    mesh_may_be_coarser : bool
        Whether a coarse mesh is used where it is accurate.
    keep_if_chaotic : sequence of str
        Names of trials that need not be resolved.

    Raises
    ------
    DataError
        If a trial cannot be used.
    """
    # Trials without the rest at their end and without superfluous frames
    second_order = with_second_order_mesh(model)
    noise_is_given = all("sigma" in o.points for o in observations)
    chosen = []
    resting_points = 0
    dense_points = 0
    for observation in observations:
        trial = prepare_trial(second_order, observation)
        if not noise_is_given:
            trial = replace(trial, sigma=np.full(len(trial.s), INITIAL_NOISE_M))
        trimmed = trim_trailing_rest(trial)
        thinned = thin_frames(trimmed)
        resting_points += len(trial.s) - len(trimmed.s)
        dense_points += len(trimmed.s) - len(thinned.s)
        chosen.append(thinned)
    warn_of_long_trials(chosen)

    # Base model; its residuals determine outliers and noise
    likelihood = Likelihood(TrialData(tuple(chosen)), second_order)
    likelihood, chi = fit_base_model(likelihood, rng, starts, progress)
    likelihood = choose_mesh(likelihood, chi, tolerance_m, mesh_may_be_coarser)
    with_outliers, trials = estimate_initial_noise(likelihood, chi, noise_is_given)

    # Discretisation error, discrepancy model, and the fit with its evidence
    hypothesis = Hypothesis(likelihood.model)
    trials = tuple(with_growth(trials, hypothesis, chi))
    pairs = zip(with_outliers, trials, strict=True)
    with_outliers = tuple(replace(old, growth=trial.growth) for old, trial in pairs)
    data, uncertainty_m = subtract_discretisation_error(trials, hypothesis, chi)
    prepared = PreparedData(
        data=data,
        base_fit=evaluate_fit(data, hypothesis, chi),
        trials_with_outliers=with_outliers,
        trials=trials,
        resting_points=resting_points,
        dense_points=dense_points,
        discretisation_uncertainty_m=uncertainty_m,
        noise_is_given=noise_is_given,
        keep_if_chaotic=tuple(keep_if_chaotic),
    )
    prepared = fit_base_model_to_resolved_trials(prepared, tolerance_m)
    return keep_configured_mesh_if_supported(prepared, prepared.base_fit, model)


def fit_base_model_to_resolved_trials(
    prepared: PreparedData, tolerance_m: float
) -> PreparedData:
    """Fit the base model to the trials that simulation resolves.

    A chaotic trial biases fits and makes them slow. It is left out at first, and is
    used again if the fit to the others resolves it.
    """
    chaotic = names_of_chaotic_trials(prepared, tolerance_m)
    if not chaotic:
        return exclude_chaotic_trials(refine_base_model(prepared), tolerance_m)

    resolved = refine_base_model(without_trials(prepared, chaotic))
    left_out = [trial for trial in prepared.trials if trial.name in chaotic]
    base = resolved.base_fit
    _, uncertainty_m = corrected_data_of(resolved, left_out, base)
    is_chaotic = uncertainty_m >= tolerance_m
    if not is_chaotic.all():
        names = [left_out[k].name for k in np.flatnonzero(is_chaotic)]
        together = without_trials(replace(prepared, base_fit=base), names)
        resolved = refine_base_model(together)
    return exclude_chaotic_trials(resolved, tolerance_m)


def refine_base_model(prepared: PreparedData) -> PreparedData:
    """Correct the data at the base model until its evidence gains no more.

    A fit to the beginnings of trials replaces it if it has more evidence, also with its
    own numerical error.
    """
    refined = refine_to_convergence(prepared, prepared.base_fit)
    restarted = fit_from_beginnings(refined.prepared.data, refined.fit)
    if restarted.log_evidence > refined.fit.log_evidence + STRONG_LOG_EVIDENCE:
        other = refine_to_convergence(refined.prepared, restarted)
        refined = max(refined, other, key=lambda option: option.fit.log_evidence)
    return replace(refined.prepared, base_fit=refined.fit)


def prepare_further_trials(
    prepared: PreparedData,
    observations: Sequence[Observation],
    fit: Fit,
) -> tuple[TrialData, np.ndarray]:
    """Correct further trials at a fit, with the noise of the prepared ones.

    Returns
    -------
    data : TrialData
    uncertainty_m : numpy.ndarray, shape (K,)
        Uncertainty of the discretisation error at each tip [m].
    """
    base = prepared.base_fit
    model = base.hypothesis.model
    noise = prepared.trials[0].noise
    sigma = float(np.median(np.concatenate([t.sigma for t in prepared.trials])))
    measured = []
    for observation in observations:
        trial = thin_frames(trim_trailing_rest(prepare_trial(model, observation)))
        trial = replace(trial, sigma=np.full(len(trial.s), sigma), noise=noise)
        measured.append(trial)
    trials, _, _ = remove_outliers(measured, model, base.chi)

    data, uncertainty_m = corrected_data_of(prepared, trials, fit)
    restarted = trials_with_reestimated_start(data, fit)
    if restarted is data.trials:  # all begin at rest
        return data, uncertainty_m
    return corrected_data_of(prepared, with_initial_states_of(trials, restarted), fit)


def keep_configured_mesh_if_supported(
    prepared: PreparedData,
    fit: Fit,
    model: Model,
) -> PreparedData:
    """Make the configured mesh part of the model if the data clearly come from it.

    Data of a simulated chain of mass points fit that chain better than a continuous
    string, to within their noise. Without that last condition, a measured string might
    by chance be nearer to the chain.

    fit: the base model, or one with causes.
    """
    configured = _fit_configured_mesh(prepared, fit, model)
    needed_evidence = fit.log_evidence + STRONG_LOG_EVIDENCE
    if configured is None or configured.log_evidence < needed_evidence:
        return replace(prepared, configured_mesh_fit=configured)

    hypothesis = configured.hypothesis
    trials = with_model(prepared.trials, hypothesis.model)
    on_its_mesh = replace(prepared, mesh_is_model=True, trials=trials)
    on_its_mesh = correct_data_at(on_its_mesh, configured)
    data = on_its_mesh.data
    refitted = refit(data, configured, hypothesis)
    noise_m = np.array([np.median(trial.sigma) for trial in data.trials])
    if (unexplained_tip_rms(data, refitted) > noise_m).any():
        return replace(prepared, configured_mesh_fit=configured)
    base_fit = refit(data, refitted, Hypothesis(hypothesis.base))
    return replace(on_its_mesh, base_fit=base_fit, configured_mesh_fit=None)


def _fit_configured_mesh(prepared: PreparedData, fit: Fit, model: Model) -> Fit | None:
    """Fit a hypothesis on the configured mesh; None if that is the finer one."""
    string = model.string
    fine = fit.hypothesis.base.string
    if string.points > fine.points and string.tip_cell == fine.tip_cell:
        return None
    configured = model.with_ranges(*fine.ranges.values())
    trials = []
    for trial, corrected in zip(prepared.trials, prepared.data.trials, strict=True):
        discrepancy = corrected.discrepancy
        chain = replace(trial, model=configured, error_model=discrepancy)
        trials.append(reset_initial_state_linear(chain, discrepancy.nuisance_shapes))
    hypothesis = Hypothesis(configured, fit.hypothesis.causes)
    return refit(TrialData(tuple(trials)), fit, hypothesis)
