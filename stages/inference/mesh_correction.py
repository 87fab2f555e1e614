"""The change of discretisation error with the parameters (manifold mapping).

References
----------
Echeverria and Hemker 2005, Comput. Methods Appl. Math. 5, 107.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

MESH_CORRECTION_RADIUS = 0.05  # of a range: far beyond this the slopes are invalid


@dataclass(frozen=True)
class MeshCorrection:
    """The difference between the residuals of the limit and of this mesh, linearised.

    Parameters
    ----------
    parameter_names
        Names of the parameters, (P,).
    chi
        The centre: exponents (P,) at which the discretisation error was subtracted
        from the measured points.
    slopes
        Derivatives by chi of this difference in each trial, over sigma, (P, 2 n).
    """

    parameter_names: tuple[str, ...]
    chi: np.ndarray
    slopes: tuple[np.ndarray, ...]

    def centred_at(self, exponents: Mapping[str, float]) -> MeshCorrection:
        """Move the centre to other exponents, given by name."""
        moved = self.chi.copy()
        for i, name in enumerate(self.parameter_names):
            moved[i] = exponents.get(name, moved[i])
        return replace(self, chi=moved)

    def subset(self, chosen: Sequence[int]) -> MeshCorrection:
        """Select some of the trials by number."""
        return replace(self, slopes=tuple(self.slopes[k] for k in chosen))

    def correction_at(self, names: Sequence[str], chi: np.ndarray) -> list[np.ndarray]:
        """Compute the change of each trial's residuals (C, 2 n) at exponents (C, P').

        Parameters without a slope change nothing. The change saturates smoothly at the
        radius: fits get stuck at corners.

        names: names of the P' parameters.
        """
        known = []  # indices among the correction's parameters
        columns = []  # indices of the same parameters in `names`
        for i, name in enumerate(self.parameter_names):
            if name in names:
                known.append(i)
                columns.append(names.index(name))
        distance = chi[:, columns] - self.chi[known]
        radius = MESH_CORRECTION_RADIUS
        limited = radius * np.tanh(distance / radius)
        changes = []
        for slope in self.slopes:
            own_slope = slope if len(known) == len(slope) else slope[known]
            change = np.empty((len(chi), slope.shape[1]))
            # One by one, so that rounding does not depend on the batch
            for row, result in zip(limited, change, strict=True):
                np.dot(row, own_slope, out=result)
            changes.append(change)
        return changes
