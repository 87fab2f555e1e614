"""Gravity, F_g of Table 1."""

import numpy as np

from stringcast.stages.model.effect import Axes, Quantity, StringEffect, Values, line


class Gravity(StringEffect):
    """Weight, straight down."""

    name = "gravity"
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_g"

    @staticmethod
    def describe(values: Values) -> str:
        return "gravity pulls straight down"

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the acceleration in x and in y."""
        line(axes, np.array([0.0, 1.0]), np.array(cls.acceleration()), "x, y", "acceleration / (m/s2)")

    @staticmethod
    def acceleration() -> tuple[Quantity, Quantity]:
        return 0.0, -9.81
