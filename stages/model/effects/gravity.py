"""Gravity, F_g of Table 1."""

from stringcast.stages.model.effect import Quantity, StringEffect, Values


class Gravity(StringEffect):
    """The string's weight, straight down."""

    name = "gravity"
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_g"

    @staticmethod
    def describe(values: Values) -> str:
        return "gravity pulls straight down"

    @staticmethod
    def acceleration() -> tuple[Quantity, Quantity]:
        return 0.0, -9.81
