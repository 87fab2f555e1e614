"""Play in the joints."""

import numpy as np

from stringcast.stages.model.effect import (
    HandEffect,
    Parameter,
    Quantity,
    Values,
    is_odd,
    shifts_with,
)


class Backlash(HandEffect):
    """The play operator: after a reversal a joint rests until its gap is closed.

    It begins in the middle of the gap. Each joint has its own gap, because gears wear
    independently.
    """

    name = "backlash"
    order = 1  # the gears follow the motor, whose lag and gain come first
    parameters = tuple(
        Parameter(
            f"gap_{joint}", "rad", f"play of joint q{joint}, end to end", 0.0, 0.1, 0.0
        )
        for joint in (1, 2, 3)
    )
    reference = (
        "Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989): the play "
        "operator"
    )
    invariants = (is_odd("joints", "angles"), shifts_with("joints", "angles"))

    @staticmethod
    def describe(values: Values) -> str:
        gaps = ", ".join(f"{np.degrees(gap):.2f}" for gap in values.values())
        return f"the joints have play: q1, q2 and q3 by {gaps} degrees"

    @staticmethod
    def joints(
        t: np.ndarray,
        angles: np.ndarray,
        gap_1: Quantity,
        gap_2: Quantity,
        gap_3: Quantity,
    ) -> np.ndarray:
        """Return the actual angles, sample by sample.

        A joint within half a gap of the reported angle does not move.
        """
        half = np.concatenate([gap_1, gap_2, gap_3], axis=-1) / 2
        low, high = angles - half, angles + half
        real = np.empty(low.shape)
        real[:, 0] = angles[:, 0]
        for k in range(1, len(t)):
            real[:, k] = np.clip(real[:, k - 1], low[:, k], high[:, k])
        return real
