"""Too few mass points for this string."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import ModelChange
from stringcast.stages.model.picture import line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from stringcast.stages.model.model import Model


class Resolution(ModelChange):
    """No law of the string but of our making: segments half as long. May be joined again, to halve once more.

    Parameters keep their meaning, for they are given at `reference_points`.
    """

    name = "resolution"
    reference = "Order of convergence of the lumped chain, tests/convergence"

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        return "the model has too few mass points for this string"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """How an error of first order goes down with the mass points."""
        points = np.array([10, 19, 37, 73])
        line(axes, points, 9 / (points - 1), "mass points", "error / error at 10")

    @classmethod
    def join(cls, model: Model) -> Model:
        """The model with segments half as long."""
        return replace(model, string=replace(model.string, points=2 * model.string.points - 1))
