"""Mass per length that changes linearly along the string."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
)


class DensityTaper(StringEffect):
    """A density from 1 - taper / 2 at the grasp to 1 + taper / 2 at the tip.

    The total mass does not change.
    """

    name = "density_taper"
    parameters = (
        Parameter(
            "taper",
            "1",
            "rise of mass per length from grasp to tip, relative to its mean",
            -1.6,
            1.6,
            0.0,
        ),
    )
    reference = "Newton's second law for a string of uneven density"
    invariants = (is_odd("density", "taper"),)

    @staticmethod
    def describe(values: Values) -> str:
        heavier = "tip" if values["taper"] > 0 else "grasp"
        share = 100 * abs(values["taper"])
        return (
            f"the string grows heavier towards the {heavier}: its mass per length "
            f"changes by {share:.0f} % of the mean"
        )

    @staticmethod
    def density(s: Quantity, length: Quantity, taper: Quantity) -> Quantity:
        return taper * (s / length - 0.5)
