"""Trials whose simulations are extrapolated from two meshes to their limit.

Nothing is subtracted from what was measured, so that hypotheses are fitted to the same
data. A simulation costs five times that on the coarse mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.inference.mesh import residuals_on_meshes
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import ByTrial, TrialData
from stringcast.stages.model.engine.accuracy import richardson_limit
from stringcast.stages.model.model import Model


@dataclass(frozen=True)
class ExtrapolatedData(TrialData):
    """Trials as measured, compared with the limit of ever finer meshes."""

    def residuals(self, model: Model, chi: np.ndarray) -> ByTrial:
        """Compute extrapolated less measured over sigma of each trial, (C, 2 n).

        A run that diverged on one of the meshes is DIVERGED_RESIDUAL throughout.

        chi: exponents, (C, P).
        """
        by_mesh = residuals_on_meshes(model, self.trials, chi, (1, 2))
        residuals = []
        for coarse, fine in zip(*by_mesh, strict=True):
            limit = richardson_limit(coarse, fine)
            diverged = (coarse == DIVERGED_RESIDUAL) | (fine == DIVERGED_RESIDUAL)
            residuals.append(np.where(diverged, DIVERGED_RESIDUAL, limit))
        return residuals
