"""Discretisation error: extrapolated from finer meshes and subtracted from the data.

Deferred correction [1]_: the error of the mesh at a fit is subtracted from the measured
points, so that candidates can be simulated on the coarse mesh. The change of the error
with the parameters follows from finite differences (manifold mapping [2]_).

References
----------
.. [1] Stetter, Numer. Math. 29, 425 (1978).
.. [2] Echeverria, Hemker, Comput. Methods Appl. Math. 5, 107 (2005).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.evidence.measures import refit
from stringcast.stages.diagnose.rules import (
    MIN_RESOLVED_TRIALS,
    NEGLIGIBLE_LOG_EVIDENCE,
)
from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.trials.prepared_data import (
    PreparedData,
    RefinedFit,
    with_initial_states_of,
)
from stringcast.stages.inference.hypothesis import ABRUPT_STEP_S, Hypothesis
from stringcast.stages.inference.initial_modes import (
    reset_initial_state_linear,
    trials_with_reestimated_start,
)
from stringcast.stages.inference.laplace import (
    Fit,
    best_exponents,
    evaluate_fit,
)
from stringcast.stages.inference.mesh import (
    extrapolate_errors,
    simulate_on_meshes,
)
from stringcast.stages.inference.mesh_correction import MeshCorrection
from stringcast.stages.inference.prepared_trial import PreparedTrial, with_model
from stringcast.stages.inference.solver import difference_exponents
from stringcast.stages.inference.trial_data import ByTrial, TrialData
from stringcast.stages.model.engine.accuracy import richardson_limit
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.model import Model

# The tip error of a plain cast is 1 mm before correction
SEGMENTS = 20
STEP_S = ABRUPT_STEP_S  # accurate enough for any cause
MAX_CORRECTION_PASSES = 8  # usually two are enough
# Ratio of the uncertainty of an error to the error. Extrapolation assumes that errors
# fall by 4 as segments are halved (order 2). If one falls by 2^p, |4 / 2^p - 1| / 4 of
# it is uncertain: a quarter at p = 1.
MAX_UNCERTAINTY_RATIO = 0.25


def with_second_order_mesh(model: Model) -> Model:
    """Use a mesh with half cells at the ends, and implicit steps.

    The discretisation error is then of second order and can be extrapolated.
    """
    string = replace(
        model.string,
        points=SEGMENTS + 1,
        tip_cell=0.5,
        grasp_cell=0.5,
        integrator=ImplicitLeapfrog(),
        largest_step=STEP_S,
    )
    return replace(model, string=string)


def correct_data_at(prepared: PreparedData, fit: Fit) -> PreparedData:
    """Redo the corrections of the measured trials at the optimum of a fit.

    Each correction is linearised at those before it, so the order is fixed. The noise
    is re-estimated only when a cause is added (`reestimate_noise`).
    """
    # 1. The most probable initial state of each trial given the fit
    restarted = trials_with_reestimated_start(prepared.data, fit)
    trials = with_initial_states_of(prepared.trials, restarted)

    # 2. Discretisation error at the fit, 3. discrepancy model of the corrected data
    data, uncertainty_m = corrected_data_of(prepared, trials, fit)

    # 4. Change of the discretisation error with the parameters, centred at the fit
    data = replace(data, mesh_correction=_centred_mesh_correction(prepared, fit))
    return replace(
        prepared,
        trials=trials,
        data=data,
        discretisation_uncertainty_m=uncertainty_m,
    )


def corrected_data_of(
    prepared: PreparedData,
    trials: Sequence[PreparedTrial],
    fit: Fit,
) -> tuple[TrialData, np.ndarray]:
    """Correct any trials at a fit, with the same mesh as the prepared ones.

    Returns
    -------
    data : TrialData
    uncertainty_m : numpy.ndarray, shape (K,)
        Uncertainty of the discretisation error at each tip [m].
    """
    if prepared.mesh_is_model:
        simulated = with_model(trials, fit.hypothesis.model)
        data = attach_discrepancy_model(simulated, fit.hypothesis, fit.chi)
        return data, np.zeros(len(simulated))
    return subtract_discretisation_error(trials, fit.hypothesis, fit.chi)


def subtract_discretisation_error(
    trials: Sequence[PreparedTrial],
    hypothesis: Hypothesis,
    chi: np.ndarray,
) -> tuple[TrialData, np.ndarray]:
    """Subtract the discretisation error of a hypothesis from measured trials.

    The uncertain part becomes a nuisance with a standard normal amplitude.

    Returns
    -------
    data : TrialData
    uncertainty_m : numpy.ndarray, shape (K,)
        Uncertainty of the discretisation error at each tip [m]. It is infinite if a
        simulation diverges.
    """
    corrected = []
    errors, uncertainties = extrapolate_errors(hypothesis.model, trials, chi)
    for trial, error in zip(trials, errors, strict=True):
        points = trial.points - np.nan_to_num(error)
        corrected.append(replace(trial, model=hypothesis.model, points=points))
    columns = [np.nan_to_num(shape)[:, None] for shape in uncertainties]
    data = attach_discrepancy_model(corrected, hypothesis, chi, columns)
    return data, _tip_uncertainty_m(data, uncertainties)


def discretisation_uncertainty_of(prepared: PreparedData, fit: Fit) -> np.ndarray:
    """Compute the uncertainty of a fit's discretisation error at each tip [m], (K,).

    See `subtract_discretisation_error`.
    """
    if prepared.mesh_is_model:
        return np.zeros(len(prepared.trials))
    return discretisation_uncertainty(prepared.trials, fit.hypothesis, fit.chi)


def discretisation_uncertainty(
    trials: Sequence[PreparedTrial], hypothesis: Hypothesis, chi: np.ndarray
) -> np.ndarray:
    """Compute the uncertainty of the discretisation error at each tip [m], (K,).

    It is infinite if a simulation diverges.

    chi: exponents of the hypothesis, (P,).
    """
    _, uncertainties = extrapolate_errors(hypothesis.model, trials, chi)
    return _tip_uncertainty_m(TrialData(tuple(trials)), uncertainties)


def _tip_uncertainty_m(data: TrialData, uncertainties: ByTrial) -> np.ndarray:
    """Compute uncertainties (2 n,) over sigma at each tip [m], (K,).

    They are infinite for NaN.
    """
    uncertainty_m = data.tip_rms_by_trial(uncertainties)
    return np.where(np.isnan(uncertainty_m), np.inf, uncertainty_m)


def correct_data_on_one_finer_mesh(prepared: PreparedData, fit: Fit) -> TrialData:
    """Subtract the discretisation error of a fit, estimated from one finer mesh.

    The discrepancy model is kept. This has a tenth of the cost of `correct_data_at`.
    """
    if prepared.mesh_is_model:
        return prepared.data
    model = fit.hypothesis.model
    meshes = simulate_on_meshes(model, prepared.trials, fit.chi[None], (1, 2))
    trials = []
    for k, (coarse, finer) in enumerate(meshes):
        error = np.nan_to_num(richardson_limit(coarse, finer) - coarse)[0]
        points = prepared.trials[k].points - error
        trial = replace(prepared.data.trials[k], points=points)
        shapes = trial.discrepancy.nuisance_shapes
        trials.append(reset_initial_state_linear(trial, shapes))
    mesh_correction = _centred_mesh_correction(prepared, fit)
    return replace(prepared.data, trials=tuple(trials), mesh_correction=mesh_correction)


def _centred_mesh_correction(prepared: PreparedData, fit: Fit) -> MeshCorrection | None:
    if prepared.mesh_is_model or prepared.data.mesh_correction is None:
        return None
    return prepared.data.mesh_correction.centred_at(fit.exponents)


def refine_to_convergence(prepared: PreparedData, fit: Fit) -> RefinedFit:
    """Alternate correction and fit until the evidence gains no more.

    The discretisation error of a string that whips changes at every step.
    """
    current = RefinedFit(prepared, fit)
    for _ in range(MAX_CORRECTION_PASSES):
        before = current.fit.log_evidence
        current = correct_discretisation_once(current.prepared, current.fit)
        if current.fit.log_evidence < before + NEGLIGIBLE_LOG_EVIDENCE:
            break
    return current


def correct_discretisation_once(prepared: PreparedData, fit: Fit) -> RefinedFit:
    """Correct the data at a fit, refit, and correct again if the evidence improves."""
    corrected = correct_data_at(prepared, fit)
    if prepared.mesh_is_model:
        return RefinedFit(corrected, refit(corrected.data, fit, fit.hypothesis))

    # Refit with the error's linear change with the parameters
    hypothesis = fit.hypothesis
    unmoved = evaluate_fit(corrected.data, hypothesis, fit.chi, fit.width)
    mesh_correction = fit_mesh_correction(corrected, unmoved)
    data = replace(corrected.data, mesh_correction=mesh_correction)
    chi, width = best_exponents(
        data,
        hypothesis,
        fit.chi[None],
        unmoved.grid_points,
        NEGLIGIBLE_LOG_EVIDENCE,
        fit.width,
    )

    # Compute the error at the new optimum, for which only its exponents are needed
    moved = correct_data_at(corrected, replace(unmoved, chi=chi))
    mesh_correction = replace(mesh_correction, chi=chi)
    moved = replace(moved, data=replace(moved.data, mesh_correction=mesh_correction))
    refitted = evaluate_fit(moved.data, hypothesis, chi, width)
    if refitted.log_evidence > unmoved.log_evidence:
        return RefinedFit(moved, refitted)
    return RefinedFit(corrected, unmoved)


def fit_mesh_correction(prepared: PreparedData, fit: Fit) -> MeshCorrection:
    """Compute the change of the discretisation error with the parameters of a fit.

    It is extrapolated from this mesh and one with segments of half the length. A trial
    whose error falls by less than 2 between them gets no slopes: those of a chaotic
    motion would mislead.
    """
    hypothesis = fit.hypothesis
    data = prepared.data
    chi, offset = difference_exponents(fit.chi, fit.width)
    meshes = simulate_on_meshes(hypothesis.model, data.trials, chi, (1, 2))
    errors = []  # of each trial over sigma, (1 + P, 2 n)
    for trial, (coarse, finer) in zip(data.trials, meshes, strict=True):
        error = (richardson_limit(coarse, finer) - coarse) / trial.sigma[:, None]
        diverged = np.isnan(error).any(axis=0)
        errors.append(np.where(diverged, 0.0, error).reshape(len(chi), -1))
    error_m = data.tip_rms_by_trial([error[0] for error in errors])
    uncertainty_m = prepared.discretisation_uncertainty_m
    is_known = uncertainty_m <= MAX_UNCERTAINTY_RATIO * error_m
    slopes = []
    for error, known in zip(errors, is_known, strict=True):
        slope = (error[1:] - error[0]) / offset[:, None]
        slopes.append(slope * known)
    return MeshCorrection(hypothesis.model.names, fit.chi, tuple(slopes))


def unresolvable_trials(prepared: PreparedData, tolerance_m: float) -> list[str]:
    """Name trials whose discretisation error is uncertain by the tolerance or more.

    Returns an empty list if too few trials would remain.
    """
    is_resolved = prepared.discretisation_uncertainty_m < tolerance_m
    if is_resolved.sum() < MIN_RESOLVED_TRIALS:
        return []
    return [prepared.trials[k].name for k in np.flatnonzero(~is_resolved)]


def exclude_chaotic_trials(prepared: PreparedData, tolerance_m: float) -> PreparedData:
    """Exclude unresolvable trials and refit the base model.

    Trials in `keep_if_chaotic` stay.
    """
    names = names_of_chaotic_trials(prepared, tolerance_m)
    if not names:
        return prepared
    remaining = without_trials(prepared, names)
    base = remaining.base_fit
    corrected = correct_data_at(remaining, base)
    base_fit = refit(corrected.data, base, base.hypothesis)
    return replace(corrected, base_fit=base_fit)


def names_of_chaotic_trials(prepared: PreparedData, tolerance_m: float) -> list[str]:
    """Name unresolvable trials except those in `keep_if_chaotic`."""
    unresolvable = unresolvable_trials(prepared, tolerance_m)
    return [name for name in unresolvable if name not in prepared.keep_if_chaotic]


def without_trials(prepared: PreparedData, names: Sequence[str]) -> PreparedData:
    """Leave out chaotic trials, without refitting the base model."""
    kept = [k for k, trial in enumerate(prepared.trials) if trial.name not in names]
    data = prepared.data.subset(kept)
    base = prepared.base_fit
    return replace(
        prepared,
        data=data,
        base_fit=evaluate_fit(data, base.hypothesis, base.chi, base.width),
        trials_with_outliers=tuple(prepared.trials_with_outliers[k] for k in kept),
        trials=tuple(prepared.trials[k] for k in kept),
        discretisation_uncertainty_m=prepared.discretisation_uncertainty_m[kept],
        chaotic_trials=(*prepared.chaotic_trials, *names),
    )
