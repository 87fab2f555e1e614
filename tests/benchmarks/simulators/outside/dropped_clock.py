"""A clock that jumps during a trial."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.model.effect import ClockEffect, Quantity
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.outside import Outside, moment


class DroppedClock(ClockEffect, Outside):
    """A clock that jumps: from one moment on the pictures are stamped early or late, as
    when frames are lost unnoticed.
    """

    name = "dropped_clock"
    once = True
    parameters = (
        Parameter(
            "jump", "s", "arm's clock less the camera's, afterwards", -0.05, 0.05, 0.0
        ),
        Parameter("when", "s", "from when on", 0.0, 2.0, 0.3),
    )

    @staticmethod
    def describe(values: Mapping[str, float]) -> str:
        return f"the camera's clock jumps by {1e3 * values['jump']:.1f} ms at {values['when']:.2f} s"

    @staticmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """Some time during the motion."""
        return {"when": moment(rng, t)}

    @staticmethod
    def times(t: np.ndarray, jump: Quantity, when: Quantity) -> np.ndarray:
        """Between one frame and the next."""
        return t + jump * (t >= when)
