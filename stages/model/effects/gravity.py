"""Gravity, F_g of Table 1."""

from stages.model.effect import StringEffect


class Gravity(StringEffect):
    """Weight, straight down."""

    name = "gravity"

    @staticmethod
    def acceleration() -> tuple[float, float]:
        return 0.0, -9.81
