"""The corrected trials in which causes are searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData


@dataclass(frozen=True)
class PreparedData:
    """Corrected trials with the base model's fit to them.

    Attributes
    ----------
    data : TrialData
        Trials with a noise and a discrepancy model, without discretisation error.
    base_fit : Fit
        The base model at its optimum.
    trials_with_outliers, trials : tuple of PreparedTrial
        The trials as measured; in `trials` outliers are removed.
    resting_points : int
        Number of points that were left out because the string rests.
    discretisation_uncertainty_m : numpy.ndarray, shape (K,)
        Uncertainty of the discretisation error at the tip of each trial [m].
    mesh_is_model : bool
        Whether the mesh is part of the model and has no discretisation error.
    chaotic_trials : tuple of str
        Names of trials that no simulation resolves to the tolerance.
    keep_if_chaotic : tuple of str
        Names of trials that a simulation with causes resolves.
    configured_mesh_fit : Fit or None
        The base model on the configured mesh; None if that is the finer mesh.
    noise_is_given : bool
        Whether the data state their noise.
    dense_points : int
        Number of points that were left out because frames are denser than needed.
    """

    data: TrialData
    base_fit: Fit
    trials_with_outliers: tuple[PreparedTrial, ...]
    trials: tuple[PreparedTrial, ...]
    resting_points: int
    discretisation_uncertainty_m: np.ndarray
    mesh_is_model: bool = False
    chaotic_trials: tuple[str, ...] = ()
    configured_mesh_fit: Fit | None = None
    noise_is_given: bool = False
    keep_if_chaotic: tuple[str, ...] = ()
    dense_points: int = 0

    @property
    def point_counts(self) -> list[int]:
        """Number of points of each trial, outliers not counted."""
        return [len(trial.s) for trial in self.trials]

    @property
    def outlier_count(self) -> int:
        """Number of points that were removed as outliers."""
        measured = sum(len(trial.s) for trial in self.trials_with_outliers)
        return measured - sum(self.point_counts)


@dataclass(frozen=True)
class RefinedFit:
    """A fit to data whose discretisation error was subtracted at its own optimum."""

    prepared: PreparedData
    fit: Fit


def with_initial_states_of(
    trials: Sequence[PreparedTrial],
    others: Sequence[PreparedTrial],
) -> tuple[PreparedTrial, ...]:
    """Copy the initial state of each trial from another version of it."""
    pairs = zip(trials, others, strict=True)
    return tuple(
        replace(
            trial,
            initial_state=other.initial_state,
            mode_amplitudes=other.mode_amplitudes,
        )
        for trial, other in pairs
    )
