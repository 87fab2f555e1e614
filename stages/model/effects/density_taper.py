"""Mass per length that changes linearly along the string."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.picture import line
from stringcast.stages.model.symmetry import odd

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class DensityTaper(StringEffect):
    """Density from 1 - taper / 2 at the grasp to 1 + taper / 2 at the tip; the whole mass stays what it is."""

    name = "density_taper"
    parameters = (Parameter("taper", "1", "rise of mass per length from grasp to tip over its mean", -1.6, 1.6, 0.0),)
    reference = "Newton's second law for a string of uneven density"
    symmetries = (odd("density", "taper"),)

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        heavier = "tip" if values["taper"] > 0 else "grasp"
        share = 100 * abs(values["taper"])
        return (
            f"the string grows heavier towards the {heavier}: its mass per length changes by {share:.0f} % of the mean"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """Along the string."""
        s = np.linspace(0.0, 1.0, 2)
        line(axes, s, 1 + cls.density(s, 1.0, values["taper"]), "arc length / length", "mass per length / mean")

    @staticmethod
    def density(s: Quantity, length: Quantity, taper: Quantity) -> Quantity:
        return taper * (s / length - 0.5)
