"""Trials that are fitted together, and their residuals under a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stringcast.stages.inference.batch import candidates_at_once, normalised_residuals
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.mesh_correction import MeshCorrection
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values

ByTrial = Sequence[np.ndarray]  # an array for each trial, since their points differ


def subtract_by_trial(residuals: ByTrial, others: ByTrial) -> ByTrial:
    """Subtract the arrays of each trial."""
    pairs = zip(residuals, others, strict=True)
    return [residual - other for residual, other in pairs]


@dataclass(frozen=True)
class TrialData:
    """Trials with their error models, random effects and mesh correction.

    Parameters
    ----------
    trials
        Trials with their error models.
    random_effects
        For causes that differ from trial to trial, by name: the shapes of each trial's
        random effect over sigma, (2 n, m). Their amplitudes are N(0, 1).
    mesh_correction
        A correction of all residuals, or None.
    """

    trials: tuple[PreparedTrial, ...]
    random_effects: Mapping[str, tuple[np.ndarray, ...]] = field(default_factory=dict)
    mesh_correction: MeshCorrection | None = None

    def for_hypothesis(self, hypothesis: Hypothesis) -> TrialData:
        """Add the random effects of a hypothesis to the trials' error models.

        The result has no random effects left, so that a second call changes nothing.
        """
        causes = self.random_effects.keys()
        names = tuple(name for name in hypothesis.cause_names if name in causes)
        if not names:
            return self
        if names not in self._extended_data:
            trials = []
            for k, trial in enumerate(self.trials):
                shapes = np.hstack([self.random_effects[name][k] for name in names])
                extended = trial.discrepancy.with_nuisance(shapes)
                trials.append(replace(trial, error_model=extended))
            extended_data = replace(self, trials=tuple(trials), random_effects={})
            self._extended_data[names] = extended_data
        return self._extended_data[names]

    @cached_property
    def _extended_data(self) -> dict[tuple[str, ...], TrialData]:
        """A cache of data with random effects added, by the names of their causes."""
        return {}

    def between_trial_tip_rms(self, name: str) -> float:
        """Compute the tip displacement by a cause's random effect [m], or 0."""
        if name not in self.random_effects:
            return 0.0
        displacements = [shapes.T for shapes in self.random_effects[name]]
        return float(self.overall_tip_rms(displacements)[0])

    def without_random_effect(self, name: str) -> TrialData:
        """Remove a cause's random effect: all trials share one amplitude."""
        others = {n: s for n, s in self.random_effects.items() if n != name}
        return replace(self, random_effects=others)

    def subset(self, chosen: Sequence[int]) -> TrialData:
        """Select some of the trials by number."""
        trials = tuple(self.trials[k] for k in chosen)
        random_effects = {}
        for name, shapes in self.random_effects.items():
            random_effects[name] = tuple(shapes[k] for k in chosen)
        correction = self.mesh_correction
        if correction is not None:
            correction = correction.subset(chosen)
        return replace(
            self,
            trials=trials,
            random_effects=random_effects,
            mesh_correction=correction,
        )

    @property
    def candidates_at_once(self) -> int:
        """Number of candidates that take as long together as one."""
        return candidates_at_once(self.trials)

    def residuals(self, model: Model, chi: np.ndarray) -> ByTrial:
        """Compute residuals over sigma of each trial at exponents (C, P), (C, 2 n).

        Those of a diverged simulation are DIVERGED_RESIDUAL.
        """
        values = parameter_values(model.parameters, chi)
        residuals = []
        for residual in normalised_residuals(model, self.trials, values):
            np.copyto(residual, DIVERGED_RESIDUAL, where=np.isnan(residual))
            residuals.append(residual)
        if self.mesh_correction is not None:
            changes = self.mesh_correction.correction_at(model.names, chi)
            for k, change in enumerate(changes):
                diverged = residuals[k] == DIVERGED_RESIDUAL
                residuals[k] += change
                residuals[k][diverged] = DIVERGED_RESIDUAL
        return residuals

    def whiten(self, residuals: ByTrial, grid_points: np.ndarray) -> np.ndarray:
        """Whiten residuals (C, 2 n) of each trial and concatenate them, (C, N).

        grid_points: course and scale of each trial's discrepancy, (K,).
        """
        return np.concatenate(self.whiten_by_trial(residuals, grid_points), axis=1)

    def whiten_by_trial(
        self,
        residuals: ByTrial,
        grid_points: np.ndarray,
    ) -> ByTrial:
        """Whiten residuals (C, 2 n) of each trial by its error model, (C, N_k)."""
        white = []
        for k, trial in enumerate(self.trials):
            white.append(trial.error_model.whiten(residuals[k], grid_points[k]))
        return white

    def log_likelihood_by_grid_point(self, residuals: ByTrial) -> np.ndarray:
        """Compute the log-likelihood at all W S points of the discrepancy grid.

        residuals: (C, 2 n) of each trial. Returns (K, C, W S).
        """
        by_trial = []
        for trial, residual in zip(self.trials, residuals, strict=True):
            coefficients = trial.discrepancy.coefficients(residual)
            by_trial.append(
                trial.discrepancy.log_likelihood_by_grid_point(coefficients)
            )
        return np.stack(by_trial)

    def without_nuisance(
        self,
        residuals: ByTrial,
        grid_points: np.ndarray,
    ) -> ByTrial:
        """Subtract the most likely nuisance from each trial's residuals (2 n,)."""
        rest = []
        for k, trial in enumerate(self.trials):
            discrepancy = trial.discrepancy
            coefficients = discrepancy.coefficients(residuals[k][None])[0]
            explained = discrepancy.nuisance_mean(coefficients, grid_points[k])
            rest.append(residuals[k] - explained)
        return rest

    def tip_rms_by_trial(self, displacements: ByTrial) -> np.ndarray:
        """Compute the root mean square at each trial's tip [m], (K, ...).

        displacements: (..., 2 n) of each trial, over sigma.
        """
        by_trial = []
        for trial, displacement in zip(self.trials, displacements, strict=True):
            is_tip = np.repeat(trial.is_tip, 2)
            by_trial.append(trial.tip_rms(displacement.compress(is_tip, axis=-1)))
        return np.array(by_trial)

    def overall_tip_rms(self, displacements: ByTrial) -> np.ndarray:
        """Compute the root mean square at the tip over all trials [m], (C,).

        displacements: (C, 2 n) of each trial, over sigma.
        """
        by_trial = self.tip_rms_by_trial(displacements)
        return np.asarray(np.sqrt(np.mean(by_trial**2, axis=0)))
