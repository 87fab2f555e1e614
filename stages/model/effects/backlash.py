"""Play in the joints at reversals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stages.model.effect import HandEffect, Quantity
from stages.model.parameter import Parameter
from stages.model.picture import line
from stages.model.symmetry import follows, odd

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Backlash(HandEffect):
    """The play operator: a joint stays where it is until the gap is taken up, then is pushed along.

    It begins in the middle of the gap.
    """

    name = "backlash"
    parameters = (Parameter("gap", "rad", "play of each joint, end to end", 0.0, 0.1, 0.0),)
    reference = "Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989): the play operator"
    symmetries = (odd("joints", "angles"), follows("joints", "angles"))

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        return f"the joints have a play of {np.degrees(values['gap']):.2f} degrees at reversals"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """What the joint does over what is reported, there and back."""
        t = np.linspace(0.0, 2.0, 401)
        angle = 0.2 * np.sin(np.pi * t)
        line(axes, angle, cls.joints(t, angle[None, :, None], values["gap"])[0, :, 0], "reported / rad", "angle / rad")

    @staticmethod
    def joints(t: np.ndarray, angles: np.ndarray, gap: Quantity) -> np.ndarray:
        """Sample by sample: within half a gap of what is reported, and otherwise where it was."""
        half = np.asarray(gap) / 2
        low, high = angles - half, angles + half
        real = np.empty(low.shape)
        real[:, 0] = angles[:, 0]
        for k in range(1, len(t)):
            real[:, k] = np.clip(real[:, k - 1], low[:, k], high[:, k])
        return real
