"""A joint that sticks for a while."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.hardware.virtual.outside import Outside, moment
from stringcast.stages.model.effect import HandEffect, Quantity
from stringcast.stages.model.parameter import Parameter


class StickingJoint(HandEffect, Outside):
    """The second joint stays where it is for a while, behind its encoder, and then snaps back."""

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
    def circumstances(rng: np.random.Generator, t: np.ndarray, points: np.ndarray) -> dict[str, float]:
        """Some time during the motion."""
        return {"when": moment(rng, t)}

    @staticmethod
    def joints(t: np.ndarray, angles: np.ndarray, lasts: Quantity, when: Quantity) -> np.ndarray:
        """Angles less the turn of the joint while it sticks; smooth over some 10 ms."""
        begun = _at(when[..., 0], t, angles[..., 1])
        edge = 0.003  # [s]
        rise, fall = (0.5 * (1 + np.tanh((t[:, None] - x) / edge)) for x in (when, when + lasts))
        missing = (rise - fall)[..., 0] * (angles[..., 1] - begun)
        return angles - missing[..., None] * np.array([0.0, 1.0, 0.0])


def _at(when: np.ndarray, t: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """The angle (1 or C, K) of each candidate at its own time (C, 1), (C, 1)."""
    each = np.broadcast_to(angle, (len(when), len(t)))
    return np.array([np.interp(moment, t, own) for moment, own in zip(when, each, strict=True)]).reshape(-1, 1)
