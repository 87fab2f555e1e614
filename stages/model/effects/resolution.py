"""Too few mass points for this string."""

import numpy as np

from stringcast.stages.model.effect import Axes, ModelChange, Values, draw_line


class Resolution(ModelChange):
    """An error of the mesh, which segments of half the length reduce.

    It may be added again to halve once more. Parameters keep their meaning, because
    they are given for `reference_points`.
    """

    name = "resolution"
    reference = "Order of convergence of the lumped chain, tests/convergence"

    @staticmethod
    def describe(values: Values) -> str:
        return "the model has too few mass points for this string"

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw a first-order error over the number of mass points."""
        points = np.array([10, 19, 37, 73])
        draw_line(axes, points, 9 / (points - 1), "mass points", "error / error at 10")

    @staticmethod
    def points(points: int) -> int:
        """Return the number of mass points for segments of half the length."""
        return 2 * points - 1
