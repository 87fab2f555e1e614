"""How a finer mesh would change the effect of parameters (manifold mapping).

References
----------
Echeverria and Hemker 2005, Comput. Methods Appl. Math. 5, 107.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

MESH_CORRECTION_RADIUS = 0.05  # of a range: far beyond this the slopes do not hold


@dataclass(frozen=True)
class MeshCorrection:
    """How the step from this mesh to its limit changes residuals, to first order.

    Parameters
    ----------
    parameter_names
        Names of the parameters, (P,).
    chi
        The centre: exponents (P,) at which the discretisation error was subtracted
        from the measured points.
    slopes
        Of each trial, the slopes (P, 2 n) of the change of its residuals over sigma.
    """

    parameter_names: tuple[str, ...]
    chi: np.ndarray
    slopes: tuple[np.ndarray, ...]

    def centred_at(self, exponents: Mapping[str, float]) -> MeshCorrection:
        """Move the centre to other exponents by name; the slopes stay."""
        moved = self.chi.copy()
        for i, name in enumerate(self.parameter_names):
            moved[i] = exponents.get(name, moved[i])
        return replace(self, chi=moved)

    def subset(self, chosen: Sequence[int]) -> MeshCorrection:
        """Select some of the trials by number."""
        return replace(self, slopes=tuple(self.slopes[k] for k in chosen))

    def correction_at(self, names: Sequence[str], chi: np.ndarray) -> list[np.ndarray]:
        """Compute the change of each trial's residuals (C, 2 n) at exponents (C, P').

        Parameters that the correction does not know change nothing. The change levels
        off at the radius, and smoothly: fits end at corners.

        names: of the parameters, (P',).
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
            # One by one: a candidate has the same bits in any batch
            for row, result in zip(limited, change, strict=True):
                np.dot(row, own_slope, out=result)
            changes.append(change)
        return changes
