"""The model of each trial's discrepancy and random effects.

A cause may differ from trial to trial, as when the string is picked up again. It then
has an amplitude that all trials share, and a deviation in each trial (random effects:
Laird and Ware, Biometrics 38, 963, 1982). To first order, the deviation is a
displacement of known shape whose amplitude is integrated out. Its standard deviation at
the tip, which may be zero, is estimated from the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.inference import solver
from stringcast.stages.inference.batch import measured_points
from stringcast.stages.inference.discrepancy import Discrepancy
from stringcast.stages.inference.discrepancy_grid import marginal_log_likelihood
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.initial_modes import (
    initial_mode_columns,
    reset_initial_state_linear,
)
from stringcast.stages.inference.laplace import TIP_SHIFT_WIDTHS_M
from stringcast.stages.inference.mark_places import mark_place_columns
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import ByTrial, TrialData
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.parameter import parameter_values

MIN_RELATIVE_SENSITIVITY = 0.1  # of the largest: early frames have discrepancy, too


def attach_discrepancy_model(
    trials: Sequence[PreparedTrial],
    hypothesis: Hypothesis,
    chi: np.ndarray,
    error_shapes: ByTrial | None = None,
) -> TrialData:
    """Attach a Gaussian-process discrepancy and random effects to each trial.

    The size of the discrepancy follows the trial's `growth`, which is computed if it is
    missing.

    Parameters
    ----------
    trials : sequence of PreparedTrial, length K
    chi : numpy.ndarray, shape (P,)
        Exponents of the hypothesis at which initial states are linearised.
    error_shapes : sequence of numpy.ndarray, shape (2 n, D), optional
        Further displacements of each trial over sigma, with amplitudes N(0, 1).
    """
    values = parameter_values(hypothesis.parameters, chi[None])[0]
    mark_places = mark_place_columns(trials, hypothesis.model, values)
    if error_shapes is None:
        error_shapes = [np.zeros((2 * len(trial.s), 0)) for trial in trials]

    modelled = []
    for k, trial in enumerate(with_growth(trials, hypothesis, chi)):
        initial_modes = initial_mode_columns(trial, values)
        nuisance = np.hstack([initial_modes, mark_places[k], error_shapes[k]])
        discrepancy = Discrepancy.for_trial(trial, trial.growth, nuisance)
        centred = reset_initial_state_linear(trial, initial_modes)
        modelled.append(replace(centred, error_model=discrepancy))
    return with_random_effects(TrialData(tuple(modelled)), hypothesis, chi)


def with_growth(
    trials: Sequence[PreparedTrial],
    hypothesis: Hypothesis,
    chi: np.ndarray,
) -> list[PreparedTrial]:
    """Compute the relative sensitivity to the parameters by frame where it is missing.

    It is the root mean square over points and over parameters, each parameter scaled to
    the same mean. It is computed once and used for all hypotheses.
    """
    unknown = [trial for trial in trials if not trial.growth.size]
    if not unknown:
        return list(trials)
    exponents, _ = solver.difference_exponents(chi, solver.FIRST_DIFFERENCE)
    values = parameter_values(hypothesis.parameters, exponents)
    simulated = measured_points(hypothesis.model, unknown, values)

    measured = []
    for trial, points in zip(unknown, simulated, strict=True):
        nominal, *changed = np.nan_to_num(points)
        square = np.sum((np.stack(changed) - nominal) ** 2, axis=-1)  # (P, n)
        mean_square = square.mean(axis=1, keepdims=True)
        relative = square / np.maximum(mean_square, np.finfo(float).tiny)
        by_point = np.mean(relative, axis=0)
        frames = len(trial.times)
        count = np.maximum(np.bincount(trial.frame, minlength=frames), 1)
        sums = np.bincount(trial.frame, by_point, minlength=frames)
        grown = np.maximum.accumulate(np.sqrt(sums / count))
        growth = np.maximum(grown, MIN_RELATIVE_SENSITIVITY * grown[-1])
        measured.append(replace(trial, growth=growth))
    pending = iter(measured)
    return [trial if trial.growth.size else next(pending) for trial in trials]


def with_random_effects(
    data: TrialData,
    hypothesis: Hypothesis,
    chi: np.ndarray,
) -> TrialData:
    """Add random effects of a hypothesis at exponents (P,), with most likely widths."""
    for cause in hypothesis.causes:
        if not cause.varies_between_trials:
            continue
        residuals, shapes = _shapes_per_metre(data, hypothesis, cause, chi)
        data = data.without_random_effect(cause.name)
        others = data.for_hypothesis(hypothesis)
        width_m = _most_likely_width_m(others, residuals, shapes)
        if width_m > 0:
            scaled = tuple(width_m * shape for shape in shapes)
            random_effects = {**data.random_effects, cause.name: scaled}
            data = replace(data, random_effects=random_effects)
    return data


def _most_likely_width_m(data: TrialData, residuals: ByTrial, shapes: ByTrial) -> float:
    """Choose the standard deviation at the tip of a further random effect [m], or 0.

    residuals: of each trial, (1, 2 n). shapes: displacements by the effect over sigma,
    scaled to 1 m at the tip, (2 n, m).
    """
    widths_m = np.concatenate([[0.0], TIP_SHIFT_WIDTHS_M])
    log_likelihoods = np.zeros(len(widths_m))
    for trial, residual, shape in zip(data.trials, residuals, shapes, strict=True):
        extended = trial.discrepancy.with_nuisance(shape)
        sizes = np.ones((len(widths_m), extended.nuisance_shapes.shape[1]))
        sizes[:, -shape.shape[1] :] = widths_m[:, None]
        by_grid_point = extended.log_likelihood_by_nuisance_size(
            extended.coefficients(residual), sizes
        )
        log_likelihoods += marginal_log_likelihood(by_grid_point)[:, 0]
    return float(widths_m[np.argmax(log_likelihoods)])


def _shapes_per_metre(
    data: TrialData,
    hypothesis: Hypothesis,
    cause: type[Effect],
    chi: np.ndarray,
) -> tuple[ByTrial, ByTrial]:
    """Compute the displacement by each amplitude of a cause, scaled to 1 m at the tip.

    Returns
    -------
    residuals : list of numpy.ndarray, shape (1, 2 n)
    shapes : list of numpy.ndarray, shape (2 n, m)
        Displacements of each trial over sigma.
    """
    indices = hypothesis.amplitude_indices(cause)
    offset = solver.difference_offsets(chi[indices], solver.FIRST_DIFFERENCE)
    exponents = np.repeat(chi[None], len(indices) + 1, axis=0)  # the last unchanged
    exponents[range(len(indices)), indices] += offset
    simulated = data.residuals(hypothesis.model, exponents)
    residuals = [rows[-1:] for rows in simulated]
    changes = [rows[:-1] - rows[-1] for rows in simulated]
    shift_m = np.maximum(data.overall_tip_rms(changes), np.finfo(float).tiny)
    shapes = [(change / shift_m[:, None]).T for change in changes]
    return residuals, shapes
