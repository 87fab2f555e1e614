"""Trials that hypotheses are to explain together, and their residuals under a model."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stringcast.stages.inference.batch import normalised_residuals
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.mesh_correction import MeshCorrection
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values

CACHED_CANDIDATES = 64  # candidates: those of some iterations


class ResidualCache:
    """The residuals of the last candidates, by the values of their model and exponents."""

    def __init__(self) -> None:
        self._entries: deque[tuple[bytes, Model, list[np.ndarray]]] = deque(
            maxlen=CACHED_CANDIDATES
        )

    def find(self, model: Model, chi: np.ndarray) -> list[np.ndarray] | None:
        """Look up the residuals (1, 2 n) of each trial at exponents (P,); None if they
        are not there.
        """
        key = chi.tobytes()
        for exponents, simulated, residuals in reversed(self._entries):
            if exponents == key and simulated == model:
                return list(residuals)
        return None

    def store(
        self, model: Model, chi: np.ndarray, residuals: Sequence[np.ndarray]
    ) -> None:
        """Keep the residuals (C, 2 n) of each trial at exponents (C, P)."""
        for k in range(max(len(chi) - CACHED_CANDIDATES, 0), len(chi)):
            self._entries.append(
                (
                    chi[k].tobytes(),
                    model,
                    [rows[k : k + 1].copy() for rows in residuals],
                )
            )


@dataclass(frozen=True)
class TrialData:
    """Trials with their error models, and what hypotheses share about them.

    Parameters
    ----------
    trials : each with its error model.
    varying : by the name of a cause that differs from trial to trial, how it moves each trial, over sigma, (2 n, m),
        by shapes whose amplitudes are N(0, 1).
    finer : the mesh correction that residuals have, or None.
    """

    trials: tuple[PreparedTrial, ...]
    random_effects: Mapping[str, tuple[np.ndarray, ...]] = field(default_factory=dict)
    mesh_correction: MeshCorrection | None = None

    def for_hypothesis(self, hypothesis: Hypothesis) -> TrialData:
        """Add the random effects of a hypothesis's causes to the trials' discrepancies."""
        names = tuple(
            name for name in hypothesis.cause_names if name in self.random_effects
        )
        if not names:
            return self
        if names not in self._data_by_random_effects:
            trials = []
            for k, trial in enumerate(self.trials):
                shapes = np.hstack([self.random_effects[name][k] for name in names])
                trials.append(
                    replace(trial, error_model=trial.discrepancy.with_nuisance(shapes))
                )
            self._data_by_random_effects[names] = TrialData(
                tuple(trials), mesh_correction=self.mesh_correction
            )
        return self._data_by_random_effects[names]

    @cached_property
    def _data_by_random_effects(self) -> dict[tuple[str, ...], TrialData]:
        return {}

    def between_trial_tip_rms(self, name: str) -> float:
        """Compute by how much the tip differs from trial to trial because of a cause
        [m]; 0 where it does not.
        """
        columns = self.random_effects.get(name, ())
        return (
            float(self.overall_tip_rms([each.T for each in columns])[0])
            if columns
            else 0.0
        )

    def subset(self, chosen: Sequence[int]) -> TrialData:
        """Select some of the trials by number."""
        trials = tuple(self.trials[k] for k in chosen)
        varying = {
            name: tuple(columns[k] for k in chosen)
            for name, columns in self.random_effects.items()
        }
        return TrialData(
            trials,
            varying,
            self.mesh_correction and self.mesh_correction.subset(chosen),
        )

    def residuals(self, model: Model, chi: np.ndarray) -> list[np.ndarray]:
        """Compute simulated less measured over sigma of each trial, (C, 2 n), at
        exponents (C, P).

        A run that diverged is LOST throughout. A single candidate that was simulated a
        moment ago is looked up: a fit ends where the next begins.
        """
        if len(chi) == 1:
            cached = self._residual_cache.find(model, chi[0])
            if cached is not None:
                return cached
        residuals = [
            np.nan_to_num(r, nan=DIVERGED_RESIDUAL)
            for r in normalised_residuals(
                model, self.trials, parameter_values(model.parameters, chi)
            )
        ]
        if self.mesh_correction is not None:
            changes = self.mesh_correction.correction_at(model.names, chi)
            residuals = [
                np.where(r == DIVERGED_RESIDUAL, DIVERGED_RESIDUAL, r + change)
                for r, change in zip(residuals, changes, strict=True)
            ]
        self._residual_cache.store(model, chi, residuals)
        return residuals

    @cached_property
    def _residual_cache(self) -> ResidualCache:
        return ResidualCache()

    def whiten(self, residuals: Sequence[np.ndarray], sizes: np.ndarray) -> np.ndarray:
        """Whiten residuals (C, 2 n) of each trial and put them side by side, (C, N).
        sizes: as of `white_by_trial`.
        """
        return np.concatenate(self.whiten_by_trial(residuals, sizes), axis=1)

    def whiten_by_trial(
        self, residuals: Sequence[np.ndarray], sizes: np.ndarray
    ) -> list[np.ndarray]:
        """Whiten residuals (C, 2 n) of each trial by its error model, with its
        discrepancy of this size (K,).
        """
        pairs = zip(self.trials, residuals, sizes, strict=True)
        return [
            trial.error_model.whiten(residual, int(size))
            for trial, residual, size in pairs
        ]

    def log_likelihood_by_scale(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """Compute the log-likelihood of residuals (C, 2 n) of each trial at all sizes
        of its discrepancy, (K, C, S).
        """
        found = []
        for trial, residual in zip(self.trials, residuals, strict=True):
            discrepancy = trial.discrepancy
            found.append(
                discrepancy.log_likelihood_by_scale(discrepancy.coefficients(residual))
            )
        return np.stack(found)

    def without_initial_state_error(
        self, residuals: Sequence[np.ndarray], sizes: np.ndarray
    ) -> list[np.ndarray]:
        """Subtract from residuals (2 n,) of each trial what another initial state most
        likely explains. sizes: (K,).
        """
        left = []
        for trial, residual, size in zip(self.trials, residuals, sizes, strict=True):
            discrepancy = trial.discrepancy
            coefficients = discrepancy.coefficients(residual[None])[0]
            left.append(residual - discrepancy.nuisance_mean(coefficients, int(size)))
        return left

    def tip_rms_by_trial(self, displacements: Sequence[np.ndarray]) -> np.ndarray:
        """Compute the root mean square at the tip of each trial of displacements (...,
        2 n) over sigma [m], (K, ...).
        """
        found = []
        for trial, displacement in zip(self.trials, displacements, strict=True):
            points = displacement.reshape(*displacement.shape[:-1], len(trial.s), 2)
            at_tip = (
                points.compress(trial.is_tip, axis=-2) * trial.sigma[trial.is_tip, None]
            )
            found.append(np.sqrt(np.mean(np.sum(at_tip**2, axis=-1), axis=-1)))
        return np.array(found)

    def overall_tip_rms(self, displacements: Sequence[np.ndarray]) -> np.ndarray:
        """Compute the root mean square over all trials of displacements (C, 2 n) over
        sigma at the tip [m], (C,).
        """
        return np.asarray(
            np.sqrt(np.mean(self.tip_rms_by_trial(displacements) ** 2, axis=0))
        )
