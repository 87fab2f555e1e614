"""A joint that sticks for a while."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.model.effect import HandEffect, Quantity
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.outside import Outside, moment


class StickingJoint(HandEffect, Outside):
    """The second joint stays where it is for a while, behind its encoder, and then
    snaps back.
    """

    name = "sticking_joint"
    once = True
    parameters = (
        Parameter("lasts", "s", "how long it sticks", 0.0, 0.15, 0.0),
        Parameter("when", "s", "when it begins to", 0.0, 2.0, 0.3),
    )

    @staticmethod
    def describe(values: Mapping[str, float]) -> str:
        return f"the second joint sticks for {1e3 * values['lasts']:.0f} ms at {values['when']:.2f} s"

    @staticmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """Some time during the motion."""
        return {"when": moment(rng, t)}

    @staticmethod
    def joints(
        t: np.ndarray, angles: np.ndarray, lasts: Quantity, when: Quantity
    ) -> np.ndarray:
        """Angles less the turn of the joint while it sticks; smooth over some 10 ms."""
        # where the joint is when each candidate begins to stick, (C, 1)
        each = np.broadcast_to(angles[..., 1], (len(when), len(t)))
        begun = np.array(
            [np.interp(at, t, own) for at, own in zip(when[..., 0], each, strict=True)]
        ).reshape(-1, 1)
        edge = 0.003  # [s]
        rise, fall = (
            0.5 * (1 + np.tanh((t[:, None] - x) / edge)) for x in (when, when + lasts)
        )
        missing = (rise - fall)[..., 0] * (angles[..., 1] - begun)
        return angles - missing[..., None] * np.array([0.0, 1.0, 0.0])
