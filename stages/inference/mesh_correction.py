"""How a finer mesh would change the effect of parameters (manifold mapping).

References
----------
Echeverria and Hemker 2005, Comput. Methods Appl. Math. 5, 107.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

MESH_CORRECTION_RADIUS = 0.05  # of a range: beyond this distance the slopes do not hold


@dataclass(frozen=True)
class MeshCorrection:
    """How the step from this mesh to its limit changes residuals, to first order.

    Parameters
    ----------
    parameter_names
        Names of the parameters, (P,).
    chi
        Exponents (P,) at which the discretisation error was subtracted from the
        measured points.
    slopes
        Of each trial, the slopes (P, 2 n) of the change of its residuals over sigma.
    """

    parameter_names: tuple[str, ...]
    chi: np.ndarray
    slopes: tuple[np.ndarray, ...]

    def centred_at(self, known: Mapping[str, float]) -> MeshCorrection:
        """Move the point to other exponents, known by name."""
        pairs = zip(self.parameter_names, self.chi, strict=True)
        moved = [known.get(name, chi) for name, chi in pairs]
        return replace(self, chi=np.array(moved))

    def subset(self, chosen: Sequence[int]) -> MeshCorrection:
        """Select some of the trials by number."""
        return replace(self, slopes=tuple(self.slopes[k] for k in chosen))

    def correction_at(self, names: Sequence[str], chi: np.ndarray) -> list[np.ndarray]:
        """Compute the change of each trial's residuals (C, 2 n) at exponents (C, P').

        Parameters that the correction does not know change nothing; distances beyond
        its radius are cut there.

        names: of the parameters, (P',).
        """
        known = [i for i, name in enumerate(self.parameter_names) if name in names]
        places = [names.index(self.parameter_names[i]) for i in known]
        radius = MESH_CORRECTION_RADIUS
        distance = np.clip(chi[:, places] - self.chi[known], -radius, radius)
        return [distance @ slope[known] for slope in self.slopes]
