"""The model of what a hypothesis may leave unexplained in each trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.linearisation import difference_exponents
from stringcast.stages.diagnose.random_effects import with_random_effects
from stringcast.stages.inference import solver
from stringcast.stages.inference.batch import simulate_trials
from stringcast.stages.inference.discrepancy import Discrepancy
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.initial_modes import (
    initial_mode_columns,
    reset_initial_state_linear,
)
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.parameter import parameter_values

MIN_RELATIVE_SENSITIVITY = 0.1  # of the largest: early frames are not exact either


def attach_discrepancy_model(
    trials: Sequence[PreparedTrial],
    hypothesis: Hypothesis,
    chi: np.ndarray,
    error_shapes: Sequence[np.ndarray] | None = None,
) -> TrialData:
    """Attach a Gaussian-process discrepancy and random effects to each trial.

    Parameters
    ----------
    trials : sequence of PreparedTrial, length K
    hypothesis : Hypothesis
    chi : numpy.ndarray, shape (P,)
        Exponents of the hypothesis about which initial states are linearised.
    error_shapes : sequence of numpy.ndarray, shape (2 n, D), optional
        Displacements over sigma of each trial with standard normal amplitudes.

    Returns
    -------
    TrialData
    """
    values = parameter_values(hypothesis.parameters, chi[None])[0]
    no_columns = [np.zeros((2 * len(trial.s), 0)) for trial in trials]
    initial_modes = initial_mode_columns(trials, values) or no_columns
    error_shapes = error_shapes or no_columns
    sensitivity = sensitivity_by_frame(trials, hypothesis, chi)

    modelled = []
    for k, trial in enumerate(trials):
        nuisance = np.hstack([initial_modes[k], error_shapes[k]])
        discrepancy = Discrepancy.for_trial(trial, sensitivity[k], nuisance)
        centred = reset_initial_state_linear(trial, initial_modes[k])
        modelled.append(replace(centred, error_model=discrepancy))
    return with_random_effects(TrialData(tuple(modelled)), hypothesis, chi)


def sensitivity_by_frame(
    trials: Sequence[PreparedTrial], hypothesis: Hypothesis, chi: np.ndarray
) -> list[np.ndarray]:
    """Measure how a small change of the parameters has grown by each frame.

    Returns
    -------
    list of numpy.ndarray, shape (F,)
        For each trial, the root mean square over points and over parameters, each
        parameter scaled to the same mean.
    """
    exponents, _ = difference_exponents(chi, solver.FIRST_DIFFERENCE)
    values = parameter_values(hypothesis.parameters, exponents)
    simulated = simulate_trials(hypothesis.model, trials, values)

    growth = []
    for trial, strings in zip(trials, simulated, strict=True):
        nominal, *changed = np.nan_to_num(trial.sample_at_points(strings))
        square = np.sum((np.stack(changed) - nominal) ** 2, axis=-1)  # (P, n)
        mean_square = square.mean(axis=1, keepdims=True)
        scaled = np.mean(square / np.maximum(mean_square, np.finfo(float).tiny), axis=0)
        frames = len(trial.times)
        count = np.maximum(np.bincount(trial.frame, minlength=frames), 1)
        by_frame = np.sqrt(np.bincount(trial.frame, scaled, minlength=frames) / count)
        grown = np.maximum.accumulate(by_frame)
        growth.append(np.maximum(grown, MIN_RELATIVE_SENSITIVITY * grown[-1]))
    return growth
